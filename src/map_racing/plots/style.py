"""Colors, size, layout and saving of all figures.

Every drawing function returns a `matplotlib.figure.Figure` without window or global state; `save`
writes it. Within `own_settings` figures look the same for every user. The colors can be
distinguished with any color vision (Okabe-Ito, viridis).
"""

from __future__ import annotations

import warnings
from contextlib import contextmanager
from pathlib import Path
from typing import Iterator

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from ..errors import MapRacingError
from ..files import replacing

__all__ = [
    "COLORS",
    "DEVIATION",
    "RACELINE",
    "WALL",
    "finished",
    "legend_above",
    "new_figure",
    "own_settings",
    "save",
    "size_for",
]

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
WALL, RACELINE = "0.5", "0.1"
# Widths in a legend [in]: a symbol with the space around it, and a small letter.
_SYMBOL, _LETTER = 0.55, 0.07
DPI = 130
# Gray in the middle: with white, as in common diverging maps, a path without error would be
# invisible.
DEVIATION = LinearSegmentedColormap.from_list("deviation", ["#D55E00", "0.75", "#0072B2"])


@contextmanager
def own_settings() -> Iterator[None]:
    """Draw and save with matplotlib's own settings, not those of the user's matplotlibrc."""
    with style.context("default"):
        yield


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure; the suffix of the path is its format.

    Raises
    ------
    MapRacingError
        If the file cannot be written.
    """
    try:
        with warnings.catch_warnings():
            # Ignore missing glyphs: they are drawn as boxes.
            warnings.filterwarnings("ignore", "Glyph")
            with replacing(path, binary=True) as file:
                figure.savefig(file, format=Path(path).suffix[1:] or None, dpi=DPI)
    except ValueError as error:
        raise MapRacingError(f"{path}: cannot write the figure: {error}") from None


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of a size [in]."""
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    return figure


def finished(figure: Figure, top: float = 1.0, bottom: float = 0.0) -> Figure:
    """The figure, laid out between two shares of its height, to leave room for title and legend."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")
        # Twice: resizing axes changes their ticks, whose labels may need more room.
        for _ in range(2):
            figure.tight_layout(rect=(0.0, bottom, 1.0, top))
    return figure


def legend_above(axes: Axes, title: str = "", columns: int = 4) -> None:
    """Title, and below it the legend in rows above the axes, where it hides no data."""
    handles, labels = axes.get_legend_handles_labels()
    # What is wider than the figure would be cut off, and leave the axes no room.
    place = axes.get_subplotspec() if hasattr(axes, "get_subplotspec") else None
    room = axes.figure.get_figwidth() / (place.get_gridspec().get_geometry()[1] if place else 1)
    widest = _SYMBOL + _LETTER * max(map(len, labels), default=0)
    columns = max(min(columns, int(room / widest)), 1)
    rows = -(-len(handles) // columns)
    axes.set_title(title, pad=6.0 + 15.0 * rows)
    if handles:
        axes.legend(
            handles,
            labels,
            loc="lower center",
            bbox_to_anchor=(0.5, 1.0),
            borderaxespad=0.2,
            ncol=columns,
            fontsize="small",
            frameon=False,
        )


def size_for(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Size of a figure with the aspect ratio of a track, fit for a screen.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Points of the track [m].

    Returns
    -------
    width, height : float
        [in]
    """
    width, height = float(np.ptp(x)) + 1.0, float(np.ptp(y)) + 1.0
    scale = min(9.0 / width, 8.5 / height)
    return max(width * scale, 3.5) + 2.0, max(height * scale, 3.0) + 1.0
