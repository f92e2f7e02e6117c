"""Which clock stamped the messages of a recording.

A message is received shortly after it was stamped. If the lags from stamp to receipt of two topics
differ by more than latency explains, or a lag changes suddenly, the stamps come from clocks that do
not agree. All times of receipt come from one clock, the recorder's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = [
    "COMMAND_DELAY_NS",
    "LATENCY_NS",
    "Clock",
    "coarse_note",
    "mended",
    "rate_note",
    "stamps_are_unusable",
]

LATENCY_NS = 15 * 10**7
"""Longest latency [ns]: if the lags of two topics differ by more, their clocks differ."""
COMMAND_DELAY_NS = 5 * 10**7
"""Longest time from stamp to receipt [ns] of commands and sensors; only localization, which
computes in between, takes longer."""

_SECOND = 10**9
# Synchronized clocks differ by up to this [ns]: a stamp may be that far in the future.
_FUTURE = 2 * 10**7
# If the lags spread by more [ns] around their median, the offset of the clocks is not constant.
_STEADY = 5 * 10**7
# A clock was set during the recording if more than this share of the lags is farther than any
# latency from the median,
_STRAYED = 0.1
# or this many in a row are, for longer than this [ns], while the lag of the poses is as usual.
_IN_A_ROW, _STRAYED_NS = 10, 5 * 10**8
# `rate_note`: smallest difference in rate that no two computers have, shortest recording that shows
# it [ns], and in how many parts the drift must be even, which excludes a recorder that stalls.
_RATE, _LONG_RUN, _PARTS = 0.003, 10 * 10**9, 20
# Smallest step [ns] between two stamps that counts as a clock that was set, and number of samples
# on each side that must show it.
_STEP, _AROUND = 2 * 10**8, 50
# Only the first steps are examined.
_MOST_STEPS = 200
# Stamps are too coarse if a smaller share of them differs, while at least the second share of the
# times of receipt does.
_COARSE, _FINE = 0.5, 0.9
# Two times are the same if they differ by less than this share of the mean step.
_SAME = 0.05
# Messages that share a coarse stamp are received over more than this share of the time until the
# next stamp; repeated messages arrive together.
_SPREAD = 0.5
# Fewest messages that share a stamp that is too coarse, and fewest other messages from which the
# usual lag is taken.
_SEVERAL_ON_ONE, _FEW_GOOD = 4, 10
# Smallest step back [ns] of a clock that was set, if the spread of the lags is at most the second
# number times the step; and number of messages over which the drift is measured.
_STEP_BACK, _LAG_NOISE, _SEVERAL = 2 * 10**7, 0.5, 10


class Clock(NamedTuple):
    """The clock of the poses, to which other topics are brought.

    Attributes
    ----------
    received : ndarray of int64, shape (n,)
        When the poses were received [ns].
    lag : ndarray of int64, shape (n,)
        Time of receipt minus stamp of each [ns].
    use_receipt : bool
        Whether the times of receipt are used because the stamps are unusable.
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
        # Not counted: messages that a stalled recorder received all at once.
        past = np.diff(received)
        alone = np.append(True, past > _SAME * np.sum(past) / received.size)
        far = np.abs(apart - offset) > LATENCY_NS
        usual = np.abs(expected - np.median(theirs)) < LATENCY_NS // 2
        strayed = np.mean(far[alone]) > _STRAYED
        strayed = strayed or _for_long(received[alone], (far & usual)[alone])
        if -LATENCY_NS <= offset <= delay_ns and not impossible and not strayed:
            return stamps
        steady = not strayed and np.percentile(np.abs(apart - offset), 90) < _STEADY
        where = f", {_seconds(offset)} than the poses'"
        if strayed and abs(offset) < LATENCY_NS:
            where = " than the poses' for a part of the time"
        notes.append(
            f"warning: {topic}: the stamps are from another clock{where}"
            + (": shifted" if steady else ", with a varying offset: times of receipt used")
        )
        return stamps + offset if steady else received - expected


def _for_long(times, far):
    """Whether many in a row are far off, for long enough."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], far.astype(int), [0]))))
    begins, ends = edges[::2], edges[1::2] - 1
    long = (ends - begins >= _IN_A_ROW) & (times[ends] - times[begins] > _STRAYED_NS)
    return bool(long.any())


def _seconds(offset):
    amount = abs(offset) / _SECOND
    text = f"{amount:.3f} s" if amount < 1e5 else f"{amount / 86400:.1f} days"
    return f"{text} {'earlier' if offset > 0 else 'later'}"


def stamps_are_unusable(stamps: np.ndarray, received: np.ndarray) -> str | None:
    """Reason for a note why the stamps are worse than the times of receipt; None if they are not.

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
    # Messages received out of order have fine stamps.
    sizes = (past, np.diff(np.sort(stamps)))
    fine, coarse = (np.count_nonzero(steps > _SAME * np.mean(steps)) for steps in sizes)
    if fine > _FINE * past.size and coarse < _COARSE * ahead.size and _shared(stamps, received):
        return "header stamps are too coarse, with several messages on each"
    # Time was set forward, or back by so little that it could be transport delay.
    forward = (ahead > _STEP) & (past < _STEP)
    backward = (ahead < 0) & (past - ahead > _STEP_BACK)
    steps = np.flatnonzero(forward | backward) + 1
    if not steps.size:
        return None
    # A bag that was played at another rate and recorded again has lags that change steadily.
    lag = received - stamps
    # Over several messages, because messages that overtake each other come in pairs.
    several = min(_SEVERAL, stamps.size - 1)
    slope = float(np.median(lag[several:] - lag[:-several])) / several
    lag = lag - (slope * np.arange(stamps.size)).astype(np.int64)
    for index in steps[:_MOST_STEPS]:
        before, after = lag[max(index - _AROUND, 0) : index], lag[index : index + _AROUND]
        if min(before.size, after.size) < 5:
            continue
        step = float(np.median(before) - np.median(after))
        least, share = _STEP, 0.5
        if step < 0.0 and ahead[index - 1] < 0:
            noise = max(
                float(np.subtract(*np.percentile(part, (90, 10)))) for part in (before, after)
            )
            least, share = max(_STEP_BACK, noise / _LAG_NOISE), 0.8
        if abs(step) > least and abs(step) > share * abs(ahead[index - 1] - past[index - 1]):
            way = "ahead" if step > 0.0 else "back"
            by = abs(step) / _SECOND
            return f"header stamps jump {way} by {by:.{1 if by >= 0.2 else 2}f} s"
    return None


