"""Cases: hostile but finite input, by subject."""
