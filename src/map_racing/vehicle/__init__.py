"""The car: parameters, tires, single-track model and its steady-state table."""
