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
from math import atan2, hypot, inf, sqrt

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.ir import Port
from surctl.marine.guidance.path import AT_CORNER, BEND, MAX_WAYPOINTS, VISIT, Path

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
    """The segment of a path that a robot is on, and the robot's progress on this segment.

    Args:
        path: the path that the robot follows.
        visit: distance [m] to a corner within which the corner counts as visited, if every corner must be visited;
            None: the robot may cut corners. If the path has kinds of corners, `visit` holds for the corners `VISIT`.

    Attributes:
        leg: index of the present path segment, from 0.
        along: largest arc length on the present path segment so far [m].
        missed: largest distance [m] at which a corner was passed so far; 0 before the first corner. The distance to a
            corner is the least distance while the robot is on one of the two segments that meet at the corner.
    """

    def __init__(self, path: Path, *, visit: float | None = None) -> None:
        self._points = [(float(x), float(y)) for x, y in path.waypoints]
        kinds = [VISIT if visit is not None else 0.0] * len(self._points) if path.kinds is None else path.kinds.tolist()
        self._visit = [visit if kind == VISIT else None for kind in kinds]
        self._corner = [kind != BEND for kind in kinds]
        self._skips = SKIPS if path.fed else 1
        self._rises = [0.0] * len(self._points) if path.rises is None else path.rises.tolist()
        self.leg, self.along = 0, 0.0
        self._missed, self._before, self._nearest = 0.0, 0.0, inf  # [m²] at earlier corners, the last, the next one

    @property
    def missed(self) -> float:
        """Largest distance [m] at which a corner was passed so far; 0 before the first corner."""
        return sqrt(max(self._missed, self._before))

    @property
    def last(self) -> bool:
        """Whether the robot is on the last path segment."""
        return self.leg == len(self._points) - 2

    def move(self, x: float, y: float) -> None:
        """Update the present path segment for the robot's new position (x, y) [m] in {E}."""
        (ax, ay), (bx, by) = self._points[self.leg : self.leg + 2]
        length = hypot(bx - ax, by - ay)
        ux, uy = (bx - ax) / length, (by - ay) / length
        self.along = min(max(self.along, (x - ax) * ux + (y - ay) * uy), length)
        if self.leg:
            self._before = min(self._before, (x - ax) ** 2 + (y - ay) ** 2)
        rest = (x - ax - self.along * ux) ** 2 + (y - ay - self.along * uy) ** 2
        self._nearest = min(self._nearest, (x - bx) ** 2 + (y - by) ** 2)
        most, least, left, skips, along = _SHORT_CUT**2 * rest, rest, length - self.along, 0, 0.0
        for k in range(1, self._skips + 1):
            if self.leg + k > len(self._points) - 2:
                break
            (px, py), (qx, qy) = self._points[self.leg + k : self.leg + k + 2]
            size = hypot(qx - px, qy - py)
            vx, vy = (qx - px) / size, (qy - py) / size
            beyond = min(max((x - px) * vx + (y - py) * vy, 0.0), size)
            visit = self._visit[self.leg + k]
            if visit is not None:
                if k == 1 and (x - px) ** 2 + (y - py) ** 2 <= visit**2:
                    skips, along = 1, beyond
                break
            apart = (x - px - beyond * vx) ** 2 + (y - py - beyond * vy) ** 2
            if apart < least and (left + beyond) ** 2 <= most:
                least, skips, along = apart, k, beyond
            left = left + size
        if skips:
            self._pass(skips, x, y)
            self.leg, self.along = self.leg + skips, along

    def _pass(self, skips: int, x: float, y: float) -> None:
        missed, before = max(self._missed, self._before), self._nearest
        for k in range(1, skips + 1):
            px, py = self._points[self.leg + k]
            if k > 1:
                missed, before = max(missed, before), (x - px) ** 2 + (y - py) ** 2
            before = before if self._corner[self.leg + k] else 0.0
        self._missed, self._before, self._nearest = missed, before, inf

    def track(self, places: ArrayLike) -> NDArray[np.float64]:
        """Move the robot to each position (n, 2) [m] in turn; return the distances (n,) [m] to the path."""
        return self._over(places, self.distance)

    def rises(self, places: ArrayLike) -> NDArray[np.float64]:
        """Move the robot to each position (n, 2) [m] in turn; return the heights (n,) [m] above the mission's depth."""
        return self._over(places, lambda _x, _y: self.rise)

    def legs(self, places: ArrayLike) -> NDArray[np.float64]:
        """Move the robot to each position (n, 2) [m] in turn; return the numbers (n,) of its path segments."""
        return self._over(places, lambda _x, _y: float(self.leg))

    @property
    def rise(self) -> float:
        """Height of the path above the mission's depth [m] at the robot's progress."""
        (ax, ay), (bx, by) = self._points[self.leg : self.leg + 2]
        low, high = self._rises[self.leg : self.leg + 2]
        return low + (high - low) * (self.along / hypot(bx - ax, by - ay))

    def directions(self, places: ArrayLike) -> NDArray[np.float64]:
        """Move the robot to each position (n, 2) [m] in turn; return the directions (n,) [rad] of its path segments."""
        return self._over(places, self._direction)

    def _over(self, places: ArrayLike, figure: Callable[[float, float], float]) -> NDArray[np.float64]:
        figures = []
        for x, y in np.asarray(places, dtype=float).tolist():
            self.move(x, y)
            figures.append(figure(x, y))
        return np.array(figures)

    def _direction(self, _x: float, _y: float) -> float:
        (ax, ay), (bx, by) = self._points[self.leg : self.leg + 2]
        # past the end of a segment, which of two segments is nearer is a matter of rounding: the next one counts
        if not self.last and self.along >= hypot(bx - ax, by - ay) * PASSED:
            (ax, ay), (bx, by) = self._points[self.leg + 1 : self.leg + 3]
        return atan2(by - ay, bx - ax)

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
    leg = old["leg"]
    start, corner, after = waypoints[0, :].T, waypoints[1, :].T, waypoints[2, :].T
    for k in range(1, waypoints.shape[0] - 1):
        here = leg >= k
        start = ca.if_else(here, waypoints[k, :].T, start)
        corner = ca.if_else(here, waypoints[k + 1, :].T, corner)
        after = ca.if_else(here, waypoints[min(k + 2, waypoints.shape[0] - 1), :].T, after)
    length, ahead = _leg(start, corner)
    further, then = _leg(corner, after)
    along = ca.fmin(ca.fmax(old["along"], ca.dot(place - start, ahead)), length)
    beyond = ca.fmin(ca.fmax(ca.dot(place - corner, then), 0), further)
    rest, following = ca.sumsqr(place - start - along * ahead), ca.sumsqr(place - corner - beyond * then)
    apart = ca.sumsqr(place - corner)
    left_out = length - along + beyond
    cuts = ca.logic_and(following < rest, left_out**2 <= _SHORT_CUT**2 * rest)
    moves = ca.logic_and(leg < legs - 1, ca.if_else(visit > 0, apart <= visit**2, cuts))
    before, nearest = ca.fmin(old["corner_behind"], ca.sumsqr(place - start)), ca.fmin(old["corner_ahead"], apart)
    return {
        "leg": leg + moves,
        "along": ca.if_else(moves, beyond, along),
        "corner_ahead": ca.if_else(moves, _FAR_OFF, nearest),
        "corner_behind": ca.if_else(moves, nearest, before),
        "missed": ca.if_else(moves, ca.fmax(old["missed"], before), old["missed"]),
    }


