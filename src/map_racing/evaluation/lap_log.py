"""Laps appended to a file as they end."""

from __future__ import annotations

import csv
import io
import os
from contextlib import suppress
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
    off by a power loss is removed. It is open only while a lap is written.

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
        self._header = f"{header}\n".encode()
        try:
            if self.path.exists() and not self.path.is_file():
                raise MapRacingError(f"{path}: cannot write: it is not a file")
            content = self.path.read_bytes() if self.path.exists() else b""
            complete = content[: content.rfind(b"\n") + 1]
            if complete and complete.split(b"\n", 1)[0] != header.encode():
                raise FileFormatError(
                    f"{path}: expected a new file or one that begins with {header}"
                )
            if content and not complete and not header.encode().startswith(content):
                raise FileFormatError(f"{path}: expected a new file or one of laps")
            if len(complete) < len(content):
                os.truncate(self.path, len(complete))
        except OSError as error:
            raise MapRacingError(f"{path}: cannot write: {error.strerror}") from None
        self._append(b"")

    def add(self, live_lap: LiveLap) -> None:
        """Append a `LiveLap`."""
        row = {"run": live_lap.run, **live_lap.lap.row(), "warnings": "; ".join(live_lap.warnings)}
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow(csv_cells(row[name] for name in self._names))
        self._append(text.getvalue().encode())

    def _append(self, line):
        begin = None
        try:
            with open(self.path, "ab") as file:
                begin = file.tell()
                # A single write, so that a killed process leaves no partial line.
                file.write(line if begin else self._header + line)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            # A full disk may take part of a line, to which the next one would be appended.
            if begin is not None:
                with suppress(OSError):
                    os.truncate(self.path, begin)
            raise MapRacingError(f"{self.path}: cannot write: {error.strerror}") from None
