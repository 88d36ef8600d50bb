"""The search of the steered law over candidate courses and speeds, within a fixed number of prediction steps.

The candidates are predicted one after another in one loop of `BUDGET` steps. A candidate without contact costs its
change of course and speed, and a contact adds to that. The first candidate is the choice of the last control step; the
others are in the order of this least cost, so the search ends as soon as no later candidate can be better, and it is
exact if it ends within the loop. In a measured run it needs about 20 steps, beside obstacles about 80, for a craft
with fins sometimes more than 300. If the loop ends first, the best candidate so far counts, and the next control step
goes on with the candidate whose prediction did not end. So a candidate is chosen only if its prediction was complete,
and within a few control steps all of them are predicted. Without this, a torpedo collided: in every step, the loop
ended before the first clear course.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, sin  # NumPy's differ in the last bit between processors, and the law's digest with them

import casadi as ca
import numpy as np

from surctl.ir import Port, fold, picked, repeat, tabulated
from surctl.marine.control.baselines.situation import Situation, length
from surctl.marine.control.steering import Moving, Steering, moved
from surctl.marine.guidance import FAR, MAX_WAYPOINTS

__all__ = ["BUDGET", "CLEAR", "COURSES", "INADMISSIBLE", "SEARCH_PORTS", "SPEEDS", "STEPS", "best_course", "sided"]

COURSES = tuple(
    np.radians([0, *(s * a for a in (10, 20, 30, 45, 60, 80, 100, 125, 150) for s in (1, -1)), 180]).tolist()
)
"""Candidate courses [rad] relative to the desired course.

