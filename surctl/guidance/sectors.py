"""Choice of a course among many contacts: each blocks a sector of courses, the free course nearest the wish wins.

For one contact the edges of its sector are exactly the `corrected` law φ ± arccos(·) of `avoidance`, with the
braking distance in place of κ(l − R_OB − d_s): n·v ≤ a(l) + v_o·n. No trigonometric function is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, radians, sin
from typing import NamedTuple

import casadi as ca

from surctl.guidance.cones import Cone, inside
from surctl.guidance.contacts import Contact
from surctl.guidance.sides import MISSED, MISSED_RATE, passes_left, side_costs, swap_costs

__all__ = ["Choice", "Sector", "choose_velocity", "round_unknown", "slowed"]

_TOLERANCE = 1e-3  # [m/s] by which a course may miss a bound and still count as free
_HEAD_ON = 1e-4  # cost of −1 between two equal edges: head-on the obstacle stays on the right (E10)
_TURN_BACK = 8.0  # cost of leaving the latched side: more than any free course (0 … 2), less than a missed bound
SAME_CONTACT = 0.3  # [m] that the blocker may move between two steps and still be the same encounter
_WORTH_IT = 0.1  # share of the speed that a way past the unknown must gain
_WAIT = 0.5  # cost of going slower than the wish, beside what of the way is lost
_AWAITED = 12.0  # [s] within which what moves comes near if it is to be waited for
_FAN = tuple(radians(12.0 * k) for k in range(1, 9))  # off the wish to either side: courses that may be flown slower
_LEADS_BACK = 1.6  # cost above which a course takes back more than it gains: more than 120° off the wish, or not free
_SLOWER = 1.0  # cost of going slower there, by the share of the speed that is lost
_SLOWEST = 0.5  # share of the speed; with less of it left a course leads up to something, not past it
_ANY = 1e3  # [m/s²] of a robot that turns its velocity at once
_OVERTAKE = 0.05  # [m/s] by which the robot outruns what comes from behind


class Sector(NamedTuple):
    """Courses that one contact blocks: those with n·v > bound.

    Attributes:
        normal: (2, 1) unit vector robot → contact in {E}.
        bound: largest n·v [m/s]; negative asks for a retreat.
        point: (2, 1) [m] in {E}, where the contact is; it tells encounters apart.
    """

    normal: ca.SX
    bound: ca.SX
    point: ca.SX


@dataclass(frozen=True)
class Choice:
    """What was chosen.

    Attributes:
        velocity: (2, 1) [m/s] in {E}.
        side: latched side: 0 no encounter, +1 to the left of the wish (obstacle on the right), −1 to the right.
        blocked: 1 when the wish itself was not free.
        violation: by how much the chosen course misses the worst bound [m/s]; 0 when it is free.
        blocker: (2, 1) [m] in {E}: the contact that blocks the wish most.
    """

    velocity: ca.SX
    side: ca.SX
    blocked: ca.SX
    violation: ca.SX
    blocker: ca.SX


def choose_velocity(
    wish: ca.SX,
    sectors: Sequence[Sector],
    *,
    side: ca.SX,
    blocker: ca.SX,
    cruise: ca.SX,
    cap: ca.SX,
    same: float = SAME_CONTACT,
    cones: Sequence[Cone] = (),
    walls: Sequence[Contact] = (),
    now: ca.SX | None = None,
    acceleration: ca.SX | None = None,
    slower: ca.SX | None = None,
) -> Choice:
    """Velocity on the free course nearest to the wish's.

    Candidates are the wish and both edges of every sector; and, while something that moves comes nearer, the wish as
    slow as the sectors ask, and standing still. Where all of these lead back, `slower` allows it, nothing moves and
    nothing asks for a retreat, courses to either side of the wish too, each as slow as the sectors ask: between two
    contacts, each of which bounds the speed towards it, often none is free at the whole speed. If none is free, the one
    that misses its bounds least is taken. The speed is the wish's; no more than `cruise` while the wish is blocked (no
    catching up between obstacles); more, up to `cap`, while a bound asks for a retreat; and reduced as far as the other
    bounds ask.
    Boxed in, the robot stands still if that misses the bounds less than any course.

    Args:
        wish: (2, 1) [m/s] in {E}.
        sectors: what is in the way.
        side: latched side of the last step: −1, 0, +1; kept while the same contact blocks the wish.
        blocker: of the last step.
        cruise: [m/s].
        cap: [m/s].
        same: [m] that the blocker may move between two steps and still be the same encounter.
        cones: of what moves.
        walls: of the site, for the side on which what comes head-on is passed, see `sides`.
        now: velocity over ground (2, 1) [m/s] in {E}, by which what moves is already passed on a side; 0 unless given.
        acceleration: [m/s²] that turns it; any unless given.
        slower: 1 where a slower course may be taken between what stands; never unless given.

    Example:
        >>> import casadi as ca
        >>> from surctl.guidance import Sector, choose_velocity
        >>> wall = Sector(ca.SX([1, 0]), ca.SX(0.05), ca.SX([1, 0]))  # no faster than 0.05 m/s in x
        >>> known = dict(side=ca.SX(0), blocker=ca.SX([0, 0]), cruise=ca.SX(0.15), cap=ca.SX(0.22))
        >>> choice = choose_velocity(ca.SX([0.15, 0.01]), [wall], **known)
        >>> ca.DM(choice.velocity).full().ravel().round(3).tolist(), float(choice.side)  # left round it
        ([0.05, 0.141], 1.0)
    """
    wished = ca.fmax(ca.sqrt(ca.sumsqr(wish)), 1e-3)
    ahead = wish / wished
    retreat = _retreat_speed(sectors, cap)
    near = _violation(ahead, wished, sectors, cones) > _TOLERANCE
    speed = ca.if_else(near, ca.fmin(wished, cruise), wished)
    speed = ca.fmax(speed, ca.if_else(retreat > 0, ca.fmin(retreat + _OVERTAKE, cap), 0))

    own = ca.SX.zeros(2) if now is None else now
    force = ca.SX(_ANY) if acceleration is None else acceleration
    sides, crosses = [], []
    for cone in cones:
        met = inside(speed * ahead, cone) > _TOLERANCE
        head_on, swap = side_costs(cone, wish, walls), swap_costs(cone, own, speed, force)
        sides.append([ca.if_else(met, a, 0) + b for a, b in zip(head_on, swap, strict=True)])
        crosses.append(swap[0] + swap[1] > 0)
    worst, crossed = _worst_blocker(ahead, speed, sectors, cones, crosses)
    held = ca.sumsqr(worst - blocker) <= same * same
    # the side is one of the wish: of what crosses it says nothing, there `swap_costs` holds on to the way round
    latched = ca.if_else(ca.logic_and(held, ca.logic_not(crossed)), side, 0)
    course, missed = ahead, _violation(ahead, speed, sectors, cones)
    blocked = missed > _TOLERANCE
    least, taken = _missed_cost(missed), ca.SX(0)
    # what moves comes nearer, and goes by itself: waiting comes to an end
    pace, waits = speed, ca.SX(0)
    for cone in cones:
        waits = ca.logic_or(waits, ca.logic_and(cone.there, cone.room < -_AWAITED * cone.closing))
    waits = ca.logic_and(waits, retreat <= 0)
    for slow in (_free_speed(ahead, speed, sectors), ca.SX(0)):
        slow_missed = _excess(slow * ahead, sectors, cones)
        cost = 1 - slow / speed + _WAIT + _missed_cost(slow_missed)
        for cone, (on_left, on_right) in zip(cones, sides, strict=True):
            cost += ca.if_else(passes_left(slow * ahead, cone), on_left, on_right)
        better = ca.logic_and(waits, cost < least)
        missed, pace = ca.if_else(better, slow_missed, missed), ca.if_else(better, slow, pace)
        taken, least = ca.if_else(better, latched, taken), ca.if_else(better, cost, least)
    for sign in (1, -1):
        edges = [(sector.normal, sector.bound, sector.bound < speed) for sector in sectors]
        edges += [
            (cone.left, cone.left_bound, cone.there) if sign > 0 else (cone.right, cone.right_bound, cone.there)
            for cone in cones
        ]
        for normal, bound, exists in edges:
            edge = _edge(normal, bound, speed, sign)
            edge_missed = _violation(edge, speed, sectors, cones)
            left = ca.if_else(ahead[0] * edge[1] - ahead[1] * edge[0] >= 0, 1, -1)
            cost = 1 - ca.dot(edge, ahead) + (0 if sign > 0 else _HEAD_ON) + _missed_cost(edge_missed)
            for cone, (on_left, on_right) in zip(cones, sides, strict=True):
                cost += ca.if_else(passes_left(speed * edge, cone), on_left, on_right)
            cost += ca.if_else(latched * left < -0.5, _TURN_BACK, 0)
            cost += ca.if_else(exists, 0, 1e6)  # what blocks nothing has no edge
            better = cost < least
            course, missed = ca.if_else(better, edge, course), ca.if_else(better, edge_missed, missed)
            taken, least = ca.if_else(better, left, taken), ca.if_else(better, cost, least)
            pace = ca.if_else(better, speed, pace)
    if slower is not None:
        slower = ca.logic_and(ca.logic_and(slower, retreat <= 0), least > _LEADS_BACK)
        for cone in cones:
            slower = ca.logic_and(slower, ca.logic_not(cone.there))
        for sign in (1, -1):
            for angle in _FAN:
                turned = _turned(ahead, cos(angle), sign * sin(angle))
                free = _free_speed(turned, speed, sectors)
                # missed is nothing: no bound is negative here, and no cone is there
                cost = 1 - cos(angle) + (0 if sign > 0 else _HEAD_ON) + _SLOWER * (1 - free / speed)
                cost += ca.if_else(latched * sign < -0.5, _TURN_BACK, 0)
                better = ca.logic_and(ca.logic_and(slower, free > _SLOWEST * speed), cost < least)
                course, missed = ca.if_else(better, turned, course), ca.if_else(better, 0, missed)
                taken, least = ca.if_else(better, sign, taken), ca.if_else(better, cost, least)
                pace = ca.if_else(better, free, pace)
    velocity = ca.fmax(ca.fmin(_free_speed(course, speed, sectors), pace), retreat) * course
    # boxed in: where every way out is worse than standing still, stand still
    worse = _excess(velocity, sectors, cones) > _excess(ca.SX.zeros(2), sectors, cones) + _TOLERANCE
    velocity = ca.if_else(ca.logic_and(missed > _TOLERANCE, worse), 0, velocity)
    return Choice(velocity, ca.if_else(blocked, taken, 0), blocked, ca.fmax(missed, 0), worst)


def slowed(velocity: ca.SX, bounds: Sequence[tuple[ca.SX, ca.SX]]) -> ca.SX:
    """The same course (2, 1) [m/s], as slow as the bounds (normal, largest speed along it, not negative) ask.

    Example:
        >>> import casadi as ca
        >>> from surctl.guidance import slowed
        >>> wall = (ca.DM([1, 0]), ca.DM(0.05))  # no faster than 0.05 m/s in x
        >>> ca.DM(slowed(ca.DM([0.2, 0.1]), [wall])).full().ravel().round(3).tolist()
        [0.05, 0.025]
    """
    share = ca.SX(1)
    for normal, bound in bounds:
        along = ca.dot(velocity, normal)
        # a bound of 0 stops only what goes towards it
        share = ca.if_else(along > 1e-6, ca.fmin(share, bound / ca.fmax(along, 1e-6)), share)
    return velocity * share


def round_unknown(
    velocity: ca.SX,
    bounds: Sequence[tuple[ca.SX, ca.SX]],
    sectors: Sequence[Sector],
    *,
    cones: Sequence[Cone] = (),
) -> ca.SX:
    """The chosen velocity, or the free course beside what is unknown on which the robot gets on sooner.

    A place that nobody has seen need not be waited for where there is a way past it. Candidates are the edges of the
    unknown places' sectors, at the speed chosen; the one with the most speed left along the chosen course is taken,
    if it is free and gains enough.

    Args:
        velocity: (2, 1) [m/s] in {E}, as chosen.
        bounds: (normal, largest speed along it, not negative) of each place that is unknown.
        sectors: what is in the way.
        cones: of what moves.

    Example:
        >>> import casadi as ca
        >>> from surctl.guidance import round_unknown
        >>> unknown = (ca.SX([1, 0]), ca.SX(0.02))  # nothing is known ahead: 0.02 m/s at most
        >>> beside = round_unknown(ca.SX([0.15, 0.02]), [unknown], [])
        >>> ca.DM(beside).full().ravel().round(3).tolist()
        [0.02, 0.15]
    """
    speed = ca.fmax(ca.sqrt(ca.sumsqr(velocity)), 1e-3)
    ahead = velocity / speed
    taken, most = velocity, ca.dot(slowed(velocity, bounds), ahead) + _WORTH_IT * speed
    kept = ca.fmax(_excess(velocity, sectors, cones), 0) + _TOLERANCE
    for normal, bound in bounds:
        for sign in (1, -1):
            course = speed * _edge(normal, bound, speed, sign)
            gain = ca.dot(slowed(course, bounds), ahead)
            gain = ca.if_else(_excess(course, sectors, cones) <= kept, gain, 0)
            better = ca.logic_and(bound < speed, gain > most)
            taken, most = ca.if_else(better, course, taken), ca.if_else(better, gain, most)
    return taken


def _edge(n: ca.SX, bound: ca.SX, speed: ca.SX, sign: int) -> ca.SX:
    """Unit course n turned by ± arccos(bound/speed), left for +1."""
    cosine = ca.fmin(ca.fmax(bound / speed, -1), 1)
    return _turned(n, cosine, sign * ca.sqrt(1 - cosine * cosine))


def _turned(n: ca.SX, cosine: ca.SX | float, sine: ca.SX | float) -> ca.SX:
    """A vector (2, 1) turned to the left by the angle of this cosine and sine."""
    return ca.vertcat(n[0] * cosine - n[1] * sine, n[1] * cosine + n[0] * sine)


def _missed_cost(violation: ca.SX) -> ca.SX:
    return ca.if_else(violation > _TOLERANCE, MISSED + MISSED_RATE * violation, 0)


def _violation(course: ca.SX, speed: ca.SX, sectors: Sequence[Sector], cones: Sequence[Cone]) -> ca.SX:
    return _excess(speed * course, sectors, cones)


def _excess(velocity: ca.SX, sectors: Sequence[Sector], cones: Sequence[Cone]) -> ca.SX:
    """By how much a velocity (2, 1) misses the worst bound [m/s]; negative when it keeps them all."""
    worst = ca.SX(-10.0)
    for sector in sectors:
        worst = ca.fmax(worst, ca.dot(velocity, sector.normal) - sector.bound)
    for cone in cones:
        worst = ca.fmax(worst, inside(velocity, cone))
    return worst


def _worst_blocker(
    course: ca.SX, speed: ca.SX, sectors: Sequence[Sector], cones: Sequence[Cone], crosses: Sequence[ca.SX]
) -> tuple[ca.SX, ca.SX]:
    """Where what blocks a course most is, and whether it is a cone whose contact crosses."""
    worst, where, crossed = ca.SX(-10.0), sectors[0].point, ca.SX(0)
    for sector in sectors:
        violation = speed * ca.dot(course, sector.normal) - sector.bound
        where = ca.if_else(violation > worst, sector.point, where)
        worst = ca.fmax(worst, violation)
    for cone, crossing in zip(cones, crosses, strict=True):
        depth = inside(speed * course, cone)
        where, crossed = ca.if_else(depth > worst, cone.point, where), ca.if_else(depth > worst, crossing, crossed)
        worst = ca.fmax(worst, depth)
    return where, crossed


def _retreat_speed(sectors: Sequence[Sector], cap: ca.SX) -> ca.SX:
    retreat = ca.SX(0)
    for sector in sectors:
        retreat = ca.fmax(retreat, ca.fmin(-sector.bound, cap))
    return retreat


def _free_speed(course: ca.SX, speed: ca.SX, sectors: Sequence[Sector]) -> ca.SX:
    """Largest speed up to `speed` on this course that no non-negative bound forbids."""
    free = speed
    for sector in sectors:
        along = ca.dot(course, sector.normal)
        limit = ca.fmax(sector.bound, 0) / ca.fmax(along, 1e-3)
        free = ca.if_else(along > 1e-3, ca.fmin(free, limit), free)
    return free
