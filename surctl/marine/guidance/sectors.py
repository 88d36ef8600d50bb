"""Choice of a free course and speed past several contacts, of waiting, and of a way round unknown water.

The law chooses the free course nearest to the desired velocity. Let n be the unit vector from robot to contact, v_o the
contact's velocity, and a(l) the closing speed from which the robot can still stop at the distance l. A velocity v is
free if n·v ≤ a(l) + v_o·n. For one contact, the edges of the blocked sector are the courses of the form `corrected` of
`avoidance_course`, with a(l) in place of κ(l − R_OB − d_s).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import cos, radians, sin
from typing import NamedTuple, TypeAlias

import casadi as ca

from surctl.ir import each, fold, only_if, tabulated
from surctl.marine.guidance.contacts import (
    MISSED,
    MISSED_RATE,
    Cone,
    Contact,
    inside,
    passes_left,
    side_costs,
    swap_costs,
)

_TOLERANCE = 1e-3
"""Violation of a bound [m/s] up to which a course still counts as free."""

_AWAITED = 12.0  # [s] time in which a moving contact must come near, for the robot to wait for it


class Sector(NamedTuple):
    """The sector of courses that one contact (nearby object) blocks: all velocities v with n·v > bound.

    Attributes:
        normal: (2, 1) unit vector n from robot to contact, in {E}.
        bound: largest allowed n·v [m/s]; a negative bound requires that the robot retreats.
        point: (2, 1) [m] in {E}, position of the contact; if this position jumps between two steps, the law assumes
            that another contact blocks the course.
    """

    normal: ca.SX
    bound: ca.SX
    point: ca.SX

    @staticmethod
    def of(row: ca.SX) -> Sector:
        """Return the sector whose numbers form one row of the array `StepState.sectors`."""
        return Sector(row[:2], row[2], row[3:5])


Bounds: TypeAlias = Sequence[Sector] | Sequence[tuple[ca.SX, ca.SX]]
"""Speed bounds: unit vectors (2, 1) in {E}, and the largest speed along each [m/s]."""


@dataclass(frozen=True)
class _Around:
    """The contacts (nearby objects) as arrays: `sectors` (n, 5), `cones` (m, 17) and `sides` (m, 3).

    Each row of `sectors` is a `Sector`, and each row of `cones` is a `Cone`.

    For each cone, a row of `sides` holds three numbers: the cost of passing the contact on its left, the cost of
    passing it on its right, and 1 if the contact crosses the robot's course.
    """

    sectors: ca.SX
    cones: ca.SX
    sides: ca.SX | None = None

    @staticmethod
    def of(sectors: Sequence[Sector], cones: Sequence[Cone]) -> _Around:
        """Return the arrays of the given sectors and collision cones; the array `sides` is None."""
        return _Around(tabulated(sectors, 5), tabulated(cones, 17))

    def with_sides(
        self, desired: ca.SX, speed: ca.SX, velocity: ca.SX, now: ca.SX, acceleration: ca.SX, walls: Sequence[Contact]
    ) -> _Around:
        """Return a copy with the array `sides`: costs of passing each moving contact on its left and right."""

        def sides(row: ca.SX) -> tuple[ca.SX]:
            cone = Cone.of(row)
            met = inside(velocity, cone) > _TOLERANCE
            head_on, swap = side_costs(cone, desired, walls), swap_costs(cone, now, speed, acceleration)
            costs = [ca.if_else(met, a, 0) + b for a, b in zip(head_on, swap, strict=True)]
            return (ca.vertcat(*costs, swap[0] + swap[1] > 0),)

        return replace(self, sides=each("sides", sides, self.cones)[0]) if self.cones.shape[0] else self

    def excess(self, velocity: ca.SX) -> ca.SX:
        """Return how deep [m/s] a velocity (2, 1) lies in any sector or cone; negative if it lies in none."""

        def missed(worst: ca.SX, row: ca.SX) -> ca.SX:
            return ca.fmax(worst, ca.dot(velocity, row[:2]) - row[2])

        worst = fold("excess", missed, ca.SX(-10.0), self.sectors)
        return fold("depth", lambda worst, row: ca.fmax(worst, inside(velocity, Cone.of(row))), worst, self.cones)

    def free_speed(self, course: ca.SX, speed: ca.SX) -> ca.SX:
        """Return the largest speed [m/s], at most `speed`, at which a course violates no bound of a sector.

        The course is a unit vector (2, 1). A negative bound counts as 0.
        """

        def limited(free: ca.SX, row: ca.SX) -> ca.SX:
            along = ca.dot(course, row[:2])
            limit = ca.fmax(row[2], 0) / ca.fmax(along, 1e-3)
            return ca.if_else(along > 1e-3, ca.fmin(free, limit), free)

        return fold("free_speed", limited, speed, self.sectors)

    def passing(self, velocity: ca.SX, cost: ca.SX) -> ca.SX:
        """Return `cost` plus, for each moving contact, the cost of the side on which `velocity` passes the contact."""

        def passed(cost: ca.SX, row: ca.SX, sides: ca.SX) -> ca.SX:
            return cost + ca.if_else(passes_left(velocity, Cone.of(row)), sides[0], sides[1])

        return cost if self.sides is None else fold("passing", passed, cost, self.cones, self.sides)

    def waits(self) -> ca.SX:
        """Return whether a moving contact will reach the robot so soon that the robot should wait for it to pass."""

        def soon(any_other: ca.SX, row: ca.SX) -> ca.SX:
            cone = Cone.of(row)
            return ca.logic_or(any_other, ca.logic_and(cone.there, cone.clearance < -_AWAITED * cone.closing))

        return fold("waits", soon, ca.SX(0), self.cones)

    def any_there(self) -> ca.SX:
        """Return whether at least one contact moves."""
        return fold("there", lambda other, row: ca.logic_or(other, Cone.of(row).there), ca.SX(0), self.cones)

    def worst_blocker(self, course: ca.SX, speed: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the position of the contact that blocks a course most, and whether this contact crosses the course."""

        def by_sector(worst: ca.SX, where: ca.SX, row: ca.SX) -> list[ca.SX]:
            violation = speed * ca.dot(course, row[:2]) - row[2]
            return [ca.fmax(worst, violation), ca.if_else(violation > worst, row[3:5], where)]

        def by_cone(worst: ca.SX, where: ca.SX, crossed: ca.SX, row: ca.SX, sides: ca.SX) -> list[ca.SX]:
            depth = inside(speed * course, Cone.of(row))
            deeper = depth > worst
            there, crosses = ca.if_else(deeper, row[15:17], where), ca.if_else(deeper, sides[2], crossed)
            return [ca.fmax(worst, depth), there, crosses]

        worst, where = fold("worst_sector", by_sector, [ca.SX(-10.0), self.sectors[0, 3:5].T], self.sectors)
        if self.sides is None:
            return where, ca.SX(0)
        _, where, crossed = fold("worst_cone", by_cone, [worst, where, ca.SX(0)], self.cones, self.sides)
        return where, crossed


