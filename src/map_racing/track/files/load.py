"""Racelines from and to whatever file holds them."""

from __future__ import annotations

from pathlib import Path

from ...bags.reader import read_waypoints
from ...bags.records import is_bag
from ...bags.writer import BagWriter
from ...files import refuse_special
from .checks import raceline_of
from .readers import find_course_file, read_course_file, split_source
from .table import CourseTable
from .waypoints import WAYPOINT_COLUMNS
from .writers import choose_format, closed_rows, write_course_file

__all__ = ["load_course", "read_course", "save_course", "table_of_waypoints"]


def load_course(source):
    """Raceline from wherever it is: what every command and node reads one with.

    Parameters
    ----------
    source : str or pathlib.Path
        See `read_course`.

    Returns
    -------
    Raceline
        With what was noticed as `findings`.

    Raises
    ------
    BagError, FileFormatError, ParameterError
        If it cannot be read.
    RacelineError
        If something is wrong with it beyond use.
    """
    return raceline_of(read_course(source))


def read_course(source):
    """What a file says of a course, wherever it is, before anything of it is believed.

    Parameters
    ----------
    source : str or pathlib.Path
        Name of a shipped track, a raceline file (see `map_racing.track.files.readers`), or a bag
        with ``f110_msgs/WpntArray`` or ``nav_msgs/Path``. ``FILE#KEY`` names the topic of a bag,
        the waypoint array of a JSON file, or the columns of a CSV file, as ``line.csv#x,y,speed``.

    Returns
    -------
    CourseTable

    Raises
    ------
    BagError, FileFormatError, ParameterError
        If it cannot be read.
    """
    path, topic = split_source(source)
    refuse_special(path)
    if is_bag(path):
        return table_of_waypoints(path, read_waypoints(path, topic or None))
    return read_course_file(*find_course_file(source))


def save_course(path, course, form=None):
    """Write a course in any of the `map_racing.track.files.writers.FORMATS`.

    Parameters
    ----------
    path : str or pathlib.Path
        Replaced in one step if it exists.
    course : CourseColumns
        Of `map_racing.track.files.writers.course_columns`.
    form : str, optional
        Needed where the suffix of the path does not tell it.

    Returns
    -------
    str
        The format.

    Raises
    ------
    ParameterError
        If the format is unknown or does not go with the suffix.
    RacelineError
        If the course lacks what the format needs.
    MapRacingError
        If the file cannot be written.
    """
    form = choose_format(path, form)
    if form == "bag":
        with BagWriter(path) as bag:
            # ROS has no time 0; 1 s after it is as good as any, and always the same.
            bag.waypoints(1.0, closed_rows(course))
    else:
        write_course_file(path, course, form)
    return form


def table_of_waypoints(source, waypoints):
    """What a bag says of a course.

    Parameters
    ----------
    source : str or pathlib.Path
        The bag.
    waypoints : Waypoints

    Returns
    -------
    CourseTable
    """
    topic, kind, fields = waypoints
    columns = {
        column: fields[field] for field, column in WAYPOINT_COLUMNS.items() if field in fields
    }
    return CourseTable(
        columns, name=Path(source).stem, source=f"{source}: {topic}", layout=f"{kind} on {topic}"
    )
