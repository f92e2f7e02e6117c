"""Progress of a simulated drive."""

from __future__ import annotations

from contextlib import contextmanager
from typing import Callable, Iterator

from tqdm import tqdm

__all__ = ["progress_bar"]


@contextmanager
def progress_bar(name: str, total: float, unit: str) -> Iterator[Callable[[float], None]]:
    """A bar on stderr if that is a terminal; yields the function that sets the progress."""
    done = "{n:.1f}" if unit == "laps" else "{n:.0f}"
    form = "{desc}: {percentage:3.0f}%|{bar}| " + done + "/{total:.0f} " + unit + " [{elapsed}]"
    with tqdm(total=total, desc=name, disable=None, bar_format=form, leave=False) as bar:
        yield lambda now: bar.update(min(now, bar.total) - bar.n)
