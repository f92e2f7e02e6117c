"""Errors that a user can cause."""

from .printing import printable


class MapRacingError(Exception):
    """Base of all errors: one line for the user with what was expected, what was found, and where.

    The command line prints it and exits with code 1; nodes log it.
    """

    def __str__(self):
        # Names of files and keys may contain line breaks.
        return printable(" ".join(super().__str__().splitlines()))


class ParameterError(MapRacingError):
    """A parameter is missing, unknown or impossible."""


class FileFormatError(MapRacingError):
    """A file has another format than expected."""


class RacelineError(MapRacingError):
    """A raceline cannot be driven: too few points, NaN, not closed, no speeds."""


class BagError(MapRacingError):
    """A bag cannot be read or written, or lacks a topic."""


class EvaluationError(MapRacingError):
    """Recorded driving cannot be evaluated on the raceline."""


class IdentificationError(MapRacingError):
    """Recorded driving does not identify tires."""