def follow_on(
    old: Mapping[str, ca.SX], rows: ca.SX, legs: ca.SX, place: ca.SX, *, visit: ca.SX
) -> tuple[dict[str, ca.SX], ca.SX]:
    """Return the state of `Follower` on a fed path after one move, and the number of segments advanced.

    Args:
        old, legs, place: as for `follow`.
        rows: (`SKIPS` + 2, 5) rows of the path's table (see `Path.table`) from the start of the present segment on; the
            last row of the table fills the remaining rows.
        visit: distance [m] to a corner `VISIT` within which the corner counts as visited.
    """
    leg, points = old["leg"], [rows[k, :2].T for k in range(SKIPS + 2)]
    length, ahead = _leg(points[0], points[1])
    along = ca.fmin(ca.fmax(old["along"], ca.dot(place - points[0], ahead)), length)
    rest = ca.sumsqr(place - points[0] - along * ahead)
    apart = [ca.sumsqr(place - point) for point in points]
    before, nearest = ca.fmin(old["corner_behind"], apart[0]), ca.fmin(old["corner_ahead"], apart[1])
    least, left, skips, onward, open_ = rest, length - along, ca.SX(0), along, ca.SX(1)
    for k in range(1, SKIPS + 1):
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
    for k in range(2, SKIPS + 1):
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


def _leg(a: ca.SX, b: ca.SX) -> tuple[ca.SX, ca.SX]:
    chord = b - a
    length = ca.sqrt(ca.sumsqr(chord))
    return length, chord / ca.fmax(length, 1e-12)
