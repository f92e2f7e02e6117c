"""Options of ``map-racing experiment``."""

import argparse

from .shared import add_effort_options, add_grid_options, add_number, add_shared_options


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.description = (
        "Repeat an experiment of the paper: identify the tires of the plant, tune the controllers, "
        "race them, and write tables, figures and provenance."
    )
    kinds = parser.add_subparsers(dest="kind", metavar="EXPERIMENT")
    kinds.required = True

    scaling = kinds.add_parser(
        "velocity-scaling",
        help="laps at rising speeds until a crash",
        description="Laps at rising scales of the raceline's speeds, for each controller and each "
        "race day until they are not completed.",
    )
    add_race_options(scaling)
    add_number(scaling, "--laps", 10, "timed laps of a race")
    add_number(scaling, "--from", 0.6, "first scale", dest="first", metavar="SCALE")
    add_number(scaling, "--to", 1.5, "last scale, unless all crash before", metavar="SCALE")
    add_number(scaling, "--step", 0.025, "from scale to scale", metavar="SCALE")
    scaling.set_defaults(run="experiment.run_scaling")

    tires = kinds.add_parser(
        "tire-models",
        help="pure pursuit, MAP with linear and MAP with Pacejka tires at two speeds",
        description="Pure pursuit, MAP with linear tires and MAP with Pacejka tires at 70 % and "
        "80 % of the raceline's speeds.",
    )
    add_race_options(tires)
    add_number(tires, "--laps", 5, "timed laps of a race")
    tires.set_defaults(run="experiment.run_tires")

    robustness = kinds.add_parser(
        "robustness",
        help="whether controllers complete every track with every car",
        description="Race controllers on a grid of tracks, shipped and generated, and cars that "
        "differ from what the controllers believe. Says how many races were completed and how "
        "close, and of the others where they ended and why.",
    )
    robustness.add_argument(
        "--controller",
        nargs="+",
        default=["map"],
        metavar="NAME",
        help="YAML files, or shipped controllers (default: map)",
    )
    robustness.add_argument(
        "--output",
        required=True,
        metavar="DIR",
        help="result directory; an existing one is continued where it stopped",
    )
    add_grid_options(robustness)
    robustness.add_argument(
        "--speed-scale", type=float, help="scale of the raceline's speeds, instead of the grid's"
    )
    robustness.add_argument("--laps", type=int, help="timed laps, instead of the grid's")
    add_effort_options(robustness)
    robustness.set_defaults(run="experiment.run_robustness")

    rivals = kinds.add_parser(
        "mpc",
        help="MAP against model predictive control",
        description="MAP and model predictive control with the same knowledge, speeds and search, "
        "whose computing time counts as delay: errors, laps and highest scale, sensitivity to "
        "wrong beliefs, and what the steps cost. Needs pip install 'map_racing[rivals]'.",
    )
    rivals.add_argument(
        "--output",
        required=True,
        metavar="DIR",
        help="result directory, a folder for each plant; an existing one is continued",
    )
    rivals.add_argument(
        "--plants",
        nargs="+",
        default=["nuc4", "public_simulator", "f1tenth_drift"],
        metavar="NAME",
        help="plants, as in map-racing race (default: nuc4 public_simulator f1tenth_drift)",
    )
    rivals.add_argument(
        "--conditions", default="rivals", help="as in velocity-scaling (default: %(default)s)"
    )
    rivals.add_argument("--track", help="instead of the track of the conditions")
    rivals.add_argument(
        "--seeds", type=int, nargs="+", metavar="N", help="race days, instead of the conditions'"
    )
    rivals.add_argument(
        "--tuning-scale",
        type=float,
        metavar="SCALE",
        help="scale of the speeds at which all are tuned, instead of the conditions'",
    )
    rivals.add_argument("--no-tuning", action="store_true", help="race all as shipped")
    rivals.add_argument(
        "--slowdown",
        type=float,
        default=1.0,
        metavar="FACTOR",
        help="computing time counts, times this, for a slower processor (default: %(default)s)",
    )
    rivals.add_argument(
        "--laps", type=int, default=3, help="timed laps of a race (default: %(default)s)"
    )
    add_effort_options(rivals)
    rivals.set_defaults(run="experiment.run_mpc")


def add_race_options(parser):
    """Options of both experiments."""
    add_shared_options(parser)
    parser.add_argument(
        "--no-tuning",
        action="store_true",
        help="race all controllers as shipped; the published ones have the lookahead of the "
        "authors' code",
    )
    parser.add_argument(
        "--bags", action="store_true", help="also write the races of the tables as bags"
    )
