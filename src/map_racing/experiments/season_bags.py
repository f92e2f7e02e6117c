"""The bags of a season: found below folders, and the parts of a run joined."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Iterable

from ..bags.opening import Source, open_bag
from ..bags.ros2 import METADATA, SUFFIXES
from ..errors import MapRacingError

__all__ = ["find_bags", "first_part", "parts_of"]

# Names that a recorder gives to parts of a run, with or without dates, and the longest pause or
# overlap between two parts [ns].
_PART = re.compile(r"(.+?)(?:_\d{4}(?:-\d\d){5})?_(\d+)\.bag")
_CUT_NS = 2 * 10**9


def find_bags(folders: Iterable[str | Path], without: str | Path | None = None) -> list[Source]:
    """Bags below folders; a ROS 2 folder is one bag.

    Split ROS 1 bags (``run_0.bag``, ``run_1.bag``, ...) are one, too, if each begins when the
    previous one ends.

    Parameters
    ----------
    folders : iterable of str or pathlib.Path
        Folders or bags.
    without : str or pathlib.Path, optional
        Folder to leave out.

    Returns
    -------
    list of pathlib.Path or tuple of pathlib.Path
        Sorted, each once; a tuple holds the parts of a run.

    Raises
    ------
    MapRacingError
        If a folder does not exist.
    """
    left_out = None if without is None else os.path.realpath(str(without))
    found = {}
    for folder in folders:
        if not str(folder):  # such as an unset shell variable
            raise MapRacingError("'': expected the name of a folder or a bag")
        if not Path(folder).exists():
            raise MapRacingError(f"{folder}: no such folder")
        if Path(folder).is_file() or _is_ros2_folder(Path(folder), os.listdir(str(folder))):
            found.setdefault(os.path.realpath(str(folder)), Path(folder))
            continue
        for place, inside, names in os.walk(str(folder)):
            path = Path(place)
            inside[:] = sorted(
                name
                for name in inside
                if not name.startswith(".") and os.path.realpath(f"{place}/{name}") != left_out
            )
            if _is_ros2_folder(path, names):
                found.setdefault(os.path.realpath(place), path)
                inside.clear()
                continue
            for name in sorted(names):
                if not name.startswith(".") and name.endswith((".bag", ".bag.active", *SUFFIXES)):
                    found.setdefault(os.path.realpath(f"{place}/{name}"), path / name)
    return _joined(sorted(found.values()))


def _joined(bags):
    """The bags, with the parts of a run replaced by one tuple."""
    parts, whole = {}, []
    for bag in bags:
        named = _PART.fullmatch(bag.name)
        if named:
            parts.setdefault((bag.parent, named.group(1)), {})[int(named.group(2))] = bag
        else:
            whole.append(bag)
    for numbered in parts.values():
        runs, end = [], None
        for number in sorted(numbered):
            bag = numbered[number]
            span = _span(bag) if {number - 1, number + 1} & set(numbered) else None
            follows = None not in (span, end) and -_CUT_NS <= span[0] - end <= _CUT_NS
            if follows and number - 1 in numbered:
                runs[-1].append(bag)
            else:
                runs.append([bag])
            end = span and span[1]
        whole += [tuple(run) if len(run) > 1 else run[0] for run in runs]
    return sorted(whole, key=first_part)


def _span(bag):
    """First and last time of receipt in a bag [ns], from its index; None if it has none."""
    try:
        with open_bag(bag) as opened:
            return (opened.start_ns, opened.end_ns) if opened.start_ns else None
    except (MapRacingError, OSError):
        return None


def first_part(source: Source) -> Path:
    """The bag, or the first part of a run."""
    return parts_of(source)[0]


def parts_of(source: Source) -> list[Path]:
    """Files or folders of a bag: several for a split run."""
    return list(source) if isinstance(source, tuple) else [source]


def _is_ros2_folder(path, names):
    """Whether a folder is one bag: closed, or with parts that have its name."""
    if METADATA in names:
        return True
    parts = [name for name in names if name.endswith(SUFFIXES)]
    return bool(parts) and all(name.startswith(f"{path.name}_") for name in parts)
