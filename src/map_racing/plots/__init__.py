"""Figures; matplotlib is imported here alone."""
