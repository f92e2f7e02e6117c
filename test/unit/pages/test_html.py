"""Pages: nothing from outside becomes markup, numbers keep their precision."""

import base64
import html
import json
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from map_racing.errors import MapRacingError
from map_racing.pages import html as pages
from map_racing.pages.html import document, escape, pack, table

EVIL = "</script><script>alert(1)</script><!-- & \" ' \u2028\u202e"
SHOWN = EVIL[:-2] + "\\u2028\\u202e"  # marks that change the writing direction are escaped


def unpacked(packed):
    whole = np.frombuffer(base64.b64decode(packed["b"]), "<i2")
    return np.where(whole == -32768, np.nan, packed["o"] + packed["k"] * whole)


@given(arrays(float, st.integers(1, 50), elements=st.floats(-1e6, 1e6)))
def test_numbers_are_exact_to_a_fraction_of_their_range(values):
    error = np.max(np.abs(unpacked(pack(values)) - values))
    assert error <= np.ptp(values) / 60_000 + 1e-8 * np.max(np.abs(values)) + 1e-300


def test_unknown_numbers():
    found = unpacked(pack(np.array([1.0, np.nan, np.inf, 3.0])))
    assert np.isnan(found[1:3]).all() and found[[0, 3]] == pytest.approx([1.0, 3.0], abs=1e-4)
    assert np.isnan(unpacked(pack(np.array([np.nan])))).all()
    assert unpacked(pack(np.full(3, 2.5))).tolist() == [2.5] * 3
    assert pack(None) is None


def test_names_are_never_markup():
    body = f"<p>{escape(EVIL)}</p>" + table([EVIL], [[EVIL]], "summary")
    page = document(EVIL, body, {"name": EVIL, "x": float("nan")})
    assert page.count("<script") == 1 and "<!--" not in page and "alert(1)<" not in page
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)
    assert json.loads(data.group(1)) == {"name": EVIL, "x": None}
    assert html.unescape(re.search("<title>(.*?)</title>", page, re.S).group(1)) == SHOWN
    assert "default-src 'none'" in page


def test_names_that_are_not_text():
    assert escape("run_\udcff.bag") == "run_?.bag" or "\ufffd" in escape("run_\udcff.bag")
    assert escape(float("nan")) == "&ndash;" and escape(3) == "3"


def test_without_plotly(monkeypatch):
    monkeypatch.setattr(pages, "find_spec", lambda name: None)
    with pytest.raises(MapRacingError, match=r"pip install 'map_racing\[report\]'"):
        document("t", "", plotly=True)
