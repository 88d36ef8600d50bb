"""Limits on the commanded velocity, as named rows l ≤ a·v ≤ u."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias, get_args

import casadi as ca

from surctl.errors import InputError, nearest
from surctl.tasks.task import Expression, sized_column

__all__ = ["HalfPlane", "Kind", "Limit", "LimitRow", "VelocityBox"]

Kind: TypeAlias = Literal["actuator", "barrier", "set"]
"""What a row stands for. Actuator rows never give way; barrier rows do only when they contradict those, by
the least violation; rows of set-based tasks give way before barriers."""

_AXES = ("u", "v", "w", "r")


@dataclass(frozen=True, eq=False)
class LimitRow:
    """One row lower ≤ a·v ≤ upper, for v = (u, v, w, r) in {B} [m/s, rad/s].

    Attributes:
        name: dotted name, as "velocity.u"; it appears in explanations.
        kind: see `Kind`.
        a: SX (1, 4).
        lower, upper: SX scalars; −inf or inf where there is none.
    """

    name: str
    kind: Kind
    a: ca.SX
    lower: ca.SX
    upper: ca.SX


class Limit(Protocol):
    """Whatever can say its rows."""

    def rows(self) -> tuple[LimitRow, ...]:
        """The rows, in a fixed order."""
        ...


@dataclass(frozen=True, eq=False)
class VelocityBox:
    """lower ≤ v ≤ upper, entry by entry; (4,) numbers or SX each, body frame [m/s, m/s, m/s, rad/s].

    Raises:
        InputError: not 4 entries, NaN, or numbers with lower > upper; it names the axis.
    """

    lower: ca.SX
    upper: ca.SX
    name: str = "velocity"
    kind: Kind = "actuator"

    def __post_init__(self) -> None:
        """Check shapes, kind and order."""
        _check_kind(self.name, self.kind)
        for field in ("lower", "upper"):
            object.__setattr__(self, field, _column(self.name, field, getattr(self, field), 4))
        for i, axis in enumerate(_AXES):
            _check_order(f"{self.name}.{axis}", self.lower[i], self.upper[i])

    def rows(self) -> tuple[LimitRow, ...]:
        """Four rows, named NAME.u, NAME.v, NAME.w, NAME.r."""
        eye = ca.SX.eye(4)
        return tuple(
            LimitRow(f"{self.name}.{axis}", self.kind, ca.densify(eye[i, :]), self.lower[i], self.upper[i])
            for i, axis in enumerate(_AXES)
        )


@dataclass(frozen=True, eq=False)
class HalfPlane:
    """normal · v ≤ bound, (4,) and a scalar, numbers or SX, body frame.

    A barrier ḣ + α(h) ≥ 0 is −∇h·v ≤ α(h).

    Raises:
        InputError: wrong shapes or NaN; it names the limit.
    """

    name: str
    normal: ca.SX
    bound: ca.SX
    kind: Kind = "barrier"

    def __post_init__(self) -> None:
        """Check shapes and kind."""
        _check_kind(self.name, self.kind)
        object.__setattr__(self, "normal", _column(self.name, "normal", self.normal, 4))
        object.__setattr__(self, "bound", _column(self.name, "bound", self.bound, 1))
        _check_order(self.name, ca.SX(-math.inf), self.bound)

    def rows(self) -> tuple[LimitRow, ...]:
        """One row, without a lower bound."""
        return (LimitRow(self.name, self.kind, self.normal.T, ca.SX(-math.inf), self.bound),)


def _check_kind(name: str, kind: str) -> None:
    if kind not in get_args(Kind):
        raise InputError("unknown kind of limit", key=f"limit {name}", value=kind, remedy=nearest(kind, get_args(Kind)))


def _column(name: str, field: str, value: Expression, size: int) -> ca.SX:
    column = sized_column(value, (size,), key=f"limit {name}: {field}")
    if any(column[i].is_constant() and math.isnan(float(column[i])) for i in range(size)):
        raise InputError(
            "is not a number",
            key=f"limit {name}: {field}",
            value=value,
            remedy="give numbers, or inf for none",
        )
    return column


def _check_order(name: str, lower: ca.SX, upper: ca.SX) -> None:
    """Numbers must leave room; expressions are taken on trust here and checked when they have values."""
    if not (lower.is_constant() and upper.is_constant()):
        return
    low, high = float(lower), float(upper)
    if low > high or low == math.inf or high == -math.inf:
        raise InputError(
            "leaves no velocity",
            key=f"limit {name}",
            value=[low, high],
            remedy="give lower <= upper, or inf for none",
        )
