"""Limits on the commanded velocity itself: the box and the half-plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca

from surctl.tasks.rows import AXES, Kind, Limit, LimitRow, checked_column, checked_kind, checked_name, checked_order
from surctl.tasks.task import Expression

__all__ = ["HalfPlane", "Kind", "Limit", "LimitRow", "VelocityBox"]


@dataclass(frozen=True, eq=False)
class VelocityBox:
    """lower ≤ v ≤ upper, entry by entry; (4,) numbers or SX each, body frame [m/s, m/s, m/s, rad/s].

    Raises:
        InputError: not 4 entries, NaN, or numbers with lower > upper; it names the axis.
    """

    lower: Expression
    upper: Expression
    name: str = "velocity"
    kind: Kind = "actuator"

    def __post_init__(self) -> None:
        """Check name, shapes, kind and order."""
        checked_kind(checked_name(self.name), self.kind)
        for field in ("lower", "upper"):
            object.__setattr__(self, field, checked_column(self.name, field, getattr(self, field), 4))
        for i, axis in enumerate(AXES):
            checked_order(f"{self.name}.{axis}", ca.SX(self.lower)[i], ca.SX(self.upper)[i])

    def rows(self) -> tuple[LimitRow, ...]:
        """Four rows, named NAME.u, NAME.v, NAME.w, NAME.r."""
        eye = ca.SX.eye(4)
        return tuple(
            LimitRow(
                f"{self.name}.{axis}", self.kind, ca.densify(eye[i, :]), ca.SX(self.lower)[i], ca.SX(self.upper)[i]
            )
            for i, axis in enumerate(AXES)
        )

    def holding(self, point: ca.SX) -> VelocityBox:
        """The smallest box around this one that holds `point` (4,) too; the same box where it does already."""
        return VelocityBox(ca.fmin(ca.SX(self.lower), point), ca.fmax(ca.SX(self.upper), point), self.name, self.kind)

    def nearest(self, point: ca.SX) -> ca.SX:
        """The point (4,) of the box nearest to `point` (4,)."""
        return ca.fmin(ca.fmax(point, ca.SX(self.lower)), ca.SX(self.upper))


@dataclass(frozen=True, eq=False)
class HalfPlane:
    """normal · v ≤ bound, (4,) and a scalar, numbers or SX, body frame.

    A barrier ḣ + α(h) ≥ 0 is −∇h·v ≤ α(h).

    Raises:
        InputError: wrong shapes or NaN; it names the limit.
    """

    name: str
    normal: Expression
    bound: Expression
    kind: Kind = "barrier"

    def __post_init__(self) -> None:
        """Check name, shapes and kind."""
        checked_kind(checked_name(self.name), self.kind)
        object.__setattr__(self, "normal", checked_column(self.name, "normal", self.normal, 4))
        object.__setattr__(self, "bound", checked_column(self.name, "bound", self.bound, 1))
        checked_order(self.name, ca.SX(-math.inf), ca.SX(self.bound))

    def rows(self) -> tuple[LimitRow, ...]:
        """One row, without a lower bound."""
        return (LimitRow(self.name, self.kind, ca.SX(self.normal).T, ca.SX(-math.inf), ca.SX(self.bound)),)
