"""Bags whose messages are written at 50 moments, 20 ms apart."""

from map_racing.bags.writer import BagWriter

T0 = 1600000000.0
TIMES = [T0 + 0.02 * i for i in range(50)]


def write(path, fill):
    """Write a bag by ``fill(bag, i, t)`` at each moment; return its path."""
    with BagWriter(path) as bag:
        for i, t in enumerate(TIMES):
            fill(bag, i, t)
    return path
