"""Consistent actuator limits: velocity and acceleration bounds widened to a velocity that the thrust can reach."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.tasks.limits import VelocityBox
from surctl.tasks.rows import (
    Kind,
    LimitRow,
    axis_names,
    checked_column,
    checked_kind,
    checked_name,
    checked_order,
    checked_positive,
    width,
)
from surctl.tasks.task import Expression, as_expression

__all__ = ["AccelerationLimit", "ActuatorLimits", "ThrustLimit"]


@dataclass(frozen=True, eq=False)
class AccelerationLimit:
    """The limit |v − ν| ≤ a·dt between commanded velocity v and present velocity ν, on each of n axes.

    Attributes:
        nu: present velocity ν (n,); for n = 4 [m/s, m/s, m/s, rad/s].
        limit: largest acceleration a (n,), at least 0; for n = 4 [m/s², m/s², m/s², rad/s²].
        dt: time in which the vehicle is to reach v, greater than 0 [s].

    Raises:
        InputError: `nu` and `limit` differ in length, a number is negative or not finite, or dt is not greater
            than 0.
    """

    nu: Expression
    limit: Expression
    _: KW_ONLY
    dt: Expression
    name: str = "acceleration"
    kind: Kind = "actuator"

    def __post_init__(self) -> None:
        """Check the limit's name and kind, and the shapes of the values."""
        checked_kind(checked_name(self.name), self.kind)
        n = width(self.name, "nu", self.nu)
        object.__setattr__(self, "nu", checked_column(self.name, "nu", self.nu, n, finite=True))
        object.__setattr__(self, "limit", checked_positive(self.name, "limit", self.limit, n, zero=True))
        object.__setattr__(self, "dt", checked_positive(self.name, "dt", self.dt))

    def box(self) -> VelocityBox:
        """Return the acceleration limit as a box of velocities with bounds (n,)."""
        nu, change = ca.SX(self.nu), ca.SX(self.limit) * ca.SX(self.dt)
        return VelocityBox(nu - change, nu + change, self.name, self.kind)

    def rows(self) -> tuple[LimitRow, ...]:
        """Return one limit row per velocity, named as by `VelocityBox.rows`."""
        return self.box().rows()


_FORCES = ("Fu", "Fv", "Fw", "Fr")


@dataclass(frozen=True, eq=False)
class ThrustLimit:
    """The limit lower ≤ M (v − ν)/dt + load ≤ upper on the thrust that changes the velocity from ν to v within dt.

    The thrust follows from the dynamic model, equation (3) of the paper. The load is evaluated at ν, so a vehicle with
    its thrust at a bound reaches the velocity v with an error of O(dt²). The thrust is the force that acts in the
    water; if this force lags behind its command, give bounds on its average over the time dt.

    Attributes:
        nu: present velocity ν (n,); for a vehicle (n = 4) over ground in the body frame {B} [m/s, rad/s].
        mass: mass matrix M, its diagonal (n,) or symmetric positive definite (n, n) [kg, kg m²].
        load: (n,) thrust that holds ν: Coriolis force C(ν)ν plus drag D(ν)ν minus other forces [N, N m].
        lower, upper: (n,) bounds of the thrust [N, N m].
        dt: time in which the vehicle is to reach v [s].

    Raises:
        InputError: a shape is wrong, a number is not finite, a mass is not positive, lower > upper, or dt is not
            greater than 0. The message names the field or the limit row.
    """

    nu: Expression
    mass: Expression
    _: KW_ONLY
    load: Expression
    lower: Expression
    upper: Expression
    dt: Expression
    name: str = "thrust"
    kind: Kind = "actuator"

    def __post_init__(self) -> None:
        """Check the limit's name and kind, the shapes of the values, and lower ≤ upper."""
        checked_kind(checked_name(self.name), self.kind)
        n = width(self.name, "nu", self.nu)
        for field in ("nu", "load", "lower", "upper"):
            column = checked_column(self.name, field, getattr(self, field), n, finite=field in ("nu", "load"))
            object.__setattr__(self, field, column)
        object.__setattr__(self, "mass", _mass_matrix(self.name, self.mass, n))
        object.__setattr__(self, "dt", checked_positive(self.name, "dt", self.dt))
        for i, force in enumerate(axis_names(n, _FORCES)):
            checked_order(f"{self.name}.{force}", ca.SX(self.lower)[i], ca.SX(self.upper)[i])

    def needed(self, v: ca.SX) -> ca.SX:
        """Return the thrust (n,) [N, N m] that changes the velocity from ν to v (n,) [m/s, rad/s] within dt."""
        return ca.SX(self.mass) @ (v - ca.SX(self.nu)) / ca.SX(self.dt) + ca.SX(self.load)

    def toward(self, target: ca.SX) -> ca.SX:
        """Return the velocity (n,) reached with the thrust for velocity `target` (n,), clipped to the thrust bounds.

        If the needed thrust is within its bounds, this velocity is `target` itself. For a diagonal mass matrix, the
        reachable velocities form a box, and the result is the point of this box nearest to `target`.
        """
        required = self.needed(target)
        missing = ca.fmin(ca.fmax(required, ca.SX(self.lower)), ca.SX(self.upper)) - required
        return target + ca.SX(self.dt) * self._divided(missing)

    def rows(self) -> tuple[LimitRow, ...]:
        """Return one limit row per force [N, N m]: NAME.Fu, NAME.Fv, NAME.Fw, NAME.Fr for n = 4, else NAME.0, …"""
        slope = ca.densify(ca.SX(self.mass) / ca.SX(self.dt))
        offset = ca.SX(self.load) - slope @ ca.SX(self.nu)
        lower, upper = ca.SX(self.lower) - offset, ca.SX(self.upper) - offset
        return tuple(
            LimitRow(f"{self.name}.{force}", self.kind, slope[i, :], lower[i], upper[i])
            for i, force in enumerate(axis_names(lower.numel(), _FORCES))
        )

    def _divided(self, force: ca.SX) -> ca.SX:
        mass = ca.SX(self.mass)
        return force / ca.diag(mass) if mass.sparsity().is_diag() else ca.solve(mass, force)


def _mass_matrix(name: str, mass: Expression, n: int) -> ca.SX:
    # sparse if only the diagonal is given
    try:
        matrix = as_expression(mass)
    except ValueError:
        raise InputError(
            "is not numeric", key=f"limit {name}: mass", value=mass, remedy=f"give {n} numbers, or a ({n}, {n}) matrix"
        ) from None
    if matrix.shape != (n, n) or n == 1:
        return ca.diag(checked_positive(name, "mass", matrix, n))
    if matrix.is_constant() and not _positive_definite(np.array(ca.DM(matrix))):
        raise InputError("is not symmetric positive definite", key=f"limit {name}: mass", value=matrix)
    return matrix


def _positive_definite(matrix: NDArray[np.float64]) -> bool:
    symmetric = np.isfinite(matrix).all() and np.array_equal(matrix, matrix.T)
    return bool(symmetric and np.linalg.eigvalsh(matrix)[0] > 0.0)


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