def _edge(n: ca.SX, bound: ca.SX, speed: ca.SX, sign: ca.SX) -> ca.SX:
    """Return the left edge (`sign` +1) or the right edge (−1) of a sector: n turned by arccos(bound/speed)."""
    cosine = ca.fmin(ca.fmax(bound / speed, -1), 1)
    return _turned(n, cosine, sign * ca.sqrt(1 - cosine * cosine))


def _turned(n: ca.SX, cosine: ca.SX | float, sine: ca.SX | float) -> ca.SX:
    """Return a vector (2, 1) turned to the left by the angle with the given cosine and sine."""
    return ca.vertcat(n[0] * cosine - n[1] * sine, n[1] * cosine + n[0] * sine)


_HEAD_ON = 1e-4  # cost of side −1 between two equal edges, so a head-on obstacle stays on the right (E10)
_SIDES = ((1, 0), (-1, _HEAD_ON))  # the sides left and right of the desired course, and the cost of each
_TURN_BACK = 8.0  # cost of leaving the latched side: more than that of a free course (0 … 2), less than of a violation
SAME_CONTACT = 0.3  # [m] that the blocking point may move between two steps in the same encounter
_WORTH_IT = 0.1  # share of the speed that a detour around unknown space must gain
_WAIT = 0.5  # cost of being slower than desired, in addition to the share of the speed that is lost
_FAN = tuple(radians(12.0 * k) for k in range(1, 9))  # [rad] off the desired course: candidates at a lower speed
_LEADS_BACK = 1.6  # cost above which slower courses are tried: about 120° off the desired course, or the other side
_STRAIGHT_BACK = cos(radians(15.0))  # cosine to straight back above which a course may keep the side
_SLOWER = 1.0  # cost of a slower course per share of the speed that is lost
_SLOWEST = 0.5  # share of the speed below which a slower course leads up to a contact and not past it
_ANY = 1e3  # [m/s²] acceleration of a robot that can turn its velocity at once
_NEVER = 1e6  # cost that excludes a candidate
_OVERTAKE = 0.05  # [m/s] by which the robot is faster than a contact from behind


