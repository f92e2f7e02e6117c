"""Racelines: geometry, projection of the car, walls and maps, optimization, speed profiles."""
