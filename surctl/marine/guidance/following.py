"""Which segment of its path a robot is on, corners visited or missed; the window of a long path for a law.

The nearest segment is not always the right one, because a path may close, cross itself or fold back. The robot starts
on the first segment, and advances to the next one if it is nearer to that than to the rest of its present segment, and
if the part of the path that it would leave out at the corner is at most three times its distance to the present
segment: it may cut a corner on a detour, but not from far away. If corners must be visited, the robot advances only
within the given distance of the corner. On a path that is fed to the law (`Path.fed`), it may advance by up to `SKIPS`
segments at once, because points of a recorded track can be so close together that it comes near no segment between
them.

A law has a fixed array of `MAX_WAYPOINTS` waypoints, and one number each for depth, cruise speed and visits. Its host
(the simulation, or the robot's computer) feeds it: before every control step, the host writes the waypoints around the
target point, and the depth, speed and visit of the segment that the target point is on. All hosts follow one rule:

- The window has the path's first waypoint, then six waypoints in a row from number `first` on, then the path's last
  waypoint, because a law looks at its start and at its destination. The target point is never on the legs before and
  after the six, which are not those of the path.
- When the target point has left the second of the six waypoints' segments behind (by `AT_CORNER`), the window moves on
  by one waypoint, at most once in a control step. Every arc length in the law's state then changes by the difference of
  the lengths of the leg from the path's first waypoint to the six.
- Segment of the target point is the last one whose start is more than `AT_CORNER` behind. Its end says the speed and
  whether the law must visit it; the depth is linear between its ends.

`window_next` and `window_values` are the rule as CasADi expressions, for simulations and exported code.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from math import hypot, sqrt

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.ir import Layout, Port, on_vectors
from surctl.marine.guidance.path import AT_CORNER, MAX_WAYPOINTS, Path

ROW = 5
"""Numbers of a waypoint in a mission's table: x, y, rise, speed, kind."""

AHEAD = MAX_WAYPOINTS - 2
"""Number of waypoints in a row in the window."""

SHORTEST = 1e-6  # [m] as in `path_target`


