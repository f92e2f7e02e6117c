"""Whose clock stamped the messages of a recording.

A message is received shortly after it was stamped. Where the lag between stamp and receipt differs
between two topics by more than latency explains, or becomes another all at once, their stamps come
from clocks that do not agree; the times of receipt are all of one clock, the recorder's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = ["COMMAND_DELAY_NS", "LATENCY_NS", "Clock", "stamps_are_unusable"]

LATENCY_NS = 15 * 10**7
"""Larger differences between the lags of two topics [ns] are no latency."""
COMMAND_DELAY_NS = 5 * 10**7
"""Commands are stamped when they are sent, sensors when they measure, and none is received later
than that [ns]; only localization computes for longer."""

_SECOND = 10**9
# The future that a stamp of the same clock may be in [ns]: synchronized clocks differ so much.
_FUTURE = 2 * 10**7
# If the lags spread by more [ns] around their median, the offset of the clocks is not constant.
_STEADY = 5 * 10**7
# A step of the stamps [ns] that time itself did not make, and samples on both sides that show it.
_STEP, _AROUND = 2 * 10**8, 50
# Steps that are looked at; stamps that jump more often are of no clock.
_MOST_STEPS = 200
# Share of different stamps below which they are too coarse, and of receipts above which they are
# good.
_COARSE, _FINE = 0.5, 0.9
# Steps shorter than this share of the mean are none.
_SAME = 0.05


class Clock(NamedTuple):
    """The clock of the poses, to which other topics are brought.

    Attributes
    ----------
    received : ndarray of int64, shape (n,)
        When the poses were received [ns].
    lag : ndarray of int64, shape (n,)
        Time of receipt minus stamp of each [ns].
    use_receipt : bool
        Whether the times of receipt are the times, since stamps are unusable.
    """

    received: np.ndarray
    lag: np.ndarray
    use_receipt: bool = False

    def times(
        self,
        stamps: np.ndarray,
        received: np.ndarray,
        notes: list[str],
        topic: str,
        delay_ns: int = LATENCY_NS,
    ) -> np.ndarray:
        """Times on this clock [ns] of the messages of a topic.

        Parameters
        ----------
        stamps, received : ndarray of int64, shape (k,)
            Stamps and times of receipt [ns].
        notes : list of str
            Gets a warning if the stamps are from another clock.
        topic : str
        delay_ns : int, optional
            How much longer than the poses the messages may take from stamp to receipt [ns].

        Returns
        -------
        ndarray of int64, shape (k,)
        """
        if self.use_receipt:
            return received
        if not (stamps.size and self.received.size):
            return stamps
        lag = received - stamps
        at, theirs = self.received, self.lag
        if np.any(at[1:] < at[:-1]):
            order = np.argsort(at, kind="mergesort")
            at, theirs = at[order], theirs[order]
        # Relative to the first, so that nanoseconds are exact in floats.
        expected = np.interp(
            (received - at[0]).astype(float),
            (at - at[0]).astype(float),
            (theirs - theirs[0]).astype(float),
        )
        expected = expected.astype(np.int64) + theirs[0]
        apart = lag - expected
        offset = int(np.median(apart))
        ahead, sound = sorted((np.median(lag), np.median(expected)))
        impossible = ahead < -_FUTURE and abs(sound) <= _FUTURE
        if -LATENCY_NS <= offset <= delay_ns and not impossible:
            return stamps
        steady = np.percentile(np.abs(apart - offset), 90) < _STEADY
        notes.append(
            f"warning: {topic}: the stamps are from another clock, {_seconds(offset)} than the "
            "poses'" + (": shifted" if steady else ", and not steadily: times of receipt used")
        )
        return stamps + offset if steady else received - expected


def _seconds(offset):
    amount = abs(offset) / _SECOND
    text = f"{amount:.3f} s" if amount < 1e5 else f"{amount / 86400:.1f} days"
    return f"{text} {'earlier' if offset > 0 else 'later'}"


def stamps_are_unusable(stamps: np.ndarray, received: np.ndarray) -> str | None:
    """Why stamps are worse than times of receipt, for a note; None if they are not.

    Parameters
    ----------
    stamps, received : ndarray of int64, shape (n,)
        In the order of recording [ns].

    Returns
    -------
    str or None
    """
    if stamps.size < 10 or np.any(np.diff(received) < 0):
        return None
    ahead, past = np.diff(stamps), np.diff(received)
    fine, coarse = (np.count_nonzero(steps > _SAME * np.mean(steps)) for steps in (past, ahead))
    if fine > _FINE * past.size and coarse < _COARSE * ahead.size:
        return "header stamps are too coarse, with several messages on each"
    # Time was set forward, or back by so little that it might pass for transport.
    forward = (ahead > _STEP) & (past < _STEP)
    backward = (ahead < 0) & (past - ahead > _STEP)
    steps = np.flatnonzero(forward | backward) + 1
    if not steps.size:
        return None
    # A bag that was played at another rate and recorded again has lags that change steadily.
    lag = received - stamps - (np.median(past - ahead) * np.arange(stamps.size)).astype(np.int64)
    for index in steps[:_MOST_STEPS]:
        before, after = lag[max(index - _AROUND, 0) : index], lag[index : index + _AROUND]
        if min(before.size, after.size) < 5:
            continue
        step = float(np.median(before) - np.median(after))
        if abs(step) > _STEP and abs(step) > 0.5 * abs(ahead[index - 1] - past[index - 1]):
            way = "ahead" if step > 0.0 else "back"
            return f"header stamps jump {way} by {abs(step) / _SECOND:.1f} s"
    return None
