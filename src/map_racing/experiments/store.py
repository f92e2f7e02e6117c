"""Results of races on disk, each written at once and found by its fingerprint."""

from __future__ import annotations

import math
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Iterable

from ..errors import FileFormatError, MapRacingError
from ..evaluation.results import Lap
from ..files import read_json, replacing, write_json
from ..simulation.race import Outcome, Work
from .jobs import LAP_COLUMNS, End, RaceJob, RaceResult, lap_row, plain

__all__ = ["Store", "check_reused"]


def check_reused(folders: Iterable[str | Path]) -> None:
    """Check that folders are result directories.

    Raises
    ------
    MapRacingError
        If one has no results; names it.
    """
    for folder in folders:
        if not (Path(folder) / "runs").is_dir():
            raise MapRacingError(f"{folder}: expected a result directory with a folder runs")


class Store:
    """Folder ``runs`` of a result directory, and ``bags`` beside it.

    Parameters
    ----------
    folder : pathlib.Path
        Result directory; it exists.
    reuse : iterable of str or pathlib.Path
        Result directories to take results from, see `check_reused`.
    """

    def __init__(self, folder, reuse=()):
        check_reused(reuse)
        self.folder = Path(folder)
        self._others = [Path(other) for other in reuse]
        (self.folder / "runs").mkdir(exist_ok=True)

    def find(self, job: RaceJob, path: bool = False, bag: bool = False) -> RaceResult | None:
        """The stored result of a race, if it has the requested path and bag."""
        name = f"{job.fingerprint}.json"
        for folder in (self.folder, *self._others):
            record = _read(folder / "runs" / name)
            if record is None:
                continue
            result = _result(record, folder / "runs" / name)
            if path and not result.path:
                continue
            recorded = None
            if bag:
                with suppress(OSError):
                    recorded = (folder / "bags" / f"{job.file_stem}.bag").read_bytes()
                if recorded is None:
                    continue
            if folder is not self.folder:
                self.keep(job, result, recorded)
            return result
        return None

    def keep(self, job: RaceJob, result: RaceResult, bag: bytes | None = None) -> None:
        """Write the bag, then the result, so that a result is always complete."""
        if bag is not None:
            path = self.folder / "bags" / f"{job.file_stem}.bag"
            path.parent.mkdir(exist_ok=True)
            with replacing(path, binary=True) as file:
                file.write(bag)
        record = {
            "race": {"name": job.name, **plain(job)},
            "result": {
                "outcome": result.outcome,
                "duration_s": result.duration_s,
                "stretches": [lap_row(lap) for lap in result.stretches],
                "path": result.path,
                "end": result.end,
                "work": result.work,
                "lateral_mps2": result.lateral_mps2,
            },
        }
        write_json(self.folder / "runs" / f"{job.fingerprint}.json", record, indent=None)


def _read(path):
    try:
        return read_json(path)
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        raise FileFormatError(f"{path}: expected the result of a race; delete it") from None


def _result(record, path):
    try:
        values = record["result"]
        stretches = tuple(
            Lap(**{name: math.nan if row[name] is None else row[name] for name in LAP_COLUMNS})
            for row in values["stretches"]
        )
        driven = tuple((t, x, y) for t, x, y in values["path"])
        end = values["end"] and End(*values["end"])
        work = values.get("work") and Work(*values["work"])
        lateral = math.nan if values["lateral_mps2"] is None else values["lateral_mps2"]
        result = RaceResult(
            values["outcome"], stretches, values["duration_s"], driven, end, work, lateral
        )
        Outcome(result.outcome)
        # The last column is text.
        numbers = [getattr(lap, name) for lap in stretches for name in LAP_COLUMNS[:-1]]
        for value in chain([result.duration_s, lateral], numbers, end or (), work or (), *driven):
            math.isnan(value)  # a TypeError for anything but a number
        return result
    except (KeyError, TypeError, ValueError):
        raise FileFormatError(f"{path}: expected the result of a race; delete it") from None
