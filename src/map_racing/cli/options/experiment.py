"""Options of ``map-racing experiment``."""

import argparse

from .shared import (
    add_effort_options,
    add_grid_options,
    add_number,
    add_results,
    add_shared_options,
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.description = (
        "Race controllers, and write tables, figures and provenance: the experiments of the paper, "
        "a grid of tracks and cars, or MAP against model predictive control."
    )
    kinds = parser.add_subparsers(dest="kind", metavar="EXPERIMENT")
    kinds.required = True

    for add_kind in (_add_scaling, _add_tires, _add_robustness, _add_mpc):
        add_kind(kinds)


def _add_scaling(kinds):
    parser = kinds.add_parser(
        "velocity-scaling",
        help="laps at rising speeds until a crash",
        description="Race each controller on each race day at rising scales of the raceline's "
        "speeds, until it does not complete its laps.",
    )
    add_race_options(parser)
    add_number(parser, "--laps", 10, "timed laps of a race", metavar="N")
    add_number(parser, "--from", 0.6, "first scale", dest="first", metavar="SCALE")
    add_number(parser, "--to", 1.5, "last scale, unless all crash earlier", metavar="SCALE")
    add_number(parser, "--step", 0.025, "step from scale to scale", metavar="SCALE")
    parser.set_defaults(run="experiment.run_scaling")


def _add_tires(kinds):
    parser = kinds.add_parser(
        "tire-models",
        help="pure pursuit, MAP with linear and MAP with Pacejka tires at two speeds",
        description="Race pure pursuit, MAP with linear tires and MAP with Pacejka tires at 70 % "
        "and 80 % of the raceline's speeds.",
    )
    add_race_options(parser)
    add_number(parser, "--laps", 5, "timed laps of a race", metavar="N")
    parser.set_defaults(run="experiment.run_tires")


def _add_robustness(kinds):
    parser = kinds.add_parser(
        "robustness",
        help="whether controllers complete every track with every car",
        description="Race controllers on a grid of tracks, shipped and generated, and cars that "
        "differ from the controllers' model. Reports how many races were completed and with what "
        "error, and where and why the others ended.",
    )
    parser.add_argument(
        "--controller",
        nargs="+",
        default=["map"],
        metavar="NAME",
        help="shipped controllers or YAML files (default: map)",
    )
    add_results(parser)
    add_grid_options(parser)
    parser.add_argument(
        "--speed-scale",
        type=float,
        metavar="SCALE",
        help="scale of the raceline's speeds, instead of the grid's",
    )
    parser.add_argument(
        "--laps", type=int, metavar="N", help="timed laps of a race, instead of the grid's"
    )
    add_effort_options(parser)
    parser.set_defaults(run="experiment.run_robustness")


def _add_mpc(kinds):
    parser = kinds.add_parser(
        "mpc",
        help="MAP against model predictive control",
        description="Race MAP against model predictive control with the same knowledge, speeds and "
        "search; computing time counts as delay. Reports errors, laps, the highest scale, "
        "sensitivity to wrong beliefs, and what the steps cost. Needs pip install "
        "'map_racing[rivals]'.",
    )
    parser.add_argument(
        "--output",
        required=True,
        metavar="DIR",
        help="result directory, with a folder for each plant; an existing one is continued",
    )
    parser.add_argument(
        "--plants",
        nargs="+",
        default=["nuc4", "public_simulator", "f1tenth_drift"],
        metavar="NAME",
        help="plants, as in map-racing race (default: nuc4 public_simulator f1tenth_drift)",
    )
    parser.add_argument(
        "--conditions",
        default="rivals",
        metavar="NAME",
        help="as in velocity-scaling (default: %(default)s)",
    )
    parser.add_argument("--track", metavar="NAME", help="instead of the track of the conditions")
    parser.add_argument(
        "--seeds",
        type=int,
        nargs="+",
        metavar="N",
        help="seeds of the race days, instead of those of the conditions",
    )
    parser.add_argument(
        "--tuning-scale",
        type=float,
        metavar="SCALE",
        help="scale of the raceline's speeds at which all are tuned, instead of the conditions'",
    )
    parser.add_argument("--no-tuning", action="store_true", help="race all as shipped")
    slowdown = "factor on the computing time, to emulate a slower processor"
    add_number(parser, "--slowdown", 1.0, slowdown, metavar="FACTOR")
    add_number(parser, "--laps", 2, "timed laps of a race", metavar="N")
    add_effort_options(parser)
    parser.set_defaults(run="experiment.run_mpc")


def add_race_options(parser):
    """Add the options of the experiments of the paper."""
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
