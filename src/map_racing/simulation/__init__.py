"""Simulated cars and the closed loop with a controller."""
