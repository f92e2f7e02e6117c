"""``map-racing faults``: rehearse faults of a simulated car, print a table."""

from ..errors import ParameterError
from ..simulation.faults import check_name, kinds_table
from ..simulation.rehearsal import SCENARIOS, bounds_text, rehearse, table
from .progress import progress_bar


def run(arguments):
    """Rehearse and print."""
    if arguments.list:
        print(kinds_table(), end="")
        return
    name = arguments.fault
    if name is not None:
        check_name("--fault", name)
    chosen = [scenario for scenario in SCENARIOS if name in (None, scenario.fault)]
    if not chosen:
        raise ParameterError(
            f"--fault: {name} cannot be rehearsed without messages: the simulator node injects it"
        )
    rehearsals = []
    with progress_bar("faults", len(chosen), "faults") as show:
        for scenario in chosen:
            rehearsals.append(rehearse(scenario, arguments.plant, arguments.seed))
            show(len(rehearsals))
    print(table(rehearsals), end="\n")
    print(bounds_text(rehearsals))
