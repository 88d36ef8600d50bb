"""The reference path: points, speeds, heights and kinds of corners; how the target point passes a corner.

A law sees at most `MAX_WAYPOINTS` waypoints of its path at a time; `guidance.following` feeds it a longer path.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError

MAX_WAYPOINTS = 8
"""Number of waypoints that a law sees at a time."""

VISIT, PASS, BEND = 1.0, 0.0, -1.0
"""Kinds of waypoints: a corner to visit, a corner that may be cut, and a point inside an arc, which is no corner."""

AT_CORNER = 1e-4  # [m] arc length: less than the target point moves in a period, more than single-precision errors
_SHARPEST = 0.25  # least 1 + cos of a turn in the wheel-over distance: at a turn of 139° or more it no longer grows
_ON_LEG = 0.1  # [m] from a leg, below which the robot follows it to its end; several times the position uncertainty


@dataclass(frozen=True)
class Path:
    """A reference path: a polyline in {E}, with speeds, heights and kinds of corners if the mission has them.

    Attributes:
        waypoints: (n, 2) [m], n ≥ 2; consecutive points differ.
        rises: (n,) height of each waypoint above the mission's depth [m], linear between two waypoints; the first is 0.
            None: 0.
        speeds: (n,) speed [m/s] on the path segment that ends at each waypoint; 0: the mission's cruise speed. None: 0.
        kinds: (n,) kind of each waypoint: `VISIT`, `PASS` or `BEND`. None: as the mission says for all corners.
    """

    waypoints: NDArray[np.float64]
    rises: NDArray[np.float64] | None = None
    speeds: NDArray[np.float64] | None = None
    kinds: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        points = np.array(self.waypoints, dtype=float)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2:
            problem = "a path has at least 2 points with two coordinates each"
            remedy = "give the start, the end and the corners between them"
            raise InputError(problem, key="path", value=points.tolist(), remedy=remedy)
        if not np.all(np.isfinite(points)):
            raise InputError(
                "contains a number that is not finite", key="path", value=points.tolist(), remedy="correct it"
            )
        if np.any(np.linalg.norm(np.diff(points, axis=0), axis=1) < 1e-6):
            at = int(np.argmax(np.linalg.norm(np.diff(points, axis=0), axis=1) < 1e-6))
            problem = f"has two equal points in a row, number {at} and {at + 1} counted from 0"
            raise InputError(problem, key="path", value=points[at].tolist(), remedy="remove one of them")
        points.flags.writeable = False
        object.__setattr__(self, "waypoints", points)
        for name in ("rises", "speeds", "kinds"):
            values = getattr(self, name)
            if values is None:
                continue
            column = np.array(values, dtype=float)
            if column.shape != (len(points),) or not np.all(np.isfinite(column)):
                raise InputError(f"needs one finite number for each of the {len(points)} waypoints", key=f"path.{name}")
            column.flags.writeable = False
            object.__setattr__(self, name, column)

    @property
    def length(self) -> float:
        """Arc length of the path [m]."""
        return float(self.lengths.sum())

    @property
    def lengths(self) -> NDArray[np.float64]:
        """Length of each path segment (n - 1,) [m]."""
        lengths: NDArray[np.float64] = np.linalg.norm(np.diff(self.waypoints, axis=0), axis=1)
        return lengths

    @property
    def fed(self) -> bool:
        """Whether the law's parameters change along the path.

        They do if the path has more than `MAX_WAYPOINTS` points, or if it has `rises`, `speeds` or `kinds`.
        """
        return len(self.waypoints) > MAX_WAYPOINTS or any(
            column is not None for column in (self.rises, self.speeds, self.kinds)
        )

    @property
    def slots(self) -> NDArray[np.float64]:
        """The waypoints that a law sees at the start, as an array (`MAX_WAYPOINTS`, 2) [m].

        The last waypoint fills the remaining rows; it is also the last row if the path has more waypoints than rows.
        """
        rows = [*range(MAX_WAYPOINTS - 1), len(self.waypoints) - 1]
        return self.waypoints[np.minimum(rows, len(self.waypoints) - 1)]

    def table(self, *, visits: bool = False) -> NDArray[np.float64]:
        """Return one row for each waypoint (n, 5): x, y [m], rise [m], speed [m/s] of the segment before it, kind.

        `visits` says whether the corners are `VISIT`; it has no effect if the path has `kinds`.
        """
        n = len(self.waypoints)
        kind = np.full(n, VISIT if visits else PASS) if self.kinds is None else self.kinds
        rise, speed = (np.zeros(n) if column is None else column for column in (self.rises, self.speeds))
        return np.column_stack([self.waypoints, rise, speed, kind])

    def duration(self, cruise: float) -> float:
        """Return the time [s] in which the target point goes along the whole path, at cruise speed `cruise` [m/s]."""
        speeds = np.zeros(len(self.waypoints)) if self.speeds is None else self.speeds
        return float((self.lengths / np.where(speeds[1:] > 0, speeds[1:], cruise)).sum())


def path_target(waypoints: ca.SX, s: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the point (2, 1) [m] and unit tangent (2, 1) of the path at arc length s, and the path's length [m].

    `waypoints` are (n, 2) CasADi SX [m] in {E}; repetitions of the last one are ignored. `s` is clipped to [0, length].
    """
    travelled = ca.SX(0)
    point, tangent = waypoints[0, :].T, ca.SX([1, 0])
    for k in range(waypoints.shape[0] - 1):
        chord = (waypoints[k + 1, :] - waypoints[k, :]).T
        length = ca.sqrt(ca.sumsqr(chord))
        real = length > 1e-6
        direction = chord / ca.fmax(length, 1e-6)
        # s < 0 gives the start of the first segment
        here = real if k == 0 else ca.logic_and(real, s >= travelled)
        along = ca.fmin(ca.fmax(s - travelled, 0), length)
        point = ca.if_else(here, waypoints[k, :].T + along * direction, point)
        tangent = ca.if_else(ca.logic_or(here, k == 0), direction, tangent)
        travelled = travelled + length
    return point, tangent, travelled


