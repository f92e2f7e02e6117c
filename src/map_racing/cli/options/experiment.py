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
    add_number(scaling, "--to", 1.5, "last scale, unless all crash before", metavar="SCALE")
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
