"""Files of the package: shipped data (vehicles, tracks, controllers, ...) and code."""

from __future__ import annotations

import hashlib
import os
from functools import lru_cache
from pathlib import Path

from . import __version__
from .errors import ParameterError

__all__ = ["config_directory", "find_config", "fingerprint_of_code", "list_config"]


def config_directory() -> Path:
    """Directory of the shipped data files.

    Returns
    -------
    pathlib.Path
        ``config/`` of the source tree, or ``share/map_racing/config`` where pip or catkin installed
        the package.

    Raises
    ------
    ParameterError
        If the installation lacks it.
    """
    here = Path(__file__).resolve()
    for parent in here.parents:
        if (parent / "package.xml").is_file() and (parent / "config").is_dir():
            return parent / "config"
        if (parent / "share" / "map_racing" / "config").is_dir():
            return parent / "share" / "map_racing" / "config"
    raise ParameterError(f"the data files of map_racing are missing: no config/ above {here}")


def list_config(kind: str) -> list[str]:
    """Names of the shipped files of one kind (``"vehicles"``, ``"tracks"``, ...), sorted."""
    directory = config_directory() / kind
    return sorted({path.name.split(".")[0] for path in directory.iterdir() if path.is_file()})


def find_config(kind: str, source: str | Path, suffixes: tuple[str, ...]) -> Path:
    """Resolve a shipped name or a path to a file.

    Parameters
    ----------
    kind : str
        Folder of the shipped files: ``"vehicles"``, ``"tracks"``, ``"controllers"``, ``"plants"``.
    source : str or pathlib.Path
        Path of an existing file, or the name of a shipped one without its suffix.
    suffixes : tuple of str
        Suffixes tried in order for a shipped name, such as ``(".yaml",)``.

    Returns
    -------
    pathlib.Path

    Raises
    ------
    ParameterError
        If there is neither such a file nor such a name; the message lists the shipped names.
    """
    if not isinstance(source, (str, Path)):
        raise ParameterError(f"expected a name of the shipped {kind} or a path, got {source!r}")
    path = Path(source)
    if path.is_file():
        return path
    if path.name == str(source):
        for suffix in suffixes:
            candidate = config_directory() / kind / (path.name + suffix)
            if candidate.is_file():
                return candidate
    known = ", ".join(list_config(kind))
    if str(source) and path.is_dir():
        raise ParameterError(
            f"{source}: expected a file or one of the shipped {kind} ({known}), got a folder"
        )
    name = str(source) or "''"
    raise ParameterError(f"{name}: no such file, nor one of the shipped {kind} ({known})")


@lru_cache(maxsize=None)
def fingerprint_of_code(parts: tuple[str, ...]) -> str:
    """Sixteen hexadecimal digits that identify the version and the source code of some parts.

    Parameters
    ----------
    parts : tuple of str
        Paths of modules or folders in the package; subfolders of a folder do not count.
    """
    package = Path(__file__).resolve().parent
    digest = hashlib.sha256(__version__.encode())
    for part in parts:
        place = package / part
        for source in sorted(place.glob("*.py")) if place.is_dir() else [place]:
            digest.update(os.path.relpath(source, package).encode() + source.read_bytes())
    return digest.hexdigest()[:16]
