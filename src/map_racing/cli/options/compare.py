"""Options of ``map-racing compare``."""

import argparse


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.description = (
        "Compare two result directories of the same experiment on the same track: the tables row "
        "by row, and the differences in provenance."
    )
    parser.add_argument("first", metavar="DIR", help="result directory")
    parser.add_argument("second", metavar="DIR", help="result directory")
    parser.add_argument("--plots", metavar="DIR", help="write a figure")
    parser.set_defaults(run="compare.run")
