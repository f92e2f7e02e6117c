"""Racelines in files: readers, writers, checks, repair."""
