"""The contacts (nearby objects) as arrays: sectors of blocked courses, and collision cones of moving contacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca

from surctl.ir import each, fold, tabulated
from surctl.marine.guidance.cones import Cone, inside
from surctl.marine.guidance.contacts import Contact
from surctl.marine.guidance.sides import passes_left, side_costs, swap_costs

__all__ = ["TOLERANCE", "Around", "Sector", "edge", "turned"]

TOLERANCE = 1e-3
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
        """Return the sector whose numbers form one row of the array `Around.sectors`."""
        return Sector(row[:2], row[2], row[3:5])


@dataclass(frozen=True)
class Around:
    """The contacts (nearby objects) as arrays: `sectors` (n, 5), `cones` (m, 17) and `sides` (m, 3).

    Each row of `sectors` is a `Sector`, and each row of `cones` is a `Cone`.

    For each cone, a row of `sides` holds three numbers: the cost of passing the contact on its left, the cost of
    passing it on its right, and 1 if the contact crosses the robot's course.
    """

    sectors: ca.SX
    cones: ca.SX
    sides: ca.SX | None = None

    @staticmethod
    def of(sectors: Sequence[Sector], cones: Sequence[Cone]) -> Around:
        """Return the arrays of the given sectors and collision cones; the array `sides` is None."""
        return Around(tabulated(sectors, 5), tabulated(cones, 17))

    def with_sides(
        self, desired: ca.SX, speed: ca.SX, velocity: ca.SX, now: ca.SX, acceleration: ca.SX, walls: Sequence[Contact]
    ) -> Around:
        """Return a copy with the array `sides`: costs of passing each moving contact on its left and right."""

        def sides(row: ca.SX) -> tuple[ca.SX]:
            cone = Cone.of(row)
            met = inside(velocity, cone) > TOLERANCE
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


def edge(n: ca.SX, bound: ca.SX, speed: ca.SX, sign: ca.SX) -> ca.SX:
    """Return the left edge (`sign` +1) or the right edge (−1) of a sector: n turned by arccos(bound/speed)."""
    cosine = ca.fmin(ca.fmax(bound / speed, -1), 1)
    return turned(n, cosine, sign * ca.sqrt(1 - cosine * cosine))


def turned(n: ca.SX, cosine: ca.SX | float, sine: ca.SX | float) -> ca.SX:
    """Return a vector (2, 1) turned to the left by the angle with the given cosine and sine."""
    return ca.vertcat(n[0] * cosine - n[1] * sine, n[1] * cosine + n[0] * sine)
