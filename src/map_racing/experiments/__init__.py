"""Races as experiments: from the closed loop to recorded runs."""
