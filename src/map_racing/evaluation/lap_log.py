"""Laps appended to a file as they end."""

from __future__ import annotations

import csv
import io
import os
from dataclasses import fields
from pathlib import Path

from ..errors import FileFormatError, MapRacingError
from .live import LiveLap
from .report import csv_cells
from .results import Lap

__all__ = ["LapLog"]


class LapLog:
    """CSV file to which laps are appended, each safe on the disk before `add` returns.

    It has the columns of `map_racing.evaluation.report.write_csv`, ``warnings`` included, with the
    number of the run instead of the bag. An existing file is continued; a last line that was cut
    off by a power loss is removed.

    Parameters
    ----------
    path : str or pathlib.Path
    sectors : int
        Number of sectors of the laps.

    Raises
    ------
    FileFormatError
        If the file exists and has other columns.
    MapRacingError
        If it cannot be written.
    """

    def __init__(self, path: str | Path, sectors: int):
        self.path = Path(path)
        names = [field.name for field in fields(Lap)[:-2]]
        self._names = ["run", *names, *(f"sector_{i}_s" for i in range(1, sectors + 1))]
        self._names.append("warnings")
        header = ",".join(self._names)
        try:
            if self.path.exists() and not self.path.is_file():
                raise MapRacingError(f"{path}: cannot write: it is no file")
            content = self.path.read_bytes() if self.path.exists() else b""
            complete = content[: content.rfind(b"\n") + 1]
            if complete and complete.split(b"\n", 1)[0] != header.encode():
                raise FileFormatError(
                    f"{path}: expected a new file or one that begins with {header}"
                )
            if content and not complete and not header.encode().startswith(content):
                raise FileFormatError(f"{path}: expected a new file or one of laps")
            self._file = open(self.path, "ab")  # noqa: SIM115 - it stays open until `close`
            self._file.truncate(len(complete))
        except OSError as error:
            raise MapRacingError(f"{path}: cannot write: {error.strerror}") from None
        if not complete:
            self._append(self._names)

    def add(self, live_lap: LiveLap) -> None:
        """Append a `LiveLap`."""
        row = {"run": live_lap.run, **live_lap.lap.row(), "warnings": "; ".join(live_lap.warnings)}
        self._append(csv_cells(row[name] for name in self._names))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _append(self, cells):
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow(cells)
        try:
            # A single write, so that a killed process leaves no partial line.
            self._file.write(text.getvalue().encode())
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise MapRacingError(f"{self.path}: cannot write: {error.strerror}") from None
