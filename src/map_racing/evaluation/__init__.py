"""Evaluation of driving: recordings, laps, statistics and reports."""
