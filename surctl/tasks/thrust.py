"""Limit on the velocities that the thrusters can reach within one step."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
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

__all__ = ["ThrustLimit"]

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
