"""The window of a mission as numbers: what a law's host feeds it, without CasADi."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from surctl.ir import Layout
from surctl.marine.control import ARC_LENGTHS, FED
from surctl.marine.guidance.following import AHEAD, SHORTEST
from surctl.marine.guidance.path import AT_CORNER

Vector = NDArray[np.float64]


def last_first(count: int) -> int:
    """Return the largest number `first` of a path with `count` waypoints: the window then holds the path's end."""
    return max(1, count - 1 - AHEAD)


class Window:
    """The window of one mission, as numbers; it moves with the target point.

    Args:
        table: (n, 5) one row for each waypoint, see `Path.table`.
        depth: z of the mission [m], to which the rises are added.
        cruise: speed [m/s] on segments without a speed of their own.
        visit: distance [m] to a corner to visit that counts as a visit.

    Attributes:
        first: number of the first of the waypoints in a row, counted from 0.
    """

    def __init__(self, table: NDArray[np.float64], *, depth: float, cruise: float, visit: float) -> None:
        self._rows = [tuple(map(float, row)) for row in np.asarray(table, dtype=float)]
        self._places = np.asarray(table, dtype=float)[:, :2]
        self._depth, self._cruise, self._visit = float(depth), float(cruise), float(visit)
        self.first = 1

    def _numbers(self) -> list[int]:
        last = len(self._rows) - 1
        return [0, *(min(self.first + k, last) for k in range(AHEAD)), last]

    def waypoints(self) -> NDArray[np.float64]:
        """Return the waypoints in the window (`MAX_WAYPOINTS`, 2) [m]."""
        return self._places[self._numbers()]

    def move(self, progress: float) -> float:
        """Move the window on if the target point is far enough; return the change of every arc length in the law [m].

        `progress` is the arc length of the target point along the window [m].
        """
        if self.first >= last_first(len(self._rows)):
            return 0.0
        start = self._rows[0]
        one, two, three = self._rows[self.first : self.first + 3]
        behind = _distance(start, one) + _distance(one, two)
        if not progress > behind + _distance(two, three) + AT_CORNER:
            return 0.0
        self.first += 1
        return _distance(start, two) - behind

    def values(self, progress: float) -> tuple[float, float, float]:
        """Return the depth z [m], the cruise speed [m/s] and the visit distance [m] (0: none) at the target point."""
        rows = [self._rows[k] for k in self._numbers()]
        passed, at, here = 0.0, 0.0, (rows[0], rows[1])
        length = chord = _distance(*here)
        for k, pair in enumerate(pairwise(rows)):
            chord = _distance(*pair)
            if k == 0 or progress > passed + AT_CORNER:
                here, at, length = pair, passed, chord
            passed = passed + chord
        share = min(max((progress - at) / max(length, SHORTEST), 0.0), 1.0)
        before, end = here
        rise = before[2] + (end[2] - before[2]) * share
        return (self._depth + rise, end[3] if end[3] > 0.0 else self._cruise, self._visit if end[4] > 0.0 else 0.0)


def _distance(a: Sequence[float], b: Sequence[float]) -> float:
    x, y = b[0] - a[0], b[1] - a[1]
    return sqrt(x * x + y * y)


class Feeder:
    """The host of a law during one mission: it moves the window and writes the law's parameters.

    Args:
        table: (n, 5) one row for each waypoint, see `Path.table`.
        p: parameters of the mission; `depth`, `cruise` and `visit` are the mission's own, see `guidance.Window`.
    """

    def __init__(self, table: Vector, state: Layout, parameters: Layout, p: Vector) -> None:
        def number(name: str) -> float:
            return float(p[parameters.slice(name)][0])

        self._window = Window(table, depth=number("depth"), cruise=number("cruise"), visit=number("visit"))
        self._progress = state.slice("progress").start
        self._arcs = [state.slice(name).start for name in ARC_LENGTHS if name in state]
        self._slices = {name: parameters.slice(name) for name in FED}
        self._base, self._waypoints = p, self._window.waypoints().ravel()

    def feed(self, x: Vector) -> tuple[Vector, Vector]:
        """Return the state of the law and its parameters for the next control step."""
        first, shift = self._window.first, self._window.move(float(x[self._progress]))
        if self._window.first != first:  # the shift is 0 where the path goes straight on
            x = x.copy()
            x[self._arcs] += shift
            self._waypoints = self._window.waypoints().ravel()
        p = self._base.copy()
        p[self._slices["waypoints"]] = self._waypoints
        values = self._window.values(float(x[self._progress]))
        for name, value in zip(FED[1:], values, strict=True):
            p[self._slices[name]] = value
        return x, p
