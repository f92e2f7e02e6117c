import io
import sys

import pytest

from map_racing.errors import MapRacingError
from map_racing.printing import printable, printing


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("/car_state/odom", "/car_state/odom"),
        ("Z\u00fcrich \u8d5b \U0001f3ce", "Z\u00fcrich \u8d5b \U0001f3ce"),
        ("\x1b[2Jodom\x07", r"\x1b[2Jodom\x07"),
        ("a\x7f\x9b31m", r"a\x7f\x9b31m"),
        ("a\r\n\tb", r"a\r\n\tb"),
        ("a\u202egab.bag\u2066", r"a\u202egab.bag\u2066"),
        ("r\udcfcn", "r\udcfcn"),  # a file name that is not UTF-8
    ],
)
def test_control_characters_of_a_name_are_written_out(text, shown):
    assert printable(text) == shown


def test_a_text_may_have_lines():
    assert printable("a\tb\n\x1bc", lines=True) == "a\tb\n\\x1bc"


def test_errors_too():
    assert str(MapRacingError("\x1b]0;x\x07.csv:3:\r no")) == r"\x1b]0;x\x07.csv:3:  no"


def test_streams_print_by_it_and_are_themselves_again(monkeypatch):
    out, err = io.StringIO(), io.StringIO()
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", err)
    with printing():
        print("one\x1b[1m", "two")
        print("\rover\rwritten\r", file=sys.stderr, end="")
        assert not sys.stderr.isatty()
    assert (sys.stdout, sys.stderr) == (out, err)
    assert out.getvalue() == "one\\x1b[1m two\n"
    # A progress bar may return to the start of its line, but no text can hide what precedes it.
    assert err.getvalue() == "\rover\\rwritten\r"
