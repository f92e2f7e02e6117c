"""``map-racing compare``: two result directories side by side."""

import math
from pathlib import Path

from ..evaluation.report import aligned
from ..experiments.results import compare, read_results
from .figures import draw

DIGITS = {"days_completed": 0, "m_m": 3, "q_s": 3, "rms_lateral_error_m": 4}


def run(arguments):
    """Compare, print, draw."""
    folders = arguments.first, arguments.second
    comparison = compare(*(read_results(folder) for folder in folders))
    print(f"{comparison.kind}: a = {folders[0]}, b = {folders[1]}\n")
    print("\n".join(table_lines(comparison)), end="\n\n")
    for name, keys in (("a", comparison.only_a), ("b", comparison.only_b)):
        if keys:
            print(f"only in {name}: " + ", ".join(f"{label} {scale:g}" for scale, label in keys))
    if comparison.differences:
        print("Differences in provenance:")
        rows = [["", "a", "b"], *map(list, comparison.differences)]
        print("\n".join(f"  {line}" for line in aligned(rows)))
    else:
        print("No difference in provenance.")
    if arguments.plots is not None:
        drawn = comparison.table, comparison.values, run_names(folders), comparison.kind
        path = draw(arguments.plots, "comparison.png", "experiments.plot_comparison", *drawn)
        print(f"figure written to {path}")


def table_lines(comparison):
    """Rows of both results and their difference."""
    rows = [["scale", "controller"]]
    for value in comparison.values:
        rows[0] += [f"{value} a", "b", "change"]
    for row in comparison.table.to_dict("records"):
        cells = [f"{row['speed_scale']:.3f}", row["controller"]]
        for value in comparison.values:
            digits = DIGITS.get(value, 3)
            first, second, change = (row[f"{value}_{name}"] for name in ("a", "b", "change"))
            # In tuning results, a missing value is a parameter of another law, not a missing race.
            missing = "-" if comparison.kind.startswith("tune") else "N.C."
            cells += [_number(number, digits, missing) for number in (first, second)]
            cells.append("-" if math.isnan(change) else f"{change:+.{digits}f}")
        rows.append(cells)
    return aligned(rows, left=1)


def _number(value, digits, missing):
    return missing if math.isnan(value) else f"{value:.{digits}f}"


def run_names(folders):
    """Names of the folders, or their paths if the names are the same."""
    names = tuple(Path(folder).resolve().name for folder in folders)
    return names if names[0] != names[1] else tuple(map(str, folders))
