"""Colors of markers."""

from __future__ import annotations

from std_msgs.msg import ColorRGBA

__all__ = ["WALL", "gradient"]

# The color map viridis, as in the figures; brighter means a larger value.
_STOPS = (
    (0.27, 0.00, 0.33),
    (0.23, 0.32, 0.55),
    (0.13, 0.57, 0.55),
    (0.37, 0.79, 0.38),
    (0.99, 0.91, 0.14),
)

WALL = (0.55, 0.55, 0.55)


def gradient(fraction: float, alpha: float = 1.0) -> ColorRGBA:
    """Color from dark violet over teal to yellow.

    Parameters
    ----------
    fraction : float
        From 0 to 1, clipped.

    Returns
    -------
    std_msgs/ColorRGBA
    """
    at = min(max(fraction, 0.0), 1.0) * (len(_STOPS) - 1)
    index = min(int(at), len(_STOPS) - 2)
    part = at - index
    below, above = _STOPS[index], _STOPS[index + 1]
    return ColorRGBA(*(b + part * (a - b) for b, a in zip(below, above)), alpha)