def window_next(first: ca.SX, progress: ca.SX, rows: ca.SX, start: ca.SX, last: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the window's next number `first`, and the change of every arc length in the law, as CasADi expressions.

    Args:
        progress: arc length of the target point along the window [m].
        rows: (3, k) waypoints from number `first` on; the columns begin with x, y [m].
        start: (2, 1) the path's first waypoint [m].
        last: largest number `first`, with which the window holds the end of the path.
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
        depth, cruise, visit: z of the mission [m], speed [m/s] on segments without one, and distance [m] that counts
            as a visit.
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


_FAR_OFF = 1e30  # [m²] initial squared distance to a corner

FOLLOWING = (
    Port("leg", (1,), "1", "leg of the path that the robot is on, from 0"),
    Port("along", (1,), "m", "largest arc length so far on the present leg"),
    Port("corner_ahead", (1,), "m^2", "least squared distance to the end of the present leg", _FAR_OFF),
    Port("corner_behind", (1,), "m^2", "least squared distance to the start of the present leg; 0 on the first leg"),
    Port("missed", (1,), "m^2", "largest squared distance at which an earlier corner was passed"),
)
"""Entries (name, shape, initial value) of the state of `follow`."""

PASSED = 1 - 1e-9
"""Share of a segment's length at which its end counts as passed."""

SKIPS = 3
"""Number of segments by which a robot may advance at once on a path that is fed to the law (*chosen*)."""

_SHORT_CUT = 3.0  # chosen: cutting a right-angled corner on the diagonal leaves out twice the distance to the leg


class Follower:
    """The segment of a path that a robot is on, and the robot's progress on this segment, by `follow_on`.

    Args:
        path: the path that the robot follows.
        visit: distance [m] to a corner within which the corner counts as visited, if every corner must be visited;
            None: the robot may cut corners. If the path has kinds of corners, `visit` holds for the corners `VISIT`.
    """

    def __init__(self, path: Path, *, visit: float | None = None) -> None:
        self._table, count = path.table(visits=visit is not None), 2 + (SKIPS if path.fed else 1)
        if visit is None:
            self._table[:, 4] = np.minimum(self._table[:, 4], 0.0)
        self._points: list[tuple[float, float]] = path.waypoints.tolist()
        self._rises: list[float] = self._table[:, 2].tolist()
        self._ahead, self._moved = np.arange(count), _moved(count)
        self._visit, self._state = visit or 0.0, Layout(FOLLOWING).pack()

    @property
    def leg(self) -> int:
        """Index of the present path segment, from 0."""
        return int(self._state[0])

    @property
    def along(self) -> float:
        """Largest arc length on the present path segment so far [m]."""
        return float(self._state[1])

    @property
    def missed(self) -> float:
        """Largest distance [m] at which a corner was passed so far; 0 before the first corner.

        The distance to a corner is the least one while the robot is on one of the two segments that meet there.
        """
        return sqrt(max(self._state[3], self._state[4]))

    @property
    def last(self) -> bool:
        """Whether the robot is on the last path segment."""
        return self.leg == len(self._points) - 2

    def move(self, x: float, y: float) -> None:
        """Update the present path segment for the robot's new position (x, y) [m] in {E}."""
        last = len(self._table) - 1
        rows = self._table[np.minimum(self.leg + self._ahead, last)]
        (self._state,) = self._moved(self._state, rows, last, (x, y), self._visit)

    def track(self, places: ArrayLike) -> NDArray[np.float64]:
        """Move the robot to each position (n, 2) [m] in turn; return the distances (n,) [m] to the path."""
        return self._over(places, self.distance)

    def rises(self, places: ArrayLike) -> NDArray[np.float64]:
        """Move the robot to each position (n, 2) [m] in turn; return the heights (n,) [m] above the mission's depth."""
        return self._over(places, lambda _x, _y: self.rise)

    @property
    def rise(self) -> float:
        """Height of the path above the mission's depth [m] at the robot's progress."""
        (ax, ay), (bx, by) = self._points[self.leg : self.leg + 2]
        low, high = self._rises[self.leg : self.leg + 2]
        return low + (high - low) * (self.along / hypot(bx - ax, by - ay))

    def _over(self, places: ArrayLike, figure: Callable[[float, float], float]) -> NDArray[np.float64]:
        figures = []
        for x, y in np.asarray(places, dtype=float).tolist():
            self.move(x, y)
            figures.append(figure(x, y))
        return np.array(figures)

    def distance(self, x: float, y: float) -> float:
        """Return the distance [m] from (x, y) to the nearest of the previous, the present and the next path segment."""
        return min(
            _apart(self._points[k], self._points[k + 1], x, y)
            for k in range(max(self.leg - 1, 0), min(self.leg + 2, len(self._points) - 1))
        )


def _apart(a: tuple[float, float], b: tuple[float, float], x: float, y: float) -> float:
    px, py, dx, dy = x - a[0], y - a[1], b[0] - a[0], b[1] - a[1]
    t = min(max((px * dx + py * dy) / (dx * dx + dy * dy), 0.0), 1.0)
    return hypot(px - t * dx, py - t * dy)


def follow(old: Mapping[str, ca.SX], waypoints: ca.SX, legs: ca.SX, place: ca.SX, *, visit: ca.SX) -> dict[str, ca.SX]:
    """Return the state of `Follower` after one move of the robot, as CasADi expressions.

    Args:
        old: value of each entry of `FOLLOWING` before the move, by name.
        waypoints: (n, 2) positions [m]; repetitions of the last waypoint are ignored.
        visit: distance [m] to a corner within which the corner counts as visited; 0 or less: the robot may cut corners.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.guidance import FOLLOWING, follow
        >>> corner, none = ca.DM([[0, 0], [2, 0], [2, 3]]), ca.DM(0)
        >>> old = {port.name: ca.DM(port.default) for port in FOLLOWING} | {"along": ca.DM(1.9)}
        >>> after = follow(old, corner, ca.DM(2), ca.DM([2.05, 0.3]), visit=none)
        >>> float(after["leg"]), round(float(after["along"]), 2)
        (1.0, 0.3)
    """
    count = waypoints.shape[0]
    rows = [waypoints[min(k, count - 1), :] for k in range(3)]
    for leg in range(1, count - 1):
        here = old["leg"] >= leg
        rows = [ca.if_else(here, waypoints[min(leg + k, count - 1), :], row) for k, row in enumerate(rows)]
    # a kind above 0 is that of a corner to visit
    table = ca.horzcat(ca.vertcat(*rows), ca.SX(3, 2), ca.repmat(visit, 3, 1))
    return follow_on(old, table, legs, place, visit=visit)[0]


def follow_on(
    old: Mapping[str, ca.SX], rows: ca.SX, legs: ca.SX, place: ca.SX, *, visit: ca.SX
) -> tuple[dict[str, ca.SX], ca.SX]:
    """Return the state of `Follower` after one move, and the number of segments advanced.

    Args:
        old, legs, place: as for `follow`.
        rows: (k + 2, 5) rows of the path's table (see `Path.table`) from the start of the present segment on, if the
            robot may advance by k segments at once; the last row of the table fills the remaining rows.
        visit: distance [m] to a corner `VISIT` within which the corner counts as visited.
    """
    most = rows.shape[0] - 2
    leg, points = old["leg"], [rows[k, :2].T for k in range(most + 2)]
    length, ahead = _leg(points[0], points[1])
    along = ca.fmin(ca.fmax(old["along"], ca.dot(place - points[0], ahead)), length)
    rest = ca.sumsqr(place - points[0] - along * ahead)
    apart = [ca.sumsqr(place - point) for point in points]
    before, nearest = ca.fmin(old["corner_behind"], apart[0]), ca.fmin(old["corner_ahead"], apart[1])
    least, left, skips, onward, open_ = rest, length - along, ca.SX(0), along, ca.SX(1)
    for k in range(1, most + 1):
        further, then = _leg(points[k], points[k + 1])
        beyond = ca.fmin(ca.fmax(ca.dot(place - points[k], then), 0), further)
        distance = ca.sumsqr(place - points[k] - beyond * then)
        visits = rows[k, 4] > 0
        cuts = ca.logic_and(distance < least, (left + beyond) ** 2 <= _SHORT_CUT**2 * rest)
        arrives = apart[1] <= visit**2 if k == 1 else ca.SX(0)
        moves = ca.logic_and(ca.logic_and(open_, leg + k < legs), ca.if_else(visits, arrives, cuts))
        skips, onward = ca.if_else(moves, k, skips), ca.if_else(moves, beyond, onward)
        least = ca.if_else(moves, distance, least)
        open_ = ca.logic_and(open_, ca.logic_not(visits))
        left = left + further
    missed, behind = ca.fmax(old["missed"], before), nearest
    passed = [(missed, ca.if_else(rows[1, 4] < 0, 0, behind))]
    for k in range(2, most + 1):
        missed = ca.fmax(missed, passed[-1][1])
        passed.append((missed, ca.if_else(rows[k, 4] < 0, 0, apart[k])))
    missed, behind = old["missed"], before
    for k, (largest, last) in enumerate(passed):
        missed, behind = ca.if_else(skips == k + 1, largest, missed), ca.if_else(skips == k + 1, last, behind)
    after = {
        "leg": leg + skips,
        "along": onward,
        "corner_ahead": ca.if_else(skips > 0, _FAR_OFF, nearest),
        "corner_behind": behind,
        "missed": missed,
    }
    return after, skips


@cache
def _moved(count: int) -> Callable[..., list[NDArray[np.float64]]]:
    # `follow_on` with so many rows as a function of vectors: state, rows, number of legs, place, visit
    layout, rows = Layout(FOLLOWING), ca.SX.sym("rows", count, ROW)
    state, old = layout.symbols("state")
    legs, place, visit = ca.SX.sym("legs"), ca.SX.sym("place", 2), ca.SX.sym("visit")
    after, _ = follow_on(old, rows, legs, place, visit=visit)
    return on_vectors(ca.Function("moved", [state, rows, legs, place, visit], [layout.join(after)], {"cse": True}))


def _leg(a: ca.SX, b: ca.SX) -> tuple[ca.SX, ca.SX]:
    chord = b - a
    length = ca.sqrt(ca.sumsqr(chord))
    return length, chord / ca.fmax(length, 1e-12)