@dataclass(frozen=True)
class Choice:
    """The velocity that the avoidance law chose, and the data of the encounter that the next step needs.

    Attributes:
        velocity: chosen velocity (2, 1) [m/s] in {E}.
        side: side of the chosen course, which stays the same during an encounter (0: no encounter; +1: left of the
            desired velocity, obstacle on the right; −1: right of the desired velocity).
        blocked: 1 if the desired velocity is not free.
        violation: largest violation of a bound by the chosen course [m/s]; 0 if the chosen course is free.
        blocker: (2, 1) [m] in {E}, position of the contact that blocks the desired velocity most.
    """

    velocity: ca.SX
    side: ca.SX
    blocked: ca.SX
    violation: ca.SX
    blocker: ca.SX


def choose_velocity(
    desired: ca.SX,
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
    keeps: ca.SX | None = None,
) -> Choice:
    """Return the velocity on the free course nearest to the desired velocity.

    The candidates are the desired course and both edges of every sector and of every cone. While a moving contact
    approaches, there are two more candidates: the desired course at reduced speed, and zero velocity. Courses on either
    side of the desired course at reduced speed are further candidates if four conditions hold: all other candidates
    lead back or change the side of the previous step; `slower` is 1; no contact moves; and no bound requires a retreat.
    (Between two contacts that both limit the speed, often no course is free at full speed.) If no candidate is free,
    the function chooses the candidate with the smallest violation of a bound.

    The speed of the result is normally the desired speed. The speed is at most `cruise` while the desired velocity is
    blocked, so that the robot does not speed up between obstacles to catch up. While a bound requires a retreat, the
    speed may be higher, up to `cap`, as far as the other bounds allow. If zero velocity violates the bounds less than
    every course, the robot stops.

    Args:
        desired: desired velocity (2, 1) [m/s] in {E}.
        side: `Choice.side` of the previous step (−1, 0 or +1); the side does not change while the same contact blocks
            the course.
        blocker: `Choice.blocker` of the previous step.
        cruise: largest speed while the desired velocity is blocked [m/s].
        same: if the position of the blocking contact moves further than this between two steps [m], the law assumes
            that another contact blocks the course.
        walls: walls of the site; they influence on which side the robot passes a head-on contact, see `sides`.
        now: velocity over ground (2, 1) [m/s] in {E}; it determines the side on which the robot is already passing a
            contact; default: 0.
        acceleration: available acceleration [m/s²] to turn the velocity; default: unlimited.
        slower: 1 if courses at reduced speed between contacts at rest are allowed; default: not allowed.
        keeps: 1 if a course within 15° of straight back counts as on the side of the previous step. Back along an
            obstacle, a course that keeps off its nearest point passes straight back for a moment, which would end the
            encounter on this side; default: every course is left or right of the desired course.
    """
    desired_speed = ca.fmax(ca.sqrt(ca.sumsqr(desired)), 1e-3)
    ahead = desired / desired_speed
    around = _Around.of(sectors, cones)
    retreat = fold("retreat", lambda most, row: ca.fmax(most, ca.fmin(-row[2], cap)), ca.SX(0), around.sectors)
    near = around.excess(desired_speed * ahead) > _TOLERANCE
    speed = ca.if_else(near, ca.fmin(desired_speed, cruise), desired_speed)
    speed = ca.fmax(speed, ca.if_else(retreat > 0, ca.fmin(retreat + _OVERTAKE, cap), 0))

    own = ca.SX.zeros(2) if now is None else now
    force = ca.SX(_ANY) if acceleration is None else acceleration
    around = around.with_sides(desired, speed, speed * ahead, own, force, walls)
    worst, crossed = around.worst_blocker(ahead, speed)
    held = ca.sumsqr(worst - blocker) <= same * same
    # the latched side refers to the desired course, so it does not apply to crossing contacts; see `swap_costs`
    latched = ca.if_else(ca.logic_and(held, ca.logic_not(crossed)), side, 0)
    missed = around.excess(speed * ahead)
    blocked = missed > _TOLERANCE
    best = _Best(ahead, missed, ca.SX(0), _missed_cost(missed), speed)
    search = _Search(around, ahead, speed, latched, keeps)
    at_first = best
    waits = ca.logic_and(around.waits(), retreat <= 0)
    best = search.edges(_Best(*only_if("waiting", waits, lambda: search.waiting(at_first), at_first)))
    if slower is not None:
        slower = ca.logic_and(ca.logic_and(slower, retreat <= 0), best.least > _LEADS_BACK)
        slower = ca.logic_and(slower, ca.logic_not(around.any_there()))
        current = best
        best = _Best(*only_if("slower", slower, lambda: search.slower(current), current))
    velocity = ca.fmax(ca.fmin(around.free_speed(best.course, speed), best.pace), retreat) * best.course
    # boxed in: the robot stops if every course violates the bounds more than zero velocity does
    worse = around.excess(velocity) > around.excess(ca.SX.zeros(2)) + _TOLERANCE
    velocity = ca.if_else(ca.logic_and(best.missed > _TOLERANCE, worse), 0, velocity)
    return Choice(velocity, ca.if_else(blocked, best.side, 0), blocked, ca.fmax(best.missed, 0), worst)


