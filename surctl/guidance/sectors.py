"""Choice of a course among many contacts: each blocks a sector of courses, the free course nearest the wish wins.

For one contact the edges of its sector are exactly the `corrected` law φ ± arccos(·) of `avoidance`, with the
braking distance in place of κ(l − R_OB − d_s): n·v ≤ a(l) + v_o·n. No trigonometric function is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import cos, radians, sin
from typing import NamedTuple

import casadi as ca

from surctl.guidance.around import TOLERANCE, Around, Sector, edge, turned
from surctl.guidance.cones import Cone
from surctl.guidance.contacts import Contact
from surctl.guidance.sides import MISSED, MISSED_RATE
from surctl.ir import fold, only_if, tabulated

__all__ = ["Choice", "Sector", "choose_velocity", "round_unknown", "slowed"]

_HEAD_ON = 1e-4  # cost of −1 between two equal edges: head-on the obstacle stays on the right (E10)
_TURN_BACK = 8.0  # cost of leaving the latched side: more than any free course (0 … 2), less than a missed bound
SAME_CONTACT = 0.3  # [m] that the blocker may move between two steps and still be the same encounter
_WORTH_IT = 0.1  # share of the speed that a way past the unknown must gain
_WAIT = 0.5  # cost of going slower than the wish, beside what of the way is lost
_FAN = tuple(radians(12.0 * k) for k in range(1, 9))  # off the wish to either side: courses that may be flown slower
_LEADS_BACK = 1.6  # cost above which a slower course may be better: of 120° off the wish, of leaving the latched side
_SLOWER = 1.0  # cost of going slower there, by the share of the speed that is lost
_SLOWEST = 0.5  # share of the speed; with less of it left a course leads up to something, not past it
_ANY = 1e3  # [m/s²] of a robot that turns its velocity at once
_NEVER = 1e6  # cost of what is no candidate
_OVERTAKE = 0.05  # [m/s] by which the robot outruns what comes from behind


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
) -> Choice:
    """Velocity on the free course nearest to the wish's.

    Candidates are the wish and both edges of every sector; and, while something that moves comes nearer, the wish as
    slow as the sectors ask, and standing still. Where all of these lead back or leave the latched side, `slower` allows
    it, nothing moves and nothing asks for a retreat, courses to either side of the wish too, each as slow as the
    sectors ask: between two contacts, each of which bounds the speed towards it, often none is free at the whole speed.
    If none is free, the one that misses its bounds least is taken. The speed is the wish's; no more than `cruise` while
    the wish is blocked (no catching up between obstacles); more, up to `cap`, while a bound asks for a retreat; and
    reduced as far as the other bounds ask.
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
    desired_speed = ca.fmax(ca.sqrt(ca.sumsqr(desired)), 1e-3)
    ahead = desired / desired_speed
    around = Around.of(sectors, cones)
    retreat = fold("retreat", lambda most, row: ca.fmax(most, ca.fmin(-row[2], cap)), ca.SX(0), around.sectors)
    near = around.excess(desired_speed * ahead) > TOLERANCE
    speed = ca.if_else(near, ca.fmin(desired_speed, cruise), desired_speed)
    speed = ca.fmax(speed, ca.if_else(retreat > 0, ca.fmin(retreat + _OVERTAKE, cap), 0))

    own = ca.SX.zeros(2) if now is None else now
    force = ca.SX(_ANY) if acceleration is None else acceleration
    around = around.with_sides(desired, speed, speed * ahead, own, force, walls)
    worst, crossed = around.worst_blocker(ahead, speed)
    held = ca.sumsqr(worst - blocker) <= same * same
    # the side is one of the wish: of what crosses it says nothing, there `swap_costs` holds on to the way round
    latched = ca.if_else(ca.logic_and(held, ca.logic_not(crossed)), side, 0)
    missed = around.excess(speed * ahead)
    blocked = missed > TOLERANCE
    best = _Best(ahead, missed, ca.SX(0), _missed_cost(missed), speed)
    search = _Search(around, ahead, speed, latched)
    at_first = best
    waits = ca.logic_and(around.waits(), retreat <= 0)
    best = search.edges(_Best(*only_if("waiting", waits, lambda: search.waiting(at_first), at_first)))
    if slower is not None:
        slower = ca.logic_and(ca.logic_and(slower, retreat <= 0), best.least > _LEADS_BACK)
        slower = ca.logic_and(slower, ca.logic_not(around.any_there()))
        current = best
        best = _Best(*only_if("slower", slower, lambda: search.slower(current), current))
    velocity = ca.fmax(ca.fmin(around.free_speed(best.course, speed), best.pace), retreat) * best.course
    # boxed in: where every way out is worse than standing still, stand still
    worse = around.excess(velocity) > around.excess(ca.SX.zeros(2)) + TOLERANCE
    velocity = ca.if_else(ca.logic_and(best.missed > TOLERANCE, worse), 0, velocity)
    return Choice(velocity, ca.if_else(blocked, best.side, 0), blocked, ca.fmax(best.missed, 0), worst)


