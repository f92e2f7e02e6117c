"""Options that several commands share."""

from ..resources import list_config
from ..simulation.plants import PUBLIC_SIMULATOR

__all__ = ["add_options"]


def add_options(parser, days="seeds"):
    """Options of all commands that run many races.

    Parameters
    ----------
    parser : argparse.ArgumentParser
    days : {"seeds", "practice_seeds"}
        Which days of the conditions ``--seeds`` replaces.
    """
    parser.add_argument(
        "--output",
        required=True,
        metavar="DIR",
        help="result directory; one that is there is continued where it stopped",
    )
    parser.add_argument(
        "--conditions",
        default="paper",
        help="track, plant, race days and tuning: YAML file, or shipped: "
        f"{', '.join(list_config('experiments'))} (default: %(default)s)",
    )
    parser.add_argument("--track", help="instead of that of the conditions: as in map-racing race")
    parser.add_argument(
        "--plant",
        help=f"instead of that of the conditions: shipped plant, YAML file, or {PUBLIC_SIMULATOR}",
    )
    parser.add_argument(
        "--vehicle",
        help="the car as controllers know it: vehicle or YAML file (default: identified from "
        "steering ramps on the plant)",
    )
    parser.add_argument(
        "--seeds",
        dest=days,
        type=int,
        nargs="+",
        metavar="N",
        help=f"seeds of the {'race' if days == 'seeds' else 'practice'} days instead of those of "
        "the conditions",
    )
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="processes (default: one for each core)"
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="race on the workers of this Dask scheduler (pip install 'map_racing[cluster]')",
    )
    parser.add_argument(
        "--reuse",
        action="append",
        default=[],
        metavar="DIR",
        help="take races that another result directory already has from there; may be repeated",
    )
