"""Actuator limits made consistent: velocity and acceleration boxes widened to a velocity that the thrust can reach."""

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
    """Velocity box B, acceleration box A and thrust limits T; B and A are widened so that a feasible velocity exists.

    If a vehicle is far outside B, or if drag and Coriolis forces exceed the thrust, it cannot satisfy B or A, and the
    limits would contradict each other. The thrust is a physical limit, so T does not change, and B and A are widened to
    contain a point p of T:

        q = the point of A nearest to (the point of B nearest to ν),   p = the point of T toward q,
        B' = hull(B, p),   A' = hull(A, p).

    Proof that B' ∩ A' ∩ T is never empty: p ∈ T, because the thrust for p is the thrust for q, clipped to the thrust
    bounds. By definition, p is in both hulls. If q ∈ B ∩ T, then p = q, and the boxes do not change. So the boxes do
    not change while ν is in B and the thrust can hold ν. For a diagonal M the axes are independent, T is a box, and p
    is the point of T nearest to q. Intervals that intersect in pairs have a common point. The point of an interval I
    nearest to x lies in every interval that contains x and intersects I. Hence B' = B if A, B and T intersect.
    Otherwise B' is the smallest box that intersects A ∩ T (and A' the smallest box that intersects T, if A does not).
    For any other M, p is a point of T, but another point of T may widen the boxes less.

    Attributes:
        box: the velocity box B.
        thrust: the thrust limits T, with lower ≤ upper.
        acceleration: the acceleration box A, with the ν of T; None for no acceleration limit.

    Raises:
        InputError: ν or dt of `acceleration` differs from that of `thrust`, or two of the limits have the same name.
    """

    box: VelocityBox
    thrust: ThrustLimit
    acceleration: AccelerationLimit | None = None

    def __post_init__(self) -> None:
        """Check that the limits have equal ν and dt, and different names."""
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
        """Return p (4,) [m/s, rad/s], the velocity reached with the clipped thrust for the point q."""
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
