"""Reading and writing of the small text files of a vehicle."""

from __future__ import annotations

import os
from pathlib import Path

import yaml

from ..errors import FileFormatError

__all__ = ["read_yaml_mapping", "write_atomically"]


def read_yaml_mapping(path):
    """Read a YAML file that holds one mapping.

    Parameters
    ----------
    path : str or pathlib.Path

    Returns
    -------
    dict

    Raises
    ------
    FileFormatError
        If it is something else; the message is one line and names file and line.
    """
    try:
        values = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        raise FileFormatError(f"{path}: expected YAML, found bytes that are not text") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{path}:{mark.line + 1}" if mark else str(path)
        problem = getattr(error, "problem", None) or "not readable"
        raise FileFormatError(f"{where}: expected YAML: {problem}") from None
    if not isinstance(values, dict):
        raise FileFormatError(f"{path}: expected keys and values, got {type(values).__name__}")
    return values


def write_atomically(path, text):
    """Write a text file under a temporary name, then rename it: never half a file.

    Parameters
    ----------
    path : str or pathlib.Path
    text : str
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_text(text, encoding="utf-8")
        os.replace(str(temporary), str(path))
    finally:
        if temporary.exists():
            temporary.unlink()
