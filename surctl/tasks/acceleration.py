"""Limit on the difference between the commanded and the present velocity."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import casadi as ca

from surctl.tasks.limits import VelocityBox
from surctl.tasks.rows import Kind, LimitRow, checked_column, checked_kind, checked_name, checked_positive, width
from surctl.tasks.task import Expression

__all__ = ["AccelerationLimit"]


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
