"""``map-racing advise``: speed sectors for the next heat."""

from ..control.speed_sectors import save_speed_sectors
from ..errors import ParameterError
from ..evaluation.advice import advice_notes, advice_table, advise
from ..evaluation.report import aligned
from .evaluate import check_evaluation
from .outputs import check_outputs
from .report import analyses


def run(arguments):
    """Evaluate, advise, print, write."""
    check_evaluation(arguments)
    if len(arguments.recordings) > 1 and not arguments.join:
        raise ParameterError(
            f"expected one recording, or --join for the parts of one, got "
            f"{len(arguments.recordings)}: the next heat follows from one"
        )
    if arguments.reverse:
        raise ParameterError("--reverse: speed sectors refer to the raceline in its own direction")
    inputs = [*arguments.recordings, arguments.raceline, arguments.vehicle]
    check_outputs([arguments.speed_sectors], inputs)
    runs, failed = analyses(arguments)
    if not runs:
        return failed
    heat = runs[-1]
    if len(runs) > 1:
        print(f"{len(runs)} racelines were driven: advice on the last, {heat.name}")
    advice = advise(heat, arguments.step)
    print(heat.result.source)
    for note in [*heat.result.notes, *heat.notes]:
        if note.startswith("warning: "):
            print(f"  {note}")
    print("\n".join(aligned(advice_table(advice), left=1)), end="\n\n")
    print("\n".join(advice_notes(advice)))
    if arguments.speed_sectors:
        save_speed_sectors(
            arguments.speed_sectors,
            heat.result.raceline,
            advice.scales(),
            [
                f"After {heat.name}: lap {advice.driven_s:.3f} s, with these sectors "
                f"{advice.predicted_s:.3f} s predicted,",
                f"at speed_scale 1, on the raceline of {advice.points} points.",
            ],
        )
        print(f"{arguments.speed_sectors}: {_count(advice)}, for speed_scale 1")
    return failed


def _count(advice):
    """Number of sectors in the file, where a sector across the start line must be split."""
    count = len(advice.scales())
    if count == len(advice.sectors):
        return f"{count} sectors"
    return f"{count} sectors, the one across the start line as two"
