"""Reading and writing of racelines in any file."""

from __future__ import annotations

from pathlib import Path

from ...bags.opening import is_bag
from ...bags.samples import Waypoints
from ...bags.waypoints import read_waypoints
from ...bags.writer import BagWriter
from ...files import refuse_special
from ..raceline import Raceline
from .checks import raceline_of
from .columns import columns_of_waypoints
from .readers import find_raceline_file, read_raceline_file, split_source
from .table import RacelineTable, without_signs
from .writers import closed_rows, raceline_columns, write_raceline_file

__all__ = ["load_raceline", "read_raceline", "save_raceline", "table_of_waypoints"]


def load_raceline(source: str | Path) -> Raceline:
    """Load a raceline from any source, as every command and node does.

    Parameters
    ----------
    source : str or pathlib.Path
        See `read_raceline`.

    Returns
    -------
    Raceline

    Raises
    ------
    BagError, FileFormatError, ParameterError
        If it cannot be read.
    RacelineError
        If it is unusable.
    """
    return raceline_of(read_raceline(source))


def read_raceline(source: str | Path) -> RacelineTable:
    """Read what a file states, without checking it.

    Parameters
    ----------
    source : str or pathlib.Path
        Name of a shipped track, a raceline file (see `map_racing.track.files.readers`), or a bag
        with ``f110_msgs/WpntArray`` or ``nav_msgs/Path``. ``FILE#KEY`` names the topic of a bag,
        the waypoint array of a JSON file, or the columns of a CSV file, as ``line.csv#x,y,speed``.

    Returns
    -------
    RacelineTable

    Raises
    ------
    BagError, FileFormatError, ParameterError
        If it cannot be read.
    """
    path, topic = split_source(source)
    refuse_special(path)
    if is_bag(path):
        return table_of_waypoints(path, read_waypoints(path, topic or None))
    return without_signs(read_raceline_file(*find_raceline_file(source)))


def save_raceline(
    raceline: Raceline,
    path: str | Path,
    form: str = "map_racing",
    table: RacelineTable | None = None,
) -> None:
    """Write a raceline in any of the `map_racing.track.files.formats.FORMATS`.

    Parameters
    ----------
    raceline : Raceline
    path : str or pathlib.Path
        Replaced in one step if it exists: a reader never meets half a file.
    form : str, optional
        The format, see `map_racing.track.files.formats.choose_format`.
    table : RacelineTable, optional
        The points that the raceline was made of, to be written exactly, instead of the cells of
        its internal form.

    Raises
    ------
    RacelineError
        If the raceline lacks what the format needs.
    MapRacingError
        If the file cannot be written.
    """
    columns = raceline_columns(raceline, table)
    if form == "bag":
        with BagWriter(path) as bag:
            # Any constant time will do except 0, which ROS does not allow.
            bag.waypoints(1.0, closed_rows(columns))
    else:
        write_raceline_file(path, columns, form)


def table_of_waypoints(source: str | Path, waypoints: Waypoints) -> RacelineTable:
    """Table of the waypoints of a bag.

    Parameters
    ----------
    source : str or pathlib.Path
        The bag.
    waypoints : Waypoints

    Returns
    -------
    RacelineTable
    """
    topic, kind, fields = waypoints
    columns = columns_of_waypoints(fields)
    table = RacelineTable(
        columns, name=Path(source).stem, source=f"{source}: {topic}", layout=f"{kind} on {topic}"
    )
    return without_signs(table)
