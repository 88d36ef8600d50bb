"""Consistent actuator limits: velocity and acceleration bounds widened to a velocity that the thrust can reach."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from surctl.errors import InputError
from surctl.tasks.acceleration import AccelerationLimit
from surctl.tasks.limits import VelocityBox
from surctl.tasks.rows import LimitRow
from surctl.tasks.thrust import ThrustLimit

__all__ = ["ActuatorLimits"]


@dataclass(frozen=True, eq=False)
class ActuatorLimits:
    """Limits on velocity, acceleration and thrust; the first two are widened so that a feasible velocity exists.

    Each limit is a set of commanded velocities: B from the velocity bounds, A from the acceleration bounds, and T from
    the thrust bounds. If the present velocity ν is far outside B, or if drag and Coriolis forces exceed the thrust, the
    sets may have no common point. The thrust is a physical limit, so T does not change. B and A are widened to contain
    a point p of T:

        q = the point of A nearest to (the point of B nearest to ν),
        p = the velocity that the vehicle reaches with the thrust for q, clipped to the thrust bounds,
        B' = hull(B, p),   A' = hull(A, p).

    B' is the smallest box that contains B and p, and A' is the smallest box that contains A and p. So B', A' and T
    always have the common point p. The boxes do not change while ν is in B and the thrust can hold ν. If the mass
    matrix is diagonal and A, B and T have a common point, B' equals B. If the mass matrix is not diagonal, another
    point of T may widen the boxes less than p does.

    Attributes:
        box: bounds on the velocity (set B).
        thrust: bounds on the thrust (set T), with lower ≤ upper.
        acceleration: bounds on the acceleration (set A), with the same ν and dt as `thrust`; None for no such limit.

    Raises:
        InputError: ν or dt of `acceleration` differs from that of `thrust`, or two of the limits have the same name.
    """

    box: VelocityBox
    thrust: ThrustLimit
    acceleration: AccelerationLimit | None = None

    def __post_init__(self) -> None:
        """Check that thrust and acceleration limit have equal ν and dt, and that all limits have different names."""
        sizes = {ca.SX(v).numel() for v in (self.box.lower, self.thrust.nu)}
        if len(sizes) > 1:
            raise InputError("has another number of velocities than the box", key=f"limit {self.thrust.name}")
        names = [limit.name for limit in (self.box, self.thrust, self.acceleration) if limit is not None]
        for name in names:
            if names.count(name) > 1:
                raise InputError("names two of the actuator limits", key=f"limit {name}", remedy="rename one of them")
        if self.acceleration is None:
            return
        for field in ("nu", "dt"):
            if not ca.is_equal(getattr(self.acceleration, field), getattr(self.thrust, field), 2):
                raise InputError(
                    f"has another {field} than limit {self.thrust.name}",
                    key=f"limit {self.acceleration.name}",
                    remedy=f"build both from one {field}",
                )

    def reachable(self) -> ca.SX:
        """Return the velocity (n,) that the widened boxes contain: the point p of the class docstring."""
        # For a diagonal mass matrix the axes are independent, T is a box, and p is the point of T nearest to q.
        # Intervals that intersect in pairs have a common point. The point of an interval I nearest to x lies in every
        # interval that contains x and intersects I. Hence B' = B if A, B and T intersect. Otherwise B' is the smallest
        # box that intersects A ∩ T (and A' the smallest box that intersects T, if A does not).
        target = self.box.nearest(ca.SX(self.thrust.nu))
        if self.acceleration is not None:
            target = self.acceleration.box().nearest(target)
        return self.thrust.toward(target)

    def rows(self) -> tuple[LimitRow, ...]:
        """Return the limit rows of the widened velocity box, the widened acceleration box, and the thrust limits."""
        point = self.reachable()
        rows = self.box.holding(point).rows()
        if self.acceleration is not None:
            rows += self.acceleration.box().holding(point).rows()
        return rows + self.thrust.rows()
