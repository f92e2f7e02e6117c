"""Parameters of files and nodes: a dataclass field defines the meaning, unit and range of each.

The fields are made by `parameter`. `check`, called in ``__post_init__``, compares the values with
them, `documented` writes the docstring of the class, and `parameter_table` the table of a page. The
nodes' logs and ``config/Controller.cfg`` use the same fields.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import numbers
from dataclasses import fields

from .errors import ParameterError
from .files import read_yaml_mapping
from .printing import printable

__all__ = [
    "FARTHEST",
    "POSITIVE",
    "check",
    "documented",
    "finite",
    "meaning",
    "parameter",
    "parameter_table",
    "positive",
    "read_parameters",
]

FARTHEST = 1e8  # Larger than any coordinate on earth [m] or any speed; damaged data may exceed it.

# A parameter out of this range is a typing error, and would overflow somewhere.
POSITIVE, _LARGEST = 1e-9, 1e9


def finite(name: str, value: object) -> float:
    """The value as a float, if it is a finite number of plausible size.

    Parameters
    ----------
    name : str
        Name for the error message.
    value : object
        Anything, such as a value read from a file.

    Returns
    -------
    float

    Raises
    ------
    ParameterError
        If it is something else, such as a text or a truth value, or exceeds 1e9.
    """
    number = isinstance(value, numbers.Real) and not isinstance(value, bool)
    # Compare before float(): huge integers overflow.
    if not number or not -math.inf < value < math.inf:
        raise ParameterError(f"{name}: expected a finite number, got {value!r}")
    if not -_LARGEST <= value <= _LARGEST:
        raise ParameterError(f"{name}: expected a number of at most {_LARGEST:g} in magnitude")
    return float(value)


def positive(name: str, value: object) -> float:
    """The value as a float, as `finite`, if it is at least 1e-9."""
    value = finite(name, value)
    if value < POSITIVE:
        raise ParameterError(f"{name}: expected a positive number, got {value:g}")
    return value


def parameter(
    text: str,
    unit: str = "",
    *,
    low: float = -math.inf,
    high: float = math.inf,
    choices: tuple = (),
    tuning: tuple = (),
    default: object = dataclasses.MISSING,
):
    """Field of a dataclass of parameters, whose type is float, int, bool or str.

    Parameters
    ----------
    text : str
        Its meaning in one sentence, then advice.
    unit : str, optional
    low, high : float, optional
        Valid range, bounds included; a `low` of `POSITIVE` means more than 0.
    choices : tuple of str, optional
        Valid values of a text.
    tuning : tuple of float, optional
        Range of the slider in live tuning, or ``(False, True)`` for a switch; without it the
        parameter cannot be tuned live.
    default : optional
        Without one, the parameter is required.
    """
    metadata = dict(text=text, unit=unit, low=low, high=high, choices=choices, tuning=tuning)
    return dataclasses.field(default=default, metadata=metadata)


def check(values: object) -> None:
    """Check the fields of a dataclass made by `parameter`; numbers in float fields become floats.

    Fields of types that `parameter` does not handle are ignored.

    Raises
    ------
    ParameterError
        For the first impossible value: "NAME: expected X, got Y".
    """
    for field in fields(values):
        kind, data, value = _kind(field), field.metadata, getattr(values, field.name)
        if kind == "float":
            value = finite(field.name, value)
            object.__setattr__(values, field.name, value)
        elif kind not in ("int", "bool", "str"):
            continue
        good = type(value).__name__ == kind
        if good and kind == "str":
            good = value in data["choices"] if data["choices"] else value == printable(value) != ""
        elif good:
            good = data["low"] <= value <= data["high"]
        if not good:
            got = f"{value:g}" if kind == "float" else repr(value)
            raise ParameterError(f"{field.name}: expected {_expected(field)}, got {got}")


def _kind(field):
    """Name of a field's type; annotations may be strings."""
    return field.type if isinstance(field.type, str) else getattr(field.type, "__name__", "")


def _expected(field):
    """The valid values of a field in words."""
    kind, data = _kind(field), field.metadata
    if kind == "bool":
        return "true or false"
    if kind == "tuple":
        return "a list"
    if kind not in ("float", "int"):
        return " or ".join(data["choices"]) or "a text"
    low, high = data["low"], data["high"]
    number = "whole number" if kind == "int" else "number"
    if math.isinf(low):
        return f"a {number}"
    if math.isinf(high):
        return f"a positive {number}" if low == POSITIVE else f"{low:g} or more"
    least = "more than 0" if low == POSITIVE else f"{low:g}"
    return f"{least} to {high:g} {data['unit']}".rstrip()


def meaning(field: dataclasses.Field, advice: bool = False) -> str:
    """Text of a field with its unit, as in ``Dead time [s]``, optionally with the advice."""
    text, unit = field.metadata["text"], field.metadata["unit"]
    first, dot, rest = text.partition(". ")
    first += f" [{unit}]" if unit else ""
    return first + dot + rest if advice else first


def documented(cls: type) -> type:
    """Class decorator that appends numpydoc sections for the fields to the docstring."""
    lines = [inspect.cleandoc(cls.__doc__), "", "Parameters", "----------"]
    for field in fields(cls):
        choices = ", ".join(f'"{choice}"' for choice in field.metadata["choices"])
        lines.append(f"{field.name} : {'{' + choices + '}' if choices else _kind(field)}")
        lines[-1] += "" if field.default is dataclasses.MISSING else f", default {field.default!r}"
        lines.append(f"    {meaning(field, advice=True)}.")
    lines += ["", "Raises", "------", "ParameterError", "    For an impossible value, naming it."]
    cls.__doc__ = "\n".join(lines) + "\n"
    return cls


def parameter_table(kind: type, prefix: str = "") -> str:
    """Markdown table of a dataclass of parameters, for a page of the documentation.

    Parameters
    ----------
    kind : type
        Dataclass whose fields are made by `parameter`, such as ``ControllerParameters``.
    prefix : str, optional
        Prefix of each name, such as ``~`` for parameters of a node.

    Returns
    -------
    str
        Header and one row per field: name, default (empty if required), valid values, meaning.
    """
    rows = ["| parameter | default | valid | meaning |", "|---|---|---|---|"]
    for field in fields(kind):
        default = "" if field.default is dataclasses.MISSING else f"`{field.default}`"
        cells = f"`{prefix}{field.name}`", default, _expected(field), meaning(field, advice=True)
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def read_parameters(path, kind: type, values: dict | None = None, what: str = ""):
    """Read a dataclass from a YAML mapping of the same names; unknown names are an error.

    If the mapping has already been read, pass it as `values`; `path` is then only for error
    messages, as is `what`, which says what the file should be.
    """
    if values is None:
        values = read_yaml_mapping(path, what)
    expected = f"expected {what}: " if what else ""
    known = {field.name for field in fields(kind)}
    unknown = sorted(str(name) for name in values if name not in known)
    if unknown:
        raise ParameterError(
            f"{path}: {expected}unknown parameter {', '.join(unknown)} "
            f"(known: {', '.join(sorted(known))})"
        )
    missing = [
        repr(field.name)
        for field in fields(kind)
        if field.default is dataclasses.MISSING and field.name not in values
    ]
    if missing:
        raise ParameterError(f"{path}: {expected}missing parameter {', '.join(missing)}")
    try:
        return kind(**values)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from error
