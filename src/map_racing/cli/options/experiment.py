"""Options of ``map-racing experiment``."""

import argparse

from .shared import add_shared_options


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
    scaling.add_argument(
        "--laps", type=int, default=10, help="timed laps of a race (default: %(default)s)"
    )
    scaling.add_argument(
        "--to",
        type=float,
        default=1.5,
        metavar="SCALE",
        help="last scale, unless all crash before (default: %(default)s)",
    )
    scaling.set_defaults(run="experiment.run_scaling")

    tires = kinds.add_parser(
        "tire-models",
        help="pure pursuit, MAP with linear and MAP with Pacejka tires at two speeds",
        description="Pure pursuit, MAP with linear tires and MAP with Pacejka tires at 70 % and "
        "80 % of the raceline's speeds.",
    )
    add_race_options(tires)
    tires.add_argument(
        "--laps", type=int, default=5, help="timed laps of a race (default: %(default)s)"
    )
    tires.set_defaults(run="experiment.run_tires")


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
