"""A self-contained HTML file: text, tables, data and scripts.

Everything from files or topics passes through `escape`, or goes into the page as JSON, so a name
can never become markup. A content security policy keeps the page from loading anything.
"""

from __future__ import annotations

import base64
import html
import json
from importlib.util import find_spec
from pathlib import Path
from typing import Iterable, Sequence

import numpy as np

from ..errors import MapRacingError
from ..files import for_json
from ..printing import printable
from ..resources import config_directory

__all__ = ["Markup", "document", "escape", "heading_of", "pack", "plotly_script", "table"]

_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)
# Largest integer of a packed number; the one below its negative stands for NaN.
_MOST = 32767


class Markup(str):
    """Text that is already HTML; `escape` leaves it unchanged."""


def escape(text: object) -> str:
    """Text escaped for HTML, including attributes; NaN becomes a dash."""
    if isinstance(text, Markup):
        return text
    if isinstance(text, float) and text != text:
        return "&ndash;"
    readable = str(text).encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    # Marks that change the writing direction would also affect the text beside them.
    return html.escape(printable(readable, lines=True), quote=True)


def heading_of(name: str, among: Sequence) -> str:
    """Heading with the name of a run, if there are several."""
    return f"<h3>{escape(name)}</h3>\n" if len(among) > 1 else ""


def table(head: Sequence[str], rows: Iterable[Sequence], kind: str = "") -> str:
    """A table; cells are escaped.

    Parameters
    ----------
    head : sequence of str
    rows : iterable of sequences
    kind : str, optional
        Class of the element; each cell of a ``"summary"`` has its title, for narrow screens.
    """
    titles = [escape(cell) for cell in head]
    heads = [f' data-head="{title}"' if kind == "summary" else "" for title in titles]
    lines = []
    for row in rows:
        cells = (f"<td{title}>{escape(cell)}</td>" for title, cell in zip(heads, row))
        lines.append(f"<tr>{''.join(cells)}</tr>\n")
    cells = "".join(f'<th scope="col">{title}</th>' for title in titles)
    return (
        f'<div class="scroll"><table class="{escape(kind)}"><thead><tr>{cells}</tr></thead>\n'
        f"<tbody>{''.join(lines)}</tbody></table></div>\n"
    )


def pack(values: np.ndarray | None) -> dict | None:
    """Numbers as base64 of 16-bit integers, ``o + k q``, for the page's script; None stays None.

    They are exact to 1/65,000 of their range; values that are not finite become unknown.

    Parameters
    ----------
    values : array_like of n numbers, or None

    Returns
    -------
    dict or None
        ``b``, the integers q, ``o`` and ``k``.
    """
    if values is None:
        return None
    values = np.asarray(values, dtype=float)
    finite = np.isfinite(values)
    low, high = (values[finite].min(), values[finite].max()) if finite.any() else (0.0, 0.0)
    step = (high - low) / (2 * _MOST) or 1.0
    middle = 0.5 * (low + high)
    whole = np.where(
        finite, np.rint((np.where(finite, values, middle) - middle) / step), -_MOST - 1
    )
    packed = whole.astype("<i2").tobytes()
    return {
        "b": base64.b64encode(packed).decode("ascii"),
        "k": float(f"{step:.7g}"),
        "o": float(f"{middle:.9g}"),
    }


def plotly_script() -> str:
    """Source of plotly.js from the package plotly.

    Raises
    ------
    MapRacingError
        If it is not installed.
    """
    found = find_spec("plotly")
    if found is None or found.origin is None:
        raise MapRacingError("a report needs plotly: pip install 'map_racing[report]'")
    path = Path(found.origin).parent / "package_data" / "plotly.min.js"
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise MapRacingError(f"{path}: cannot read plotly.js: {error.strerror}") from None


def document(
    title: str, body: str, data: object = None, scripts: Sequence[str] = (), plotly: bool = False
) -> str:
    """A complete page.

    Parameters
    ----------
    title : str
    body : str
        HTML.
    data : object, optional
        For the scripts, as JSON in the element ``data``.
    scripts : sequence of str, optional
        Names of shipped files in ``config/pages``.
    plotly : bool, optional
        Whether the scripts draw with plotly.js.

    Returns
    -------
    str

    Raises
    ------
    MapRacingError
        If plotly is wanted, but not installed.
    """
    folder = config_directory() / "pages"
    style = (folder / "page.css").read_text(encoding="utf-8")
    parts = [
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n',
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n',
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n',
        '<meta name="generator" content="map_racing">\n<link rel="icon" href="data:,">\n',
        f"<title>{escape(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n{body}",
    ]
    if data is not None:
        text = json.dumps(for_json(data), separators=(",", ":"), allow_nan=False)
        # So that the JSON can contain neither the end of the script nor a comment.
        parts.append(f'<script type="application/json" id="data">{_harmless(text)}</script>\n')
    if plotly:
        parts.append(f"<script>{plotly_script()}</script>\n")
    for name in scripts:
        source = (folder / name).read_text(encoding="utf-8")
        parts.append(f"<script>\n{source}</script>\n")
    return "".join([*parts, "</body>\n</html>\n"])


def _harmless(text):
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
