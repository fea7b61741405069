"""Promises: what every estimator and every detector keeps on hostile input."""
