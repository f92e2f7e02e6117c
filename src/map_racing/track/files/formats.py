"""Formats of raceline files that can be written."""

from __future__ import annotations

from pathlib import Path

from ...errors import ParameterError

__all__ = ["FORMATS", "choose_format"]

FORMATS = {
    "map_racing": "CSV with all columns, walls included; heading from +x",
    "tum": 'raceline of the TUM tools: 7 columns, "; ", heading from north, last point = first',
    "racetracks": "raceline of f1tenth_racetracks: 7 columns, ';', heading from +x in [0, 2 pi)",
    "centerline": "centerline of the TUM tools and f1tenth_racetracks: x, y and the widths, ','",
    "race_stack": "global_waypoints.json of race_stack",
    "bag": "ROS 1 bag with f110_msgs/WpntArray on /global_waypoints",
}
_OF_SUFFIX = {".json": ("race_stack",), ".bag": ("bag",)}
_CSV = ("map_racing", "tum", "racetracks", "centerline")


def choose_format(path: str | Path, wanted: str | None = None) -> str:
    """Choose the format of a file to write, by its suffix or as wanted.

    Parameters
    ----------
    path : str or pathlib.Path
    wanted : str, optional
        One of `FORMATS`.

    Returns
    -------
    str

    Raises
    ------
    ParameterError
        If the suffix belongs to several formats, to none, or to another one than wanted.
    """
    suffix = Path(path).suffix.lower()
    possible = _OF_SUFFIX.get(suffix, _CSV)
    if wanted is None:
        if len(possible) == 1:
            return possible[0]
        if suffix == ".csv":
            raise ParameterError(
                f"{path}: expected --format for a .csv file: {', '.join(possible)}"
            )
        raise ParameterError(f"{path}: expected a file named .csv, .json or .bag, or --format")
    if wanted not in FORMATS:
        raise ParameterError(f"format {wanted}: expected one of {', '.join(FORMATS)}")
    if wanted not in possible:
        right = next((name for name, formats in _OF_SUFFIX.items() if wanted in formats), ".csv")
        raise ParameterError(f"{path}: expected a file named {right} for format {wanted}")
    return wanted
