"""Sliding minimum and maximum over irregular stamps."""

from __future__ import annotations

import operator
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Sequence

INF = float('inf')


def empty_value(lowest: bool) -> float:
    """The least (greatest) of no values: +inf (-inf)."""
    return INF if lowest else -INF


def slide(
    stamps_ns: Sequence[int],
    values: Sequence[float],
    rows: range,
    low_ns: float,
    high_ns: float,
    lowest: bool,
) -> list[float]:
    """Extreme value in the closed window [t + low, t + high] of each row, in linear time.

    A monotonic queue holds the candidates (Lemire, Streaming maximum-minimum filter using no more
    than three comparisons per element, 2006).

    Args:
        stamps_ns: strictly increasing stamps [ns].
        values: value at each stamp; stamps beyond the last value have none.
        rows: indices of the samples to do, ascending.
        low_ns: start of the window relative to the sample [ns]; an int, or -inf.
        high_ns: its end relative to the sample [ns]; an int, or inf.
        lowest: True for the minimum.

    Returns:
        One value for each row; an empty window gives :func:`empty_value`.
    """
    keeps_older: Callable[[float, float], bool] = operator.lt if lowest else operator.gt
    nothing = empty_value(lowest)
    known = len(values)
    at = bisect_left(stamps_ns, stamps_ns[rows.start] + low_ns, 0, known) if rows else 0
    queue: deque[int] = deque()
    out: list[float] = []
    for row in rows:
        start, end = stamps_ns[row] + low_ns, stamps_ns[row] + high_ns
        while at < known and stamps_ns[at] <= end:
            value = values[at]
            while queue and not keeps_older(values[queue[-1]], value):
                queue.pop()
            queue.append(at)
            at += 1
        while queue and stamps_ns[queue[0]] < start:
            queue.popleft()
        out.append(values[queue[0]] if queue else nothing)
    return out
