"""Checks of output files before a command starts, so that nothing needed is overwritten."""

from __future__ import annotations

from pathlib import Path
from typing import Iterable

from ..bags.opening import is_bag
from ..errors import ParameterError
from ..track.files.readers import split_source

__all__ = ["ANY", "BAG", "CSV", "JSON", "PAGE", "YAML", "check_outputs"]


BAG, CSV, JSON, PAGE, YAML = ".bag", ".csv", ".json", ".html", ".yaml .yml"
ANY = ""  # of a raceline, whose ending is checked with its format


def check_outputs(outputs: Iterable[tuple[str | None, str]], inputs: Iterable[str | None]) -> None:
    """Refuse impossible or dangerous outputs.

    Parameters
    ----------
    outputs : iterable of (str or None, str)
        Files that the command would write, None if not wanted, each with the endings that its name
        may have: other commands find and recognize files by these.
    inputs : iterable of str or None
        Files that it reads, possibly as ``FILE#KEY``.

    Raises
    ------
    ParameterError
        If an output is also an input or another output, is no file name, has no folder or another
        ending, or would replace a bag by another kind of file.
    """
    # Inputs may also be names of shipped files.
    files = [split_source(source)[0] for source in inputs if source]
    taken = {_identity(path): "an input" for path in files if Path(path).is_file()}
    for path, endings in outputs:
        if path is None:
            continue
        name = Path(path)
        if not name.name or name.is_dir():
            raise ParameterError(f"{path!r}: expected the name of a file to write")
        if not name.parent.is_dir():
            raise ParameterError(f"{path}: the folder {name.parent} does not exist")
        if _identity(path) in taken:
            raise ParameterError(f"{path}: is also {taken[_identity(path)]}")
        taken[_identity(path)] = "another output"
        if name.suffix != ".bag" and name.is_file() and is_bag(name):
            raise ParameterError(f"{path}: is a bag, which would be overwritten")
        special = name.exists() and not name.is_file()  # such as /dev/stdout
        if endings and name.suffix not in endings.split() and not special:
            expected = " or ".join(endings.split())
            raise ParameterError(f"{path}: expected a file named {expected}")


def _identity(path):
    return str(Path(path).resolve())
