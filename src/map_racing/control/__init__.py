"""Guidance, steering maps and the controller that joins them."""
