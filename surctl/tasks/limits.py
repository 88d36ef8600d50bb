"""Limits on the commanded velocity: `VelocityBox` and `HalfPlane`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca

from surctl.tasks.rows import (
    Kind,
    Limit,
    LimitRow,
    axis_names,
    checked_column,
    checked_kind,
    checked_name,
    checked_order,
    width,
)
from surctl.tasks.task import Expression

__all__ = ["HalfPlane", "Kind", "Limit", "LimitRow", "VelocityBox"]


@dataclass(frozen=True, eq=False)
class VelocityBox:
    """The limit lower ≤ v ≤ upper on each of the n velocities.

    The bounds (n,) are numbers or SX expressions. For n = 4, they are the bounds of the velocities u, v, w [m/s] and r
    [rad/s] in the body frame.

    Raises:
        InputError: the bounds have different numbers of entries, a number is NaN, or lower > upper on an axis. The
            message names the axis.
    """

    lower: Expression
    upper: Expression
    name: str = "velocity"
    kind: Kind = "actuator"

    def __post_init__(self) -> None:
        """Check the limit's name and kind, the shapes of the bounds, and lower ≤ upper."""
        checked_kind(checked_name(self.name), self.kind)
        n = width(self.name, "lower", self.lower)
        for field in ("lower", "upper"):
            object.__setattr__(self, field, checked_column(self.name, field, getattr(self, field), n))
        for i, axis in enumerate(axis_names(n)):
            checked_order(f"{self.name}.{axis}", ca.SX(self.lower)[i], ca.SX(self.upper)[i])

    def rows(self) -> tuple[LimitRow, ...]:
        """Return one limit row per velocity: NAME.u, NAME.v, NAME.w, NAME.r for n = 4, otherwise NAME.0, NAME.1, …"""
        n = int(ca.SX(self.lower).numel())
        eye = ca.SX.eye(n)
        return tuple(
            LimitRow(
                f"{self.name}.{axis}", self.kind, ca.densify(eye[i, :]), ca.SX(self.lower)[i], ca.SX(self.upper)[i]
            )
            for i, axis in enumerate(axis_names(n))
        )

    def holding(self, point: ca.SX) -> VelocityBox:
        """Return the smallest velocity box that contains this box and the velocity `point` (n,)."""
        return VelocityBox(ca.fmin(ca.SX(self.lower), point), ca.fmax(ca.SX(self.upper), point), self.name, self.kind)

    def nearest(self, point: ca.SX) -> ca.SX:
        """Return the velocity (n,) in the box that is nearest to the velocity `point` (n,)."""
        return ca.fmin(ca.fmax(point, ca.SX(self.lower)), ca.SX(self.upper))


@dataclass(frozen=True, eq=False)
class HalfPlane:
    """The limit normal · v ≤ bound on the velocity v; normal (n,) and bound are numbers or SX.

    For example, a control barrier ḣ + α(h) ≥ 0 with ḣ = ∇h·v is the half-plane −∇h·v ≤ α(h).

    Raises:
        InputError: a shape is wrong or a number is NaN; the message names the limit.
    """

    name: str
    normal: Expression
    bound: Expression
    kind: Kind = "barrier"

    def __post_init__(self) -> None:
        """Check the limit's name and kind, and the shapes of normal and bound."""
        checked_kind(checked_name(self.name), self.kind)
        n = width(self.name, "normal", self.normal)
        object.__setattr__(self, "normal", checked_column(self.name, "normal", self.normal, n))
        object.__setattr__(self, "bound", checked_column(self.name, "bound", self.bound, 1))
        checked_order(self.name, ca.SX(-math.inf), ca.SX(self.bound))

    def rows(self) -> tuple[LimitRow, ...]:
        """Return the limit as one constraint row without a lower bound."""
        return (LimitRow(self.name, self.kind, ca.SX(self.normal).T, ca.SX(-math.inf), ca.SX(self.bound)),)