def mended(
    stamps: np.ndarray, received: np.ndarray, changed: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Stamps with the coarse ones replaced by times of receipt, and how accurate those are.

    Some drivers write 0, or whole seconds, until their clock is set. These stamps become times of
    receipt minus the usual lag of the others, so that all are on one clock.

    Parameters
    ----------
    stamps, received : ndarray of int64, shape (n,)
        In the order of recording [ns].
    changed : ndarray of bool, shape (n,)
        Whether the content of a message differs from the one before.

    Returns
    -------
    stamps : ndarray of int64, shape (n,)
        None of them is 0.
    which : ndarray of bool, shape (n,)
        Those that were too coarse.
    spread : float
        95 % spread of the lag of the others [s]; 0 without any.
    """
    unstamped, coarse = stamps == 0, np.zeros(stamps.size, dtype=bool)
    stamps, order = np.where(unstamped, received, stamps), np.argsort(received, kind="mergesort")
    coarse[order] = _coarse(stamps[order], received[order], changed[order])
    coarse &= ~unstamped
    good = ~(unstamped | coarse)
    if np.count_nonzero(good) < _FEW_GOOD or good.all():
        return stamps, np.zeros(stamps.size, dtype=bool), 0.0
    early, usual, late = np.percentile(received[good] - stamps[good], (2.5, 50.0, 97.5))
    stamps = np.where(good, stamps, received - int(usual))
    return stamps, coarse, 1e-9 * float(late - early)


def coarse_note(what: str, coarse: np.ndarray, spread: float) -> str:
    """Warning of stamps that `mended` replaced; the arguments are a name and its results."""
    return (
        f"warning: {what}: {np.count_nonzero(coarse)} of {coarse.size} stamps are too coarse, with "
        f"several messages on each: times of receipt used instead, accurate to {spread:.3f} s"
    )


def _coarse(stamps, received, changed):
    """Mask of messages with a coarse stamp: they were received over the whole time until the next.

    Repeated messages, from a localization that hangs, are not counted.
    """
    coarse = np.zeros(stamps.size, dtype=bool)
    begins = np.flatnonzero(np.append(True, np.diff(stamps) != 0))
    ends = np.append(begins[1:], stamps.size)
    steps = np.diff(received)
    least = _SAME * float(np.mean(steps)) if steps.size else 0.0
    several = ends - begins >= _SEVERAL_ON_ONE
    for begin, end in zip(begins[several].tolist(), ends[several].tolist()):
        count = end - begin
        if np.mean(changed[begin + 1 : end]) < 0.5:
            continue
        until = received[min(end, stamps.size - 1)] - received[begin]
        spread = received[end - 1] - received[begin]
        even = np.mean(steps[begin : end - 1] > least) > _FINE
        coarse[begin:end] = even and spread > _SPREAD * until * (count - 1) / count
    return coarse


def _shared(stamps, received):
    """Whether messages with the same stamp were received over the whole time until the next."""
    order = np.argsort(stamps, kind="mergesort")
    stamps, received = stamps[order], received[order]
    steps = np.diff(stamps)
    begins = np.flatnonzero(np.append(True, steps > _SAME * np.mean(steps)))
    if begins.size < 2:
        return True
    counts = np.diff(np.append(begins, stamps.size))
    first, last = (f.reduceat(received, begins) for f in (np.minimum, np.maximum))
    until = np.diff(first) * (counts[:-1] - 1) / counts[:-1]
    several = counts[:-1] > 1
    if not several.any():
        return True
    return bool(np.median((last - first)[:-1][several]) > _SPREAD * np.median(until[several]))


def rate_note(topic: str, stamps: np.ndarray, received: np.ndarray) -> str:
    """Note on stamps that run faster or slower than the times of receipt, or empty.

    This happens in a simulation that does not run in real time, or with a bag that was played at
    another rate.
    """
    span = int(received[-1] - received[0]) if received.size > 100 else 0
    if span < _LONG_RUN or np.any(np.diff(received) < 0) or np.any(np.diff(stamps) < 0):
        return ""
    lags = [float(np.median(part)) for part in np.array_split(received - stamps, _PARTS)]
    slope, first = np.polyfit(np.arange(_PARTS), lags, 1)
    rate = 1.0 - _PARTS * slope / (span * received.size / (received.size - 1))
    off = np.abs(slope * np.arange(_PARTS) + first - lags)
    if abs(rate - 1.0) < _RATE or np.max(off) > abs(slope):
        return ""
    return (
        f"{topic}: its stamps advance by {rate:.3f} s per second of receipt: lap times follow the "
        "stamps"
    )