class _Best(NamedTuple):
    """The candidate so far: course (2, 1), by how much it misses the bounds, its side, its cost, its speed."""

    course: ca.SX
    missed: ca.SX
    side: ca.SX
    least: ca.SX
    pace: ca.SX

    def or_else(self, course: ca.SX, missed: ca.SX, side: ca.SX, cost: ca.SX, pace: ca.SX) -> _Best:
        """The other one where it costs less."""
        other = _Best(course, missed, side, cost, pace)
        return _Best(*(ca.if_else(cost < self.least, b, a) for a, b in zip(self, other, strict=True)))


@dataclass(frozen=True)
class _Search:
    """The candidates, in their order: of two that cost the same the first is taken."""

    around: Around
    ahead: ca.SX
    speed: ca.SX
    latched: ca.SX

    def waiting(self, best: _Best) -> _Best:
        """The wish as slow as the sectors ask, and standing still."""
        for slow in (self.around.free_speed(self.ahead, self.speed), ca.SX(0)):
            missed = self.around.excess(slow * self.ahead)
            cost = 1 - slow / self.speed + _WAIT + _missed_cost(missed)
            cost = self.around.passing(slow * self.ahead, cost)
            best = best.or_else(best.course, missed, self.latched, cost, slow)
        return best

    def edges(self, best: _Best) -> _Best:
        """Both edges of every sector and cone: all left ones, then all right ones."""

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

        return _Best(*fold("both_sides", on_one_side, best, ca.SX([[1, 0], [-1, _HEAD_ON]])))

    def _edge(self, best: _Best, normal: ca.SX, bound: ca.SX, sign: ca.SX, dearer: ca.SX) -> _Best:
        course, ahead = edge(normal, bound, self.speed, sign), self.ahead
        missed = self.around.excess(self.speed * course)
        left = ca.if_else(ahead[0] * course[1] - ahead[1] * course[0] >= 0, 1, -1)
        cost = 1 - ca.dot(course, ahead) + dearer + _missed_cost(missed)
        cost = self.around.passing(self.speed * course, cost)
        cost += ca.if_else(self.latched * left < -0.5, _TURN_BACK, 0)
        return best.or_else(course, missed, left, cost, self.speed)

    def slower(self, best: _Best) -> _Best:
        """Courses to either side of the wish, each as slow as the sectors ask."""
        fan = [
            (cos(angle), sign * sin(angle), sign, 1 - cos(angle) + (0 if sign > 0 else _HEAD_ON))
            for sign in (1, -1)
            for angle in _FAN
        ]

        def course(*values: ca.SX) -> _Best:
            *held, row = values
            aside, sign, off = turned(self.ahead, row[0], row[1]), row[2], row[3]
            free = self.around.free_speed(aside, self.speed)
            # missed is nothing: no bound is negative here, and no cone is there
            cost = off + _SLOWER * (1 - free / self.speed)
            cost += ca.if_else(self.latched * sign < -0.5, _TURN_BACK, 0)
            cost = ca.if_else(free > _SLOWEST * self.speed, cost, _NEVER)
            return _Best(*held).or_else(aside, ca.SX(0), sign, cost, free)

        return _Best(*fold("slower_course", course, best, ca.SX(fan)))


def slowed(velocity: ca.SX, bounds: Sequence[tuple[ca.SX, ca.SX]]) -> ca.SX:
    """The same course (2, 1) [m/s], as slow as the bounds (normal, largest speed along it, not negative) ask.

    Example:
        >>> import casadi as ca
        >>> from surctl.guidance import slowed
        >>> wall = (ca.DM([1, 0]), ca.DM(0.05))  # no faster than 0.05 m/s in x
        >>> ca.DM(slowed(ca.DM([0.2, 0.1]), [wall])).full().ravel().round(3).tolist()
        [0.05, 0.025]
    """

    def slowest(share: ca.SX, row: ca.SX) -> ca.SX:
        along = ca.dot(velocity, row[:2])
        # a bound of 0 stops only what goes towards it
        return ca.if_else(along > 1e-6, ca.fmin(share, row[2] / ca.fmax(along, 1e-6)), share)

    return velocity * fold("slowed", slowest, ca.SX(1), tabulated(bounds, 3))


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
    around = Around.of(sectors, cones)
    allowed_excess = ca.fmax(around.excess(velocity), 0) + TOLERANCE

    def beside(chosen: ca.SX, most: ca.SX, row: ca.SX) -> list[ca.SX]:
        def one_side(best: ca.SX, most: ca.SX, sign: ca.SX) -> list[ca.SX]:
            course = speed * edge(row[:2], row[2], speed, sign)
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
    return ca.if_else(violation > TOLERANCE, MISSED + MISSED_RATE * violation, 0)
