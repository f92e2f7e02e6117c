"""The one family of errors that a user of the package can cause."""


class MapRacingError(Exception):
    """Base of all errors of this package: its text is one line meant for the user.

    It says what was expected, what came, and where (file, topic, line). The command line prints it
    and exits with code 1; nodes log it.
    """

    def __str__(self):
        # Names of files and keys may hold line breaks.
        return " ".join(super().__str__().splitlines())


class ParameterError(MapRacingError):
    """A parameter is missing, unknown or impossible."""


class FileFormatError(MapRacingError):
    """A file cannot be read as what it should be."""


class RacelineError(MapRacingError):
    """A raceline cannot be driven: too few points, NaN, not closed, no speeds."""


class BagError(MapRacingError):
    """A bag cannot be read, or lacks what was asked of it."""


class EvaluationError(MapRacingError):
    """Recorded driving cannot be evaluated against the given raceline."""


class IdentificationError(MapRacingError):
    """Recorded driving from which no tires can be identified."""
