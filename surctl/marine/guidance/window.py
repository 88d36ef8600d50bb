"""The window of a path that a law sees, for missions of any length, speed and depth.

A law has a fixed array of `MAX_WAYPOINTS` waypoints, and one number each for depth, cruise speed and visits. Its host
(the simulation, or the robot's computer) feeds it: before every control step, the host writes the waypoints around the
target point, and the depth, speed and visit of the segment that the target point is on. All hosts follow one rule:

- The window has the path's first waypoint, then six waypoints in a row from number `first` on, then the path's last
  waypoint. First and last are always there because a law looks at its start and at its destination. The window's legs
  before and after the six waypoints are not those of the path, but the target point is never on them.
- When the target point has left the second of the six waypoints' segments behind (by `AT_CORNER`), the window moves on
  by one waypoint, at most once in a control step. The law measures arc lengths along its window, so every arc length in
  its state changes by the difference of the lengths of the leg from the path's first waypoint to the six.
- Segment of the target point is the last one whose start is more than `AT_CORNER` behind. Its end says the speed and
  whether the law must visit it; the depth is linear between its ends.

A path of `MAX_WAYPOINTS` points or fewer fits in the window, which then never moves. `Window` is the rule as numbers,
`window_next` and `window_values` are the rule as CasADi expressions; `surctl.export.mission_files` writes it in C.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import sqrt

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.marine.guidance.path import AT_CORNER, MAX_WAYPOINTS

__all__ = ["AHEAD", "ROW", "SHORTEST", "Window", "last_first", "window_next", "window_values"]

ROW = 5
"""Numbers of a waypoint in a mission's table: x, y, rise, speed, kind."""

AHEAD = MAX_WAYPOINTS - 2
"""Number of waypoints in a row in the window."""

SHORTEST = 1e-6  # [m] as in `path_target`


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

    Example:
        >>> from surctl.marine.guidance import Path, Window
        >>> stairs = Path([[k // 2, (k + 1) // 2] for k in range(12)])
        >>> window = Window(stairs.table(), depth=-1.0, cruise=0.2, visit=0.05)
        >>> window.move(3.5), window.first, window.waypoints()[[0, 1, 6, 7]].tolist()
        (-0.5857864376269049, 2, [[0.0, 0.0], [1.0, 1.0], [3.0, 4.0], [5.0, 6.0]])
        >>> window.values(3.5 - 0.5857864376269049)
        (-1.0, 0.2, 0.0)
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
        behind = _apart(start, one) + _apart(one, two)
        if not progress > behind + _apart(two, three) + AT_CORNER:
            return 0.0
        self.first += 1
        return _apart(start, two) - behind

    def values(self, progress: float) -> tuple[float, float, float]:
        """Return the depth z [m], the cruise speed [m/s] and the visit distance [m] (0: none) at the target point."""
        rows = [self._rows[k] for k in self._numbers()]
        passed, at, here = 0.0, 0.0, (rows[0], rows[1])
        length = chord = _apart(*here)
        for k, pair in enumerate(pairwise(rows)):
            chord = _apart(*pair)
            if k == 0 or progress > passed + AT_CORNER:
                here, at, length = pair, passed, chord
            passed = passed + chord
        share = min(max((progress - at) / max(length, SHORTEST), 0.0), 1.0)
        before, end = here
        rise = before[2] + (end[2] - before[2]) * share
        return (
            self._depth + rise,
            end[3] if end[3] > 0.0 else self._cruise,
            self._visit if end[4] > 0.0 else 0.0,
        )


def _apart(a: Sequence[float], b: Sequence[float]) -> float:
    x, y = b[0] - a[0], b[1] - a[1]
    return sqrt(x * x + y * y)


def window_next(first: ca.SX, progress: ca.SX, rows: ca.SX, start: ca.SX, last: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the window's next number `first`, and the change of every arc length in the law, as CasADi expressions.

    Args:
        first: present number of the window's first waypoint in a row.
        progress: arc length of the target point along the window [m].
        rows: (3, k) waypoints from number `first` on; the columns begin with x, y [m].
        start: (2, 1) the path's first waypoint [m].
        last: largest number `first`, see `last_first`.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.guidance import window_next
        >>> rows, start = ca.DM([[0, 1], [1, 1], [1, 2]]), ca.DM([0, 0])
        >>> moved, shift = window_next(ca.DM(1), ca.DM(3.5), rows, start, ca.DM(9))
        >>> float(moved), round(float(shift), 4)
        (2.0, -0.5858)
    """
    one, two, three = (rows[k, :2].T for k in range(3))
    behind = _norm(one - start) + _norm(two - one)
    moves = ca.logic_and(first < last, progress > behind + _norm(three - two) + AT_CORNER)
    return first + moves, ca.if_else(moves, _norm(two - start) - behind, 0)


def window_values(
    rows: ca.SX, progress: ca.SX, *, depth: ca.SX, cruise: ca.SX, visit: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return depth z [m], cruise speed [m/s] and visit distance [m] at the target point, as CasADi expressions.

    Args:
        rows: (`MAX_WAYPOINTS`, 5) rows of the mission's table in the window.
        progress: arc length of the target point along the window [m].
        depth, cruise, visit: as for `Window`.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.guidance import Path, window_values
        >>> table = Path([[0, 0], [2, 0], [2, 3]], rises=[0, -1, -1], speeds=[0, 0.3, 0]).table(visits=True)
        >>> rows = ca.DM(table[[0, 1, 2, 2, 2, 2, 2, 2]])
        >>> [float(v) for v in window_values(rows, ca.DM(1.0), depth=ca.DM(-2), cruise=ca.DM(0.2), visit=ca.DM(0.1))]
        [-2.5, 0.3, 0.1]
    """
    passed, share, before, end = ca.SX(0), ca.SX(0), rows[0, :], rows[1, :]
    for k in range(MAX_WAYPOINTS - 1):
        chord = _norm((rows[k + 1, :2] - rows[k, :2]).T)
        here = ca.SX(1) if k == 0 else progress > passed + AT_CORNER
        along = ca.fmin(ca.fmax((progress - passed) / ca.fmax(chord, SHORTEST), 0), 1)
        share = ca.if_else(here, along, share)
        before, end = ca.if_else(here, rows[k, :], before), ca.if_else(here, rows[k + 1, :], end)
        passed = passed + chord
    rise = before[2] + (end[2] - before[2]) * share
    return depth + rise, ca.if_else(end[3] > 0, end[3], cruise), ca.if_else(end[4] > 0, visit, 0)


def _norm(chord: ca.SX) -> ca.SX:
    return ca.sqrt(ca.sumsqr(chord))