class _Best(NamedTuple):
    course: ca.SX  # (2, 1)
    missed: ca.SX  # largest violation of a bound [m/s]
    side: ca.SX
    least: ca.SX  # cost
    pace: ca.SX  # speed [m/s]

    def or_else(self, course: ca.SX, missed: ca.SX, side: ca.SX, cost: ca.SX, pace: ca.SX) -> _Best:
        other = _Best(course, missed, side, cost, pace)
        return _Best(*(ca.if_else(cost < self.least, b, a) for a, b in zip(self, other, strict=True)))


@dataclass(frozen=True)
class _Search:
    """Search over all candidates in a fixed order; among candidates with equal cost the first is chosen."""

    around: _Around
    ahead: ca.SX
    speed: ca.SX
    latched: ca.SX
    keeps: ca.SX | None

    def waiting(self, best: _Best) -> _Best:
        """Try two candidates: the desired course at the speed that the sectors allow, and zero velocity."""
        for slow in (self.around.free_speed(self.ahead, self.speed), ca.SX(0)):
            missed = self.around.excess(slow * self.ahead)
            cost = 1 - slow / self.speed + _WAIT + _missed_cost(missed)
            cost = self.around.passing(slow * self.ahead, cost)
            best = best.or_else(best.course, missed, self.latched, cost, slow)
        return best

    def edges(self, best: _Best) -> _Best:
        """Try both edges of every sector and cone as candidates: first all left edges, then all right edges."""

        def on_one_side(*values: ca.SX) -> list[ca.SX]:
            *held, side = values
            sign, dearer = side[0], side[1]

            def sector(*values: ca.SX) -> list[ca.SX]:
                *held, row = values
                at_edge = partial(self._edge, _Best(*held), row[:2], row[2], sign, dearer)
                return only_if("sector_edge", row[2] < self.speed, at_edge, held)

            def cone(*numbers: ca.SX) -> list[ca.SX]:
                *held, row = numbers
                c, left = Cone.of(row), sign > 0
                normal, bound = ca.if_else(left, c.left, c.right), ca.if_else(left, c.left_bound, c.right_bound)
                at_edge = partial(self._edge, _Best(*held), normal, bound, sign, dearer)
                return only_if("cone_edge", c.there, at_edge, held)

            held = fold("sector_edges", sector, held, self.around.sectors)
            return fold("cone_edges", cone, held, self.around.cones)

        return _Best(*fold("both_sides", on_one_side, best, ca.SX(_SIDES)))

    def _edge(self, best: _Best, normal: ca.SX, bound: ca.SX, sign: ca.SX, dearer: ca.SX) -> _Best:
        course, ahead = _edge(normal, bound, self.speed, sign), self.ahead
        missed = self.around.excess(self.speed * course)
        left = ca.if_else(ahead[0] * course[1] - ahead[1] * course[0] >= 0, 1, -1)
        if self.keeps is not None:
            back = ca.logic_and(self.keeps, ca.dot(course, ahead) < -_STRAIGHT_BACK)
            left = ca.if_else(ca.logic_and(back, ca.fabs(self.latched) > 0.5), self.latched, left)
        cost = 1 - ca.dot(course, ahead) + dearer + _missed_cost(missed)
        cost = self.around.passing(self.speed * course, cost)
        cost += ca.if_else(self.latched * left < -0.5, _TURN_BACK, 0)
        return best.or_else(course, missed, left, cost, self.speed)

    def slower(self, best: _Best) -> _Best:
        """Try courses on either side of the desired course, each course at the speed that the sectors allow."""

        def on_one_side(*values: ca.SX) -> list[ca.SX]:
            *held, side = values
            sign, dearer = side[0], side[1]

            def course(*values: ca.SX) -> _Best:
                *held, row = values
                aside = _turned(self.ahead, row[0], sign * row[1])
                free = self.around.free_speed(aside, self.speed)
                # no violation is possible: here no bound is negative and there is no cone
                cost = row[2] + dearer + _SLOWER * (1 - free / self.speed)
                cost += ca.if_else(self.latched * sign < -0.5, _TURN_BACK, 0)
                cost = ca.if_else(free > _SLOWEST * self.speed, cost, _NEVER)
                return _Best(*held).or_else(aside, ca.SX(0), sign, cost, free)

            return fold("slower_course", course, held, ca.SX([[cos(a), sin(a), 1 - cos(a)] for a in _FAN]))

        return _Best(*fold("slower_side", on_one_side, best, ca.SX(_SIDES)))


