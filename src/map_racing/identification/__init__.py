"""Tires of a car from driving data."""
