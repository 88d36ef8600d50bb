"""Law `steered` for craft without sway force: course minus crab angle, speed near goals, avoidance by predicted arcs.

Path following gives a desired course and speed. From candidates of course and speed around them, the law chooses the
best one that the craft can follow without contact, and steers the hull to this course minus the crab angle.

Avoidance follows the dynamic window of Fox, Burgard and Thrun (IEEE RAM 1997) and the simulation of candidate courses
of Johansen, Perez and Cristofaro (IEEE T-ITS 2016). Each candidate is predicted over a fixed number of steps with the
yaw moment, the deceleration and the sway drift of the craft (`steering.moved`): an arc onto the course, then a straight
line. Obstacles continue at their present velocity. A disc is predicted as a disc. Of any other body the input holds
only the nearest point, so the law assumes the half-plane behind this point, which contains the whole body if it is
convex. A candidate is admissible if it stays clear for the whole time of prediction, or if the craft can stop by its
surge force before the contact. If no candidate is admissible, the craft stops, and turns to the best course.

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

from collections.abc import Iterator, Mapping
from math import cos, sin  # NumPy's differ in the last bit between processors, and the law's digest with them

import casadi as ca
import numpy as np

from surctl.ir import Port, fold, picked, repeat, tabulated
from surctl.marine.control.closing import thrust_bounds
from surctl.marine.control.decision import Decision, Situation, TaskLevel
from surctl.marine.control.gains import GainSpec
from surctl.marine.control.steering import (
    FIN_STEERAGE,
    SLOWEST,
    Moving,
    Steering,
    drifted,
    moved,
    planned_yaw_rate,
    steerage,
    yaw_moment,
)
from surctl.marine.guidance import FAR, MAX_WAYPOINTS
from surctl.tasks import depth_task

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

_INADMISSIBLE = 1e3
"""Cost of a contact before the craft can stop."""

_SEARCH_PORTS = (
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

_CLEAR = _HIT / STEPS
"""Cost below which the desired course and speed have no contact in the prediction."""


def _sided(offset: ca.SX | float) -> ca.SX | bool:
    """Return whether an offset [rad] leads past an obstacle on one side; straight on and back do not."""
    return ca.logic_and(offset != 0, offset < _BACK)


def _best_course(
    s: Situation, course: ca.SX, speed: ca.SX, hull: ca.SX, water: ca.SX, steering: Steering
) -> tuple[ca.SX, ca.SX, ca.SX, dict[str, ca.SX]]:
    """Return offset from the desired course [rad], share of the desired speed, cost, and next `_SEARCH_PORTS`.

    `course` and `hull` are unit vectors (2, 1) in {E}, `speed` is the desired speed, and `water` the surge speed
    through the water [m/s].
    """
    p, side = s.p, s.x["side"]
    stopping = p["cruise"] ** 2 / (2 * steering.deceleration) + p["cruise"] * p["reaction"]
    distance = p["foresight"] * steering.radius + stopping
    step = distance / (p["cruise"] * STEPS)  # every candidate is predicted over the same distance
    aside = s.nu[1] - s.x["sway"]
    stream = ca.vertcat(-hull[1] * aside, hull[0] * aside)
    bodies, walls = _contacts(s)
    to_end = _length(p["waypoints"][MAX_WAYPOINTS - 1, :].T - s.eta[:2])
    last = s.x["last_velocity"] / ca.fmax(_length(s.x["last_velocity"]), 1e-6)
    left, right, free = (tabulated(_ordered(k), 6) for k in (1, -1, 0))
    offset, share, skipped = s.x["offset"], s.x["share"], s.x["skipped"]
    other = _OTHER_SIDE * ca.logic_and(_sided(offset), offset * side < 0)
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
        return floor(row) + ca.if_else(met, _HIT * near + dead_end + _INADMISSIBLE * (travelled < stop), 0)

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

    state = [*start, ca.SX(0), ca.SX([0, 1]), ca.SX(2 * _INADMISSIBLE), ca.SX(0)]
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
            1 - cos(offset) + _SLOW * (1 - share) + _OTHER_SIDE * bool(_sided(offset) and offset * side < 0),
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


STEERED_GAINS: Mapping[str, GainSpec] = {
    "sideslip": GainSpec("rad", "largest drift angle in a planned turn", default=0.2, range=(0.1, 0.3)),
    "steerage": GainSpec("1", "least share of the speed kept during a turn", True, 1.0, 0.0, range=(0.0, 0.5)),
    "crab_time": GainSpec("s", "time constant of the filter of the crab angle", default=2.0, range=(0.5, 5.0)),
    "foresight": GainSpec("1", "length of the prediction over the turning radius", default=2.5, range=(1.5, 5.0)),
    "fin_share": GainSpec(
        "1", "share of the largest yaw moment that fins give at the cruise speed", True, 1.0, 0.0, from_vehicle=True
    ),
    "munk": GainSpec("kg", "moment in yaw per surge and sway speed", True, default=0.0, from_vehicle=True),
    "centripetal": GainSpec("kg", "sway force per surge speed and yaw rate", True, default=0.0, from_vehicle=True),
    "ahead_limit": GainSpec("N", "largest surge thrust ahead", True, default=0.0, from_vehicle=True),
}
"""Gains of this law in addition to `GAINS`, and a number that follows from the vehicle."""

STEERED_PORTS = (
    Port("crab", (1,), "rad", "filtered crab angle: course minus heading"),
    Port("sway", (1,), "m/s", "sway speed through the water that the model predicts from surge speed and yaw rate"),
    Port("surge", (1,), "m/s", "surge speed through the water that the model predicts from the thrust"),
    Port("away", (1,), "1", "1 while a craft with fins goes away from a point at rest to turn back to it"),
    *_SEARCH_PORTS,
)

_RUN_IN = 2.0  # distance in turning radii to which such a craft goes before it turns back (*chosen*)
_INSIDE = 0.95  # share of the turning radius within which a point at rest is out of reach for a craft with fins
_OUTRUN = 3.0  # least speed at a point at rest over the current from aside (*chosen*): the crab angle is 18 degrees
_TIGHTER = 0.8  # radius of the planned arc to a point at rest over that which just reaches it (*chosen*)
_CHANGED = 1e-3  # [m/s] difference above which a velocity counts as different from the desired velocity


def steered_law(s: Situation) -> Decision:
    """Return the decision: the speed along the hull and the yaw rate that lead to the best admissible course."""
    assert s.steering is not None
    p, psi = s.p, s.eta[3]
    on_path = ca.vertcat(s.desired.tangent[0], s.desired.tangent[1])
    towards, desired_speed = _length(s.desired.velocity), _desired_speed(s)
    course = ca.if_else(towards > 1e-6, s.desired.velocity / ca.fmax(towards, 1e-6), on_path)
    hull = ca.vertcat(ca.cos(psi), ca.sin(psi))
    slip = ca.atan2(s.nu[1], ca.fmax(s.nu[0], SLOWEST * p["cruise"]))
    crab = s.x["crab"] + s.dt / (p["crab_time"] + s.dt) * (slip - s.x["crab"])
    away = _leaves(s, hull, s.steering)
    course = ca.if_else(away, _turned(hull, crab), course)  # over ground: along the hull, the drift of a turn goes on
    water = _through_water(s)
    offset, share, cost, searched = _best_course(s, course, desired_speed, hull, water, s.steering)
    blocked, clear = cost >= _INADMISSIBLE, cost < _CLEAR
    course, speed = _turned(course, offset), ca.if_else(blocked, 0, share * desired_speed)

    heading = _turned(course, -crab)
    ahead = ca.dot(hull, heading)
    across = hull[0] * heading[1] - hull[1] * heading[0]
    error = ca.atan2(across, ahead)
    surge = speed * ca.fmax(ahead, steerage(p))
    surge = ca.if_else(s.desired.arriving, ca.fmin(surge, _on_arc(s, ahead, across)), surge)
    # a following current carries a craft with fins on, but only the speed through the water turns it
    steered = s.nu[0] - water + share * FIN_STEERAGE * p["fin_share"] * p["cruise"]
    surge = ca.if_else(ca.logic_and(p["fin_share"] > 0, ca.logic_not(blocked)), ca.fmax(surge, steered), surge)
    yaw_rate = _yaw_rate(error, water, p)
    # the reference follows the drift in a turn: no thruster acts against it, and a current is no drift
    sway = drifted(s.x["sway"], water, s.nu[3], p, s.dt)

    velocity = speed * course
    side = ca.if_else(clear, 0, ca.if_else(_sided(offset), ca.if_else(offset > 0, 1, -1), s.x["side"]))
    heaves = p["thrust_limit"][2] > 0
    depth = TaskLevel.of(depth_task(s.eta, p["depth"], gain=p["k2"]))
    return Decision(
        [
            TaskLevel("turn", ca.SX([[0, 0, 0, 1]]), yaw_rate, "rad/s"),
            TaskLevel("speed", ca.SX([[1, 0, 0, 0]]), surge, "m/s"),
            TaskLevel("drift", ca.SX([[0, 1, 0, 0]]), sway, "m/s"),
            depth._replace(J=heaves * depth.J, reference=heaves * depth.reference),
        ],
        velocity=velocity,
        avoiding=_length(velocity - s.desired.velocity) > _CHANGED,
        degraded=blocked,
        state={"side": side, "blocker": s.x["blocker"], "last_velocity": velocity, "crab": crab, "sway": sway}
        | {"surge": _propelled(s, surge), "away": away}
        | searched,
    )


def _length(vector: ca.SX) -> ca.SX:
    return ca.sqrt(ca.sumsqr(vector))


def _desired_speed(s: Situation) -> ca.SX:
    """Return the desired speed [m/s]; at a point at rest, the craft keeps more speed than the current.

    At the speed of a stop, a current from aside would need a hull across the course: the craft would turn beside the
    point and not arrive. In a current from ahead, the thrust of so low a speed would only hold the craft in its place.
    A craft with fins cannot turn at rest, and passes the point at its speed of steerage.
    """
    p = s.p
    least = ca.fmin(ca.fmax(_against(s), FIN_STEERAGE * p["fin_share"] * p["cruise"]), p["cruise"])
    speed = _length(s.desired.velocity)
    return ca.if_else(s.desired.arriving, ca.fmax(speed, least), speed)


def _against(s: Situation) -> ca.SX:
    """Return the least speed [m/s] with which a craft arrives in the current that its predicted motion leaves over."""
    return ca.fmax(_OUTRUN * ca.fabs(s.nu[1] - s.x["sway"]), s.x["surge"] - s.nu[0])


def _on_arc(s: Situation, ahead: ca.SX, across: ca.SX) -> ca.SX:
    """Return the largest surge speed [m/s] at which the craft turns tightly enough to reach a point at rest.

    The arc from the craft to a point at the distance d and the bearing β has the radius d/(2 sin β); `ahead` is cos β
    and `across` sin β. A faster craft circles the point; with this bound it turns nearly at rest and comes nearer. The
    speed that the current requires is allowed towards a point ahead.
    """
    distance = ca.sqrt(s.desired.x_e**2 + s.desired.y_e**2)
    rate = planned_yaw_rate(s.p, SLOWEST * s.p["cruise"])
    arc = _TIGHTER * rate * distance / ca.fmax(2 * ca.fabs(across), 1e-3)
    return ca.fmax(arc, _against(s) * ahead)


def _through_water(s: Situation) -> ca.SX:
    """Return the surge speed through the water [m/s]: as the model predicts it if fins turn the craft, else measured.

    The moment of fins follows from this speed, and a craft of `fin_share` 0 does not need it.
    """
    return s.nu[0] + s.p["fin_share"] * (s.x["surge"] - s.nu[0])


def _propelled(s: Situation, surge: ca.SX) -> ca.SX:
    """Return the surge speed through the water [m/s] after this step, by the thrust that `surge` causes and the drag.

    The step is implicit in the drag, as in `drifted`. Fins do not share the propeller's thrust, so it is not reduced.
    """
    p, m, u = s.p, s.p["mass"], s.x["surge"]
    reference = ca.vertcat(ca.fmin(surge, p["cap"]), s.x["sway"], 0, 0)
    free, _ = steered_thrust(reference, s.nu, s.x["integral"], p, s.dt)
    least, most = thrust_bounds(p)
    thrust = ca.fmin(ca.fmax(free[0], least[0]), most[0]) + m[1] * s.x["sway"] * s.nu[3]
    damping = (p["linear_drag"][0] + p["quadratic_drag"][0] * ca.fabs(u)) / m[0]
    return (u + s.dt * thrust / m[0]) / (1 + s.dt * damping)


def _leaves(s: Situation, hull: ca.SX, steering: Steering) -> ca.SX:
    """Return whether the craft goes straight on, because fins alone turn it and a point at rest is inside its circle.

    Such a craft would circle the point for ever. It goes straight on to the distance of `_RUN_IN` turning radii, so
    that it has turned before it comes back, and passes the point on a straight course.
    """
    along, across = -s.desired.x_e, -s.desired.y_e
    tangent = s.desired.tangent
    point = ca.vertcat(tangent[0] * along - tangent[1] * across, tangent[1] * along + tangent[0] * across)
    ahead, left = ca.dot(hull, point), hull[0] * point[1] - hull[1] * point[0]
    aside = steering.radius - ca.fabs(left)
    inside = ahead * ahead + aside * aside < (_INSIDE * steering.radius) ** 2
    near = ca.dot(point, point) < (_RUN_IN * steering.radius) ** 2
    leaves = ca.logic_or(inside, ca.logic_and(ca.logic_and(s.x["away"] > 0, near), ahead < 0))
    return ca.logic_and(ca.logic_and(s.desired.arriving, leaves), s.p["fin_share"] > 0.5)


def _yaw_rate(error: ca.SX, speed: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
    # slow enough that half the yaw moment can end the turn at the desired heading
    swing = ca.sqrt(yaw_moment(p, speed) / p["mass"][3] * ca.fabs(error))
    most = ca.fmin(planned_yaw_rate(p, speed), swing)
    return ca.fmin(ca.fmax(p["k_psi"] * error, -most), most)


def _turned(unit: ca.SX, angle: ca.SX) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(unit[0] * c - unit[1] * s, unit[0] * s + unit[1] * c)


def steered_thrust(
    reference: ca.SX, nu: ca.SX, integral: ca.SX, p: Mapping[str, ca.SX], dt: float
) -> tuple[ca.SX, ca.SX]:
    """Return thrust and next integral of the surge, heave and yaw loops; sway has no thrust.

    The loops are those of `velocity_control`. In addition, the thrust cancels the moment μ u v (`Vehicle.munk`) and the
    force m22 v r in surge. The sway speed v is that of the reference, which is the drift through the water: the
    measured sway speed also contains the current, which causes no Munk moment.
    """
    m, limit = p["mass"], p["thrust_limit"]
    error = reference - nu
    gain = ca.vertcat(p["k_v"], 0, p["k_v"], p["k_r"])
    drag = p["linear_drag"] * reference + p["quadratic_drag"] * reference * ca.fabs(reference)
    v = reference[1]
    coriolis = ca.vertcat(-m[1] * v * nu[3], 0, 0, p["munk"] * nu[0] * v)
    driven = ca.vertcat(1, 0, limit[2] > 0, 1)
    free = driven * (drag + m * (gain * error + integral) + coriolis)
    least, most = thrust_bounds(p)
    held = ca.logic_or(free > most, free < least)
    return free, ca.if_else(held, integral, integral + driven * dt * p["k_i"] * error)