def slowed(velocity: ca.SX, bounds: Bounds, *, added: ca.SX | None = None) -> ca.SX:
    """Return a velocity (2, 1) [m/s] on the given velocity's course, slowed down to satisfy the bounds.

    A negative bound counts as 0. `added` is a velocity (2, 1) [m/s] that is added to the result afterwards; it uses up
    a part of each bound.
    """

    def slowest(share: ca.SX, row: ca.SX) -> ca.SX:
        along = ca.dot(velocity, row[:2])
        left = ca.fmax(row[2] if added is None else row[2] - ca.dot(row[:2], added), 0)
        # a bound of 0 stops only a motion towards it
        return ca.if_else(along > 1e-6, ca.fmin(share, left / ca.fmax(along, 1e-6)), share)

    return velocity * fold("slowed", slowest, ca.SX(1), tabulated(bounds, 3))


def round_unknown(velocity: ca.SX, bounds: Bounds, sectors: Sequence[Sector], *, cones: Sequence[Cone] = ()) -> ca.SX:
    """Return the given velocity, or a velocity around unknown water with which the robot advances faster.

    The robot need not wait for a sonar scan of unknown water if it can go around it. The candidates have the given
    speed on the edges of the sectors that the unknown areas block, and are slowed down to satisfy all bounds: a unit
    vector towards each area and the largest speed [m/s] along it. Of the candidates on free courses, the function
    returns the one that then advances fastest along the given course, if it is sufficiently faster than the given
    velocity.
    """
    speed = ca.fmax(ca.sqrt(ca.sumsqr(velocity)), 1e-3)
    ahead = velocity / speed
    around = _Around.of(sectors, cones)
    allowed_excess = ca.fmax(around.excess(velocity), 0) + _TOLERANCE

    def beside(chosen: ca.SX, most: ca.SX, row: ca.SX) -> list[ca.SX]:
        def one_side(best: ca.SX, most: ca.SX, sign: ca.SX) -> list[ca.SX]:
            course = speed * _edge(row[:2], row[2], speed, sign)
            gain = ca.dot(slowed(course, bounds), ahead)
            gain = ca.if_else(around.excess(course) <= allowed_excess, gain, 0)
            return [ca.if_else(gain > most, course, best), ca.if_else(gain > most, gain, most)]

        def both() -> list[ca.SX]:
            result: list[ca.SX] = fold("one_side", one_side, [chosen, most], ca.SX([1, -1]))
            return result

        return only_if("beside", row[2] < speed, both, [chosen, most])

    most = ca.dot(slowed(velocity, bounds), ahead) + _WORTH_IT * speed
    return fold("past_unknown", beside, [velocity, most], tabulated(bounds, 3))[0]


def _missed_cost(violation: ca.SX) -> ca.SX:
    return ca.if_else(violation > _TOLERANCE, MISSED + MISSED_RATE * violation, 0)
