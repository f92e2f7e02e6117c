"""The track: raceline geometry, tracking of the car along it, file formats, speed profiles."""
