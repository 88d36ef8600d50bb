"""What the actuators allow, made consistent: the box gives way to what the thrust can reach."""

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
    """Velocity box B, acceleration box A and thrust rows T that always leave a velocity.

    Far outside its box, or where drag and Coriolis ask for more than the thrust has, a vehicle cannot keep B or A:
    the rows would contradict each other. Thrust is what is real, so T stays as it is, and B and A are widened to
    hold one point p of T:

        q = the point of A nearest to (the point of B nearest to ν),   p = the point of T toward q,
        B' = hull(B, p),   A' = hull(A, p).

    Proof that B' ∩ A' ∩ T is never empty: p ∈ T, as the thrust needed for p is that for q brought into bounds, and
    p is in both hulls.
    Nothing changes where q ∈ B ∩ T, as then p = q; so nothing changes while ν is in B and the thrust can hold it.
    For a diagonal M each axis stands alone, T is a box, and p is its point nearest to q. Intervals that meet in
    pairs have a point in common, and the nearest point of one interval to a point of another lies in every interval
    that meets both between the two. Hence B' = B when the three meet, and otherwise B' is the smallest box that
    meets A ∩ T (A' the smallest that meets T, if A does not). For any other M, p is a point of T, not always the
    one that widens least.

    Attributes:
        box: B.
        thrust: T; lower ≤ upper.
        acceleration: A, about the same ν as T; None for none.

    Raises:
        InputError: `acceleration` is written over another ν or dt than `thrust`, or two of the limits have one name.
    """

    box: VelocityBox
    thrust: ThrustLimit
    acceleration: AccelerationLimit | None = None

    def __post_init__(self) -> None:
        """Check that the limits belong together."""
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
        """p (4,) [m/s, rad/s]: the velocity that the thrust reaches on its way back into the box."""
        target = self.box.nearest(ca.SX(self.thrust.nu))
        if self.acceleration is not None:
            target = self.acceleration.box().nearest(target)
        return self.thrust.toward(target)

    def rows(self) -> tuple[LimitRow, ...]:
        """Rows of the widened box, of the widened acceleration limit, and of the thrust."""
        point = self.reachable()
        rows = self.box.holding(point).rows()
        if self.acceleration is not None:
            rows += self.acceleration.box().holding(point).rows()
        return rows + self.thrust.rows()
