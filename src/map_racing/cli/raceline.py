"""``map-racing raceline``: check, convert and make racelines."""

from ..evaluation.recordings import load_course
from ..track.formats import save_raceline
from .outputs import check_outputs

SOURCE = "shipped track, raceline file (CSV, race_stack JSON, also .gz) or bag[#topic]"


def add_parser(commands):
    """Add the command to the parser; each action adds its own part."""
    parser = commands.add_parser("raceline", help="check and convert racelines")
    actions = parser.add_subparsers(dest="action", metavar="ACTION")
    actions.required = True
    for add_action in (add_check, add_convert):
        add_action(actions)


def add_check(actions):
    """Add ``raceline check``."""
    check = actions.add_parser("check", help="what a raceline holds, and what is wrong with it")
    check.add_argument("source", metavar="FILE", help=SOURCE)
    check.set_defaults(run=run_check)


def add_convert(actions):
    """Add ``raceline convert``."""
    convert = actions.add_parser("convert", help="write a raceline in another format")
    convert.add_argument("source", metavar="IN", help=SOURCE)
    convert.add_argument("output", metavar="OUT", help="file to write")
    convert.set_defaults(run=run_convert)


def run_check(arguments):
    """Report on a raceline."""
    raceline = load_course(arguments.source)
    print(f"{arguments.source}: {raceline.length:.3f} m")
    for finding in raceline.findings:
        print(f"  {finding}")


def run_convert(arguments):
    """Read and write."""
    check_outputs([arguments.output], [arguments.source.partition("#")[0]])
    save_raceline(load_course(arguments.source), arguments.output)
    print(f"raceline written to {arguments.output}")
