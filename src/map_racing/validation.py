"""Check numbers and dataclasses of parameters that come from files."""

from __future__ import annotations

import math
import numbers
from dataclasses import fields

from .errors import ParameterError
from .files import read_yaml_mapping

__all__ = ["FARTHEST", "finite", "positive", "read_parameters"]

FARTHEST = 1e8  # No coordinate on earth, nor a speed, is larger [m]; damaged data may be.

# Beyond these a parameter is a slip of the pen, and would overflow somewhere.
_SMALLEST, _LARGEST = 1e-9, 1e9


def finite(name, value):
    """The value as a float, if it is a number of a credible size.

    Parameters
    ----------
    name : str
        What it is, for the error.
    value : object
        Anything, such as a value read from a file.

    Returns
    -------
    float

    Raises
    ------
    ParameterError
        If it is something else, such as a text or a truth value, or beyond 1e9.
    """
    number = isinstance(value, numbers.Real) and not isinstance(value, bool)
    # Compare before float(): huge integers overflow.
    if not number or not -math.inf < value < math.inf:
        raise ParameterError(f"{name}: expected a finite number, got {value!r}")
    if not -_LARGEST <= value <= _LARGEST:
        raise ParameterError(f"{name}: expected a number of at most {_LARGEST:g} in magnitude")
    return float(value)


def positive(name, value):
    """The same, if it is not negative, zero or below 1e-9."""
    value = finite(name, value)
    if value < _SMALLEST:
        raise ParameterError(f"{name}: expected a positive number, got {value:g}")
    return value


def read_parameters(path, kind, values=None):
    """Read one dataclass from a YAML mapping of the same names, refusing all else by name.

    With `values`, the mapping that was read already, `path` is only for the texts of errors.
    """
    if values is None:
        values = read_yaml_mapping(path)
    known = {field.name for field in fields(kind)}
    unknown = sorted(str(name) for name in values if name not in known)
    if unknown:
        raise ParameterError(
            f"{path}: unknown parameter {', '.join(unknown)} (known: {', '.join(sorted(known))})"
        )
    try:
        return kind(**values)
    except TypeError as error:  # a required argument is missing
        missing = str(error).split(": ")[-1]
        raise ParameterError(f"{path}: missing parameter {missing}") from error
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from error
