"""Options that several commands share."""

import argparse

from ...resources import list_config

__all__ = [
    "GRIDS",
    "add_effort_options",
    "add_grid_options",
    "add_join_option",
    "add_number",
    "add_plant_option",
    "add_recording_options",
    "add_results",
    "add_shared_options",
    "add_worker_options",
]


# Shipped files of ``config/experiments`` that are grids; the others are conditions.
GRIDS = ("robustness", "rough_lines")
CONDITIONS = "YAML file, or shipped: " + ", ".join(
    name for name in list_config("experiments") if name not in GRIDS
)


def add_join_option(parser: argparse.ArgumentParser) -> None:
    """Add the option that joins the parts of a split bag."""
    parser.add_argument(
        "--join",
        action="store_true",
        help="treat the bags as the parts of one run that the recorder split by size or time",
    )


def add_recording_options(parser: argparse.ArgumentParser) -> None:
    """Add recordings of laps, and the options for reading them."""
    parser.add_argument(
        "recordings",
        nargs="+",
        metavar="RECORDING",
        help="bag of ROS 1 or 2 (folder, .db3, .mcap), or CSV file",
    )
    add_join_option(parser)
    parser.add_argument(
        "--raceline",
        metavar="FILE",
        help="shipped track, raceline file (CSV, race_stack JSON, also .gz) or bag[#topic] "
        "(default: the raceline in the bag)",
    )
    parser.add_argument(
        "--pose-topic", metavar="TOPIC", help="topic of the pose (default: the best in the bag)"
    )
    parser.add_argument(
        "--columns",
        metavar="MAP",
        help="columns of CSV files with unusual names, such as t=time,x=pose_x,y=pose_y; also "
        "psi v_x v_y yaw_rate steering speed_command",
    )


def add_number(parser, option: str, default: float, meaning: str, **settings) -> None:
    """Add a number option; its type and help text follow from the default."""
    text = f"{meaning} (default: %(default)s)"
    parser.add_argument(option, type=type(default), default=default, help=text, **settings)


def add_plant_option(parser: argparse.ArgumentParser) -> None:
    """Add the simulated car."""
    parser.add_argument(
        "--plant",
        default="nuc4",
        metavar="NAME",
        help=f"the simulated car: YAML file, or shipped: {', '.join(list_config('plants'))} "
        "(default: %(default)s)",
    )


def add_shared_options(parser: argparse.ArgumentParser, days: str = "seeds") -> None:
    """Add the options.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    days : {"seeds", "practice_seeds"}
        Which days of the conditions ``--seeds`` replaces.
    """
    add_results(parser)
    parser.add_argument(
        "--conditions",
        default="paper",
        metavar="NAME",
        help=f"track, plant, race days and tuning: {CONDITIONS} (default: %(default)s)",
    )
    parser.add_argument(
        "--track",
        metavar="NAME",
        help="instead of the track of the conditions, as in map-racing race",
    )
    parser.add_argument(
        "--plant",
        metavar="NAME",
        help="instead of the plant of the conditions, as in map-racing race",
    )
    parser.add_argument(
        "--vehicle",
        metavar="NAME",
        help="the controllers' model of the car: shipped vehicle or YAML file (default: identified "
        "from steering ramps on the plant)",
    )
    parser.add_argument(
        "--seeds",
        dest=days,
        type=int,
        nargs="+",
        metavar="N",
        help=f"seeds of the {'race' if days == 'seeds' else 'practice'} days, instead of those of "
        "the conditions",
    )
    add_effort_options(parser)


def add_results(parser: argparse.ArgumentParser) -> None:
    """Add the result directory."""
    parser.add_argument(
        "--output",
        required=True,
        metavar="DIR",
        help="result directory; an existing one is continued where it stopped",
    )


def add_effort_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for workers and for reusing races."""
    add_worker_options(parser)
    parser.add_argument(
        "--reuse",
        action="append",
        default=[],
        metavar="DIR",
        help="reuse races from this result directory instead of driving them; may be repeated",
    )


def add_worker_options(parser: argparse.ArgumentParser) -> None:
    """Add the number of processes, or the Dask scheduler."""
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="processes (default: one for each core)"
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="run on the workers of this Dask scheduler (pip install 'map_racing[cluster]')",
    )


def add_grid_options(parser: argparse.ArgumentParser) -> None:
    """Add the grid of tracks and cars to race on."""
    parser.add_argument(
        "--grid",
        default="robustness",
        metavar="NAME",
        help=f"tracks and cars: YAML file, or shipped: {', '.join(GRIDS)} (default: %(default)s)",
    )
    parser.add_argument(
        "--tracks",
        nargs="*",
        metavar="NAME",
        help="instead of the grid's tracks: shipped tracks, raceline files or bag[#topic]",
    )
    parser.add_argument(
        "--generated",
        type=int,
        nargs="*",
        metavar="SEED",
        help="seeds of generated tracks, instead of the grid's",
    )