def leg_end(waypoints: ca.SX, s: ca.SX) -> ca.SX:
    """Return the arc length [m] at the end of the path segment that contains `s` [m]; at a corner, the corner's."""
    travelled = end = ca.SX(0)
    for k in range(waypoints.shape[0] - 1):
        past = s > travelled + AT_CORNER
        travelled = travelled + ca.sqrt(ca.sumsqr(waypoints[k + 1, :] - waypoints[k, :]))
        end = ca.if_else(past, travelled, end) if k else travelled
    return end


def next_leg(waypoints: ca.SX, s: ca.SX, here: ca.SX, *, near: ca.SX) -> ca.SX:
    """Return the arc length [m] of the target point, which advances to the next path segment after a detour.

    The target advances to the nearest point of the next segment if the robot, at `here` (2, 1) [m], is nearer to that
    than to the target's segment (prolonged backwards), more than 0.1 m off the latter, and the corner is at most `near`
    [m] ahead of the target. Otherwise the result is `s`. Without this, the robot would return to the corner, approach
    the next segment crosswise at full speed, and overshoot it.
    """
    tangent, ends, corner, ahead, length = _corner(waypoints, s)
    offset = here - corner
    before = ca.fmin(ca.dot(offset, tangent), 0)
    beyond = ca.fmin(ca.fmax(ca.dot(offset, ahead), 0), length)
    now, then = ca.sumsqr(offset - before * tangent), ca.sumsqr(offset - beyond * ahead)
    left = ca.logic_and(s > ends - near, ca.fmax(then, _ON_LEG**2) < now)
    follows = ca.logic_and(length > 1e-6, s < ends)
    return ca.if_else(ca.logic_and(follows, left), ends + beyond, s)


def wheel_over(waypoints: ca.SX, s: ca.SX, here: ca.SX, *, radius: ca.SX, lead: ca.SX) -> ca.SX:
    """Return the arc length [m] of the target point: the corner ahead, once the turn onto the next segment must begin.

    A craft at `here` (2, 1) [m] that turns on a circle of radius R by the angle α must begin the turn R tan(α/2) before
    the corner (the wheel-over point, Fossen 2021, section 12.4), and `lead` [m] earlier, in which it travels before it
    turns at its full yaw rate. The distance is at most half of either segment.
    """
    tangent, ends, corner, ahead, length = _corner(waypoints, s)
    cosine = ca.fmin(ca.fmax(ca.dot(tangent, ahead), -1), 1)
    half = ca.sqrt((1 - cosine) / ca.fmax(1 + cosine, _SHARPEST))
    before, left = ends - _leg_start(waypoints, s), ca.dot(corner - here, tangent)
    distance = ca.fmin(radius * half + lead * ca.fmin(half, 1), 0.5 * ca.fmin(length, before))
    begins = ca.logic_and(ca.logic_and(length > 1e-6, s < ends), left <= distance)
    return ca.if_else(begins, ends, s)


def _leg_start(waypoints: ca.SX, s: ca.SX) -> ca.SX:
    """Return the arc length [m] at the start of the path segment that contains s; see `path_target`."""
    travelled = start = ca.SX(0)
    for k in range(waypoints.shape[0] - 2):
        travelled = travelled + ca.sqrt(ca.sumsqr(waypoints[k + 1, :] - waypoints[k, :]))
        start = ca.if_else(s >= travelled, travelled, start)
    return start


def _corner(waypoints: ca.SX, s: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
    """Return the tangent at s, and the corner ahead: arc length, place, direction and length of the next segment."""
    _, tangent, _ = path_target(waypoints, s)
    travelled, ends, corner, after = ca.SX(0), ca.SX(0), waypoints[1, :].T, waypoints[1, :].T
    for k in range(waypoints.shape[0] - 2):
        # select only points, which are in memory; values computed for every leg would need additional memory
        holds = ca.SX(1) if k == 0 else s >= travelled
        travelled = travelled + ca.sqrt(ca.sumsqr(waypoints[k + 1, :] - waypoints[k, :]))
        ends = ca.if_else(holds, travelled, ends)
        corner = ca.if_else(holds, waypoints[k + 1, :].T, corner)
        after = ca.if_else(holds, waypoints[k + 2, :].T, after)
    chord = after - corner
    length = ca.sqrt(ca.sumsqr(chord))
    ahead = chord / ca.fmax(length, 1e-6)
    return tangent, ends, corner, ahead, length
