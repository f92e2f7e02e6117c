"""Checks of output files before a command starts, so that nothing needed is overwritten."""

from __future__ import annotations

from pathlib import Path
from typing import Iterable

from ..bags.opening import is_bag
from ..errors import ParameterError
from ..track.files.readers import split_source

__all__ = ["check_outputs"]


def check_outputs(outputs: Iterable[str | None], inputs: Iterable[str | None]) -> None:
    """Refuse impossible or dangerous outputs.

    Parameters
    ----------
    outputs : iterable of str or None
        Files that the command would write; None if not wanted.
    inputs : iterable of str or None
        Files that it reads, possibly as ``FILE#KEY``.

    Raises
    ------
    ParameterError
        If an output is also an input or another output, is no file name, has no folder, or would
        replace a bag by another kind of file.
    """
    # Inputs may also be names of shipped files.
    files = [split_source(source)[0] for source in inputs if source]
    taken = {_identity(path): "an input" for path in files if Path(path).is_file()}
    for path in outputs:
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


def _identity(path):
    return str(Path(path).resolve())