Of two equally good candidates the law chooses the first, so the craft passes a head-on obstacle with the obstacle on
its right (erratum E10).
"""

SPEEDS = (1.0, 0.4)
"""Candidate speeds as shares of the desired speed; at a lower speed the craft turns on a smaller circle."""

STEPS = 16
"""Number of steps of the prediction of one candidate (*chosen*)."""

BUDGET = 118
"""Number of prediction steps of a control step (*chosen*, at least two candidates; all 41 to the end need 656)."""

INADMISSIBLE = 1e3
"""Cost of a contact before the craft can stop."""

SEARCH_PORTS = (
    Port("offset", (1,), "rad", "candidate chosen last: course relative to the desired course", gap="anew"),
    Port("share", (1,), "1", "candidate chosen last: share of the desired speed", default=1.0, gap="anew"),
    Port("skipped", (1,), "1", "number of candidates that the next search leaves out as predicted before", gap="anew"),
)
"""State of the search."""

_HIT, _SLOW, _OTHER_SIDE, _OTHER_COURSE = 4.0, 0.5, 2.5, 0.1  # weights of the cost
_DEAD_END = 4.0  # of a contact before the end of the path, for a craft that cannot turn at rest
_BLUR = 0.2  # share of the hull radius added to the margin, because the prediction has few steps
_BACK = 3.0  # [rad] offset above which a course leads back
_BETTER = 1e-9  # least difference of cost by which a later candidate replaces an earlier one
_LAST = 1e6  # least cost beyond the last candidate
_NOWHERE = 1e6  # [m] distance of an empty slot

CLEAR = _HIT / STEPS
"""Cost below which the desired course and speed have no contact in the prediction."""


def sided(offset: ca.SX | float) -> ca.SX | bool:
    """Return whether an offset [rad] leads past an obstacle on one side; straight on and back do not."""
    return ca.logic_and(offset != 0, offset < _BACK)


def best_course(
    s: Situation, course: ca.SX, speed: ca.SX, hull: ca.SX, water: ca.SX, steering: Steering
) -> tuple[ca.SX, ca.SX, ca.SX, dict[str, ca.SX]]:
    """Return the offset from the desired course [rad], the share of the desired speed, the cost of both, and the state.

    Args:
        s: the situation.
        course: unit vector (2, 1) of the desired course in {E}.
        speed: desired speed [m/s].
        hull: unit vector (2, 1) of the hull in {E}.
        water: surge speed through the water [m/s].
        steering: abilities of the craft.

    Returns:
        Offset, share and cost, and the next state of `SEARCH_PORTS`.
    """
    p, side = s.p, s.x["side"]
    stopping = p["cruise"] ** 2 / (2 * steering.deceleration) + p["cruise"] * p["reaction"]
    distance = p["foresight"] * steering.radius + stopping
    step = distance / (p["cruise"] * STEPS)  # every candidate is predicted over the same distance
    aside = s.nu[1] - s.x["sway"]
    stream = ca.vertcat(-hull[1] * aside, hull[0] * aside)
    bodies, walls = _contacts(s)
    to_end = length(p["waypoints"][MAX_WAYPOINTS - 1, :].T - s.eta[:2])
    last = s.x["last_velocity"] / ca.fmax(length(s.x["last_velocity"]), 1e-6)
    left, right, free = (tabulated(_ordered(k), 6) for k in (1, -1, 0))
    offset, share, skipped = s.x["offset"], s.x["share"], s.x["skipped"]
    other = _OTHER_SIDE * ca.logic_and(sided(offset), offset * side < 0)
    least = 1 - ca.cos(offset) + _SLOW * (1 - share) + other
    table = ca.if_else(side > 0, left, ca.if_else(side < 0, right, free))
    next_least = picked("resumed", table, skipped)[4]
    table = ca.vertcat(ca.horzcat(offset, share, ca.cos(offset), ca.sin(offset), least, next_least), table)

    def towards(turned: ca.SX) -> ca.SX:
        return ca.vertcat(course[0] * turned[0] - course[1] * turned[1], course[0] * turned[1] + course[1] * turned[0])

    def floor(row: ca.SX) -> ca.SX:
        # only while the craft passes an obstacle: otherwise the desired course decides alone
        return row[4] + _OTHER_COURSE * ca.logic_not(side == 0) * (1 - ca.dot(towards(row[2:4]), last))

    def cost(row: ca.SX, hit: ca.SX, k: ca.SX, travelled: ca.SX) -> ca.SX:
        planned = speed * row[1]
        stop = planned * (planned / (2 * steering.deceleration) + p["reaction"])
        # the craft stops at the end of the path, so what is behind it does not count on the desired course
        met = ca.logic_and(hit, ca.logic_or(row[0] != 0, travelled < ca.fmax(to_end, stop)))
        # a turn takes time, so the distance counts too
        near = 1 - ca.fmin(k / STEPS, travelled / distance)
        dead_end = _DEAD_END * p["fin_share"] * (travelled < to_end)
        return floor(row) + ca.if_else(met, _HIT * near + dead_end + INADMISSIBLE * (travelled < stop), 0)

    start = [ca.SX.zeros(2), hull, ca.vertcat(s.nu[0], s.x["sway"], s.nu[3]), ca.SX(0), ca.SX(0)]

    def predicted(
        place: ca.SX,
        heading: ca.SX,
        nu: ca.SX,
        travelled: ca.SX,
        k: ca.SX,
        at: ca.SX,
        best: ca.SX,
        least: ca.SX,
        *_: ca.SX,
    ) -> tuple[list[ca.SX], list[ca.SX]]:
        row = picked("candidate", table, at)
        longer = step / row[1]
        now = moved(
            Moving(place, heading, nu, travelled, s.nu[0] - water), towards(row[2:4]), row[1] * speed, p,
            step=longer, gain=ca.fmin(p["k_psi"], 0.5 / longer), stream=stream,
        )  # fmt: skip
        met = _touches(now.place, longer * (k + 1), bodies, walls)
        hopeless = floor(row) >= least - _BETTER  # cannot be the best even without a contact
        ended = ca.logic_or(ca.logic_or(met, hopeless), k >= STEPS - 1)
        total = cost(row, met, k, travelled)
        better = ca.logic_and(ended, total < least - _BETTER)
        best, least = ca.if_else(better, row[:2], best), ca.if_else(better, total, least)
        done = ca.logic_and(ended, row[5] >= least - _BETTER)
        onward = (now.place, now.hull, now.nu, now.travelled, k + 1)
        after = [ca.if_else(ended, begin, then) for begin, then in zip(start, onward, strict=True)]
        return [*after, at + ended * (1 + skipped * (at == 0)), best, least, done], []

    state = [*start, ca.SX(0), ca.SX([0, 1]), ca.SX(2 * INADMISSIBLE), ca.SX(0)]
    (*_, at, best, least, done), _ = repeat("predicted", predicted, state, count=BUDGET, until=8)
    after = {"offset": best[0], "share": best[1], "skipped": ca.if_else(done, 0, ca.fmax(at - 1, 0))}
    return best[0], best[1], least, after


def _ordered(side: int) -> Iterator[tuple[float, ...]]:
    """Yield the candidates in the order of their least cost, while the craft passes an obstacle on a side (0: none).

    A row has offset [rad], share of the speed, cosine and sine of the offset, least cost of the candidate, and least
    cost of the next one.
    """
    rows = [
        (
            offset,
            share,
            1 - cos(offset) + _SLOW * (1 - share) + _OTHER_SIDE * bool(sided(offset) and offset * side < 0),
        )
        for share in SPEEDS
        for offset in COURSES
    ]
    rows.sort(key=lambda row: round(row[2], 12))  # stable, so of equal ones the first remains first
    for (offset, share, least), later in zip(rows, [*(row[2] for row in rows[1:]), _LAST], strict=True):
        yield offset, share, cos(offset), sin(offset), least, later


def _contacts(s: Situation) -> tuple[ca.SX, ca.SX]:
    """Return a table with one row per moving or resting body, and one with one row per wall.

    A wall is the outward normal of a half-plane and its distance beyond the least allowed one. A body is the condition
    of its contact, w |d|² + a·d < b with the displacement d of the craft from its present place, relative to the body:
    a, b, w and the body's velocity. w is 1 for a disc and 0 for a half-plane.
    """
    bodies, walls = [], []
    for flat, contacts in ((False, [*s.perceived.known, *s.perceived.echoes]), (True, s.perceived.walls)):
        for c in contacts:
            # a contact that is nearer than the margin must not come nearer
            margin = ca.fmin(s.p["margin"] + _BLUR * s.p["hull"], c.clearance - 1e-3)
            gap = ca.if_else(ca.fabs(c.clearance - FAR) < 1e-9, _NOWHERE, c.clearance - margin)  # an empty slot
            if flat:
                walls.append((c.normal, gap))
                continue
            disc = ca.logic_and(c.combined_radius > s.p["hull"] + 1e-6, gap < _NOWHERE)
            away, least = c.clearance + c.combined_radius, ca.fmax(c.combined_radius + margin, 0)
            bound = ca.if_else(disc, least * least - away * away, -gap)
            bodies.append((ca.if_else(disc, -2 * away, -1) * c.normal, bound, disc, c.velocity))
    return tabulated(bodies, 6), tabulated(walls, 3)


def _touches(place: ca.SX, time: ca.SX, bodies: ca.SX, walls: ca.SX) -> ca.SX:
    """Return whether the craft at a place, relative to its present one, has a contact at a time [s] from now."""

    def touches(met: ca.SX, row: ca.SX) -> ca.SX:
        d = place - row[4:6] * time
        return ca.logic_or(met, row[3] * ca.sumsqr(d) + ca.dot(row[:2], d) < row[2])

    def beyond(met: ca.SX, row: ca.SX) -> ca.SX:
        return ca.logic_or(met, ca.dot(row[:2], place) > row[2])

    met = fold("touches", touches, ca.SX(0), bodies) if bodies.shape[0] else ca.SX(0)
    return fold("beyond", beyond, met, walls)
