"""Reading and writing of small files, for all rooms of the package."""

from __future__ import annotations

import os
import re
from contextlib import contextmanager, suppress
from pathlib import Path

import yaml

from .errors import FileFormatError, MapRacingError

__all__ = ["make_folder", "read_yaml_mapping", "refuse_special", "replacing"]


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
        values = yaml.load(Path(path).read_text(encoding="utf-8"), _UniqueKeyLoader)
    except OSError as error:
        raise FileFormatError(f"{path}: cannot read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise FileFormatError(f"{path}: expected YAML, found bytes that are not text") from None
    except RecursionError:
        raise FileFormatError(f"{path}: expected YAML: nested too deeply") from None
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a date such as 2020-13-45
        mark = getattr(error, "problem_mark", None)
        where = f"{path}:{mark.line + 1}" if mark else str(path)
        problem = getattr(error, "problem", None) or "not readable"
        raise FileFormatError(f"{where}: expected YAML: {problem}") from None
    if not isinstance(values, dict):
        raise FileFormatError(f"{path}: expected keys and values, got {type(values).__name__}")
    return values


class _UniqueKeyLoader(yaml.SafeLoader):
    """Safe loader that refuses a key given twice, of which YAML would take the last.

    It reads 1e-3 as a number, as YAML 1.2 does; PyYAML's 1.1 wants 1.0e-3.
    """

    def construct_mapping(self, node, deep=False):
        seen = set()
        for key, _ in node.value:
            if not isinstance(key.value, str):
                continue
            if key.value in seen:
                problem = f"{key.value}: given twice"
                raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


_UniqueKeyLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+$"),
    list("-+.0123456789"),
)


@contextmanager
def replacing(path, binary=False):
    """Open a file for writing that appears under its name only when it is complete.

    It is written under a temporary name beside it and renamed at the end; after an error nothing is
    left behind, and an existing file stays as it was. A link stays a link to the file replaced; a
    device or pipe is written to as it is.

    Parameters
    ----------
    path : str or pathlib.Path
    binary : bool
        Whether bytes are written instead of text.

    Raises
    ------
    MapRacingError
        If the file cannot be written.
    """
    target = Path(os.path.realpath(str(path)))
    if not Path(path).name or target.is_dir():
        raise MapRacingError(f"{path}: cannot write: expected the name of a file")
    special = target.exists() and not target.is_file()
    temporary = target if special else target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        # Names of files that are not UTF-8 are written as they are.
        text = {"encoding": "utf-8", "errors": "surrogateescape", "newline": ""}
        with open(temporary, "wb" if binary else "w", **({} if binary else text)) as file:
            yield file
        if not special:
            os.replace(str(temporary), str(target))
    except OSError as error:
        raise MapRacingError(f"{path}: cannot write: {error.strerror or error}") from None
    finally:
        if not special:
            with suppress(OSError):
                temporary.unlink()


def make_folder(path):
    """Make a folder for results, with those above it, if it is not there.

    Parameters
    ----------
    path : str or pathlib.Path

    Returns
    -------
    pathlib.Path

    Raises
    ------
    MapRacingError
        If it cannot be made.
    """
    if not str(path):  # such as that of a variable of the shell that is not set
        raise MapRacingError(f"{path!r}: expected the name of a folder")
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MapRacingError(f"{folder}: cannot make the folder: {error.strerror}") from None
    return folder


def refuse_special(path):
    """Refuse pipes and devices, since reading one may never end, and no name at all."""
    if not str(path):
        raise FileFormatError("'': expected the name of a file")
    path = Path(path)
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise FileFormatError(f"{path}: expected a file, got a pipe or a device")
