"""Options of ``map-racing faults``."""

import argparse

from .shared import add_number, add_plant_option


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.description = (
        "Rehearse each fault once: a simulated car drives 4 m/s in a bend under the supervisor. "
        "Prints what stops it, how soon it begins to slow, when it stands, how far it gets off the "
        "line, and what lets it drive again."
    )
    parser.add_argument("--list", action="store_true", help="only print the names of the faults")
    parser.add_argument("--fault", metavar="NAME", help="rehearse only this fault")
    add_plant_option(parser)
    add_number(parser, "--seed", 1, "seed of the noise", metavar="N")
    parser.set_defaults(run="faults.run")
