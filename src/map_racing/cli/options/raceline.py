"""Options of ``map-racing raceline``."""

from ..raceline import add_options

__all__ = ["add_options"]
