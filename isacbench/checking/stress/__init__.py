"""Stress: hostile but finite input, and what every estimator and every detector promises on it.

`families` lists the cases, `running` puts plugins through them, `search`
draws further ones from the same spaces, `table` keeps what came of it.
"""
