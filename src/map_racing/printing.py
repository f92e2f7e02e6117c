"""Safe output to a terminal: control characters are shown as text, not executed.

The name of a topic, column or file may contain sequences that make a terminal erase its contents,
change its title, or write from right to left.
"""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from typing import Iterator

__all__ = ["amount", "printable", "printing"]

# C0, delete and C1; marks that change the writing direction; line separators.
_CODES = (*range(0x20), *range(0x7F, 0xA0), 0x61C, 0x200E, 0x200F)
_CODES += (*range(0x2028, 0x202F), *range(0x2066, 0x206A))
_NAMES = {code: chr(code).encode("unicode_escape").decode("ascii") for code in _CODES}
_TEXTS = {code: name for code, name in _NAMES.items() if chr(code) not in "\n\t"}


def printable(text: str, lines: bool = False) -> str:
    r"""A text with control characters written out, such as ``\x1b``.

    Parameters
    ----------
    text : str
    lines : bool, optional
        Whether it may have several lines and tabs; a name has one.

    Returns
    -------
    str
    """
    return text if text.isprintable() else text.translate(_TEXTS if lines else _NAMES)


def amount(count: int, one: str, several: str = "") -> str:
    """A number of things in words: "1 lap", "2 laps"."""
    return f"{count} {one if count == 1 else several or one + 's'}"


class _Harmless:
    """A stream that passes text through `printable`."""

    def __init__(self, stream):
        self._stream = stream

    def __getattr__(self, name):
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text; its length."""
        # Progress bars return to the start of their line, which is harmless.
        inner = text.strip("\r")
        if not inner.isprintable():
            text = text.replace(inner, printable(inner, lines=True))
        self._stream.write(text)
        return len(text)


@contextmanager
def printing() -> Iterator[None]:
    """Make stdout and stderr safe for any characters on any terminal."""
    with ExitStack() as stack:
        for stream, redirect in ((sys.stdout, redirect_stdout), (sys.stderr, redirect_stderr)):
            if stream is None:
                # Progress bars ask whether it is a terminal.
                stream = stack.enter_context(open(os.devnull, "w", encoding="utf-8"))
            if hasattr(stream, "reconfigure"):
                stream.reconfigure(errors="backslashreplace")
            stack.enter_context(redirect(_Harmless(stream)))
        yield
