"""Limit rows, which are named linear constraints lower ≤ a·v ≤ upper and the common form of all velocity limits."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias, get_args

import casadi as ca

from surctl.errors import InputError, nearest
from surctl.tasks.task import Expression, as_column, sized_column

__all__ = [
    "AXES",
    "Kind",
    "Limit",
    "LimitRow",
    "axis_names",
    "checked_column",
    "checked_kind",
    "checked_name",
    "checked_order",
    "checked_positive",
    "width",
]

Kind: TypeAlias = Literal["actuator", "barrier", "set"]
"""The kind of a limit decides whether it may be violated.

Actuator limits are always satisfied. Barrier limits are violated only if they contradict actuator limits, and then as
little as possible. Limits of set-based tasks are violated before barrier limits.
"""

AXES = ("u", "v", "w", "r")
"""Names of the velocities of a vehicle that moves in surge, sway, heave and yaw."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z_0-9]+)*")


@dataclass(frozen=True, eq=False)
class LimitRow:
    """One linear constraint lower ≤ a·v ≤ upper on the velocity v.

    For a vehicle, v is (u, v, w, r) in the body frame {B} [m/s, rad/s].

    Attributes:
        name: name such as "velocity.u", which appears in the text that explains a solution.
        kind: kind of limit; see `Kind`.
        a: SX (1, n), the coefficients of the velocities.
        lower, upper: SX scalars; −inf or inf if there is no bound.
    """

    name: str
    kind: Kind
    a: ca.SX
    lower: ca.SX
    upper: ca.SX


class Limit(Protocol):
    """Protocol of a velocity limit: an object whose method `rows` returns linear constraints."""

    def rows(self) -> tuple[LimitRow, ...]:
        """Return the linear constraints of this limit, always in the same order."""
        ...


def checked_name(name: object) -> str:
    """Return the name unchanged; raise InputError if it does not consist of identifiers joined by dots."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise InputError(
            "is not a limit name", key="limit.name", value=name, remedy="use letters, digits and _, joined by dots"
        )
    return name


def checked_kind(name: str, kind: str) -> None:
    """Raise InputError if the kind of a limit is unknown; the message suggests a known kind with a similar name."""
    if kind not in get_args(Kind):
        remedy = nearest(str(kind), get_args(Kind))
        raise InputError("unknown kind of limit", key=f"limit {name}", value=kind, remedy=remedy)


def checked_column(name: str, field: str, value: Expression, size: int, *, finite: bool = False) -> ca.SX:
    """Return a field of a limit as an SX column of length `size`; raise InputError for a wrong shape or a NaN.

    If `finite` is true, an infinite number raises InputError too. The message names the limit and the field.
    """
    key = f"limit {name}: {field}"
    column = sized_column(value, (size,), key=key)
    numbers = [float(column[i]) for i in range(size) if column[i].is_constant()]
    if any(math.isnan(number) or (finite and math.isinf(number)) for number in numbers):
        remedy = "give finite numbers" if finite else "give numbers, or inf for none"
        raise InputError("is not a number", key=key, value=value, remedy=remedy)
    return column


def axis_names(n: int, names: tuple[str, ...] = AXES) -> tuple[str, ...]:
    """Return the names of n axes: the given names if there are n of them, otherwise 0, 1, …"""
    return names if n == len(names) else tuple(map(str, range(n)))


def width(name: str, field: str, value: Expression) -> int:
    """Return the number of entries of a field, n ≥ 1; raise InputError if it is not a vector."""
    try:
        n = as_column(value).numel()
    except ValueError:
        n = 0
    if n < 1:
        raise InputError("is not a vector", key=f"limit {name}: {field}", value=value, remedy="give n numbers")
    return int(n)


def checked_positive(name: str, field: str, value: Expression, size: int = 1, *, zero: bool = False) -> ca.SX:
    """Return a field of a limit as an SX column of length `size`; raise InputError if a number is infinite, NaN or ≤ 0.

    If `zero` is true, the number 0 is allowed too.
    """
    column = checked_column(name, field, value, size, finite=True)
    for i in range(size):
        if column[i].is_constant() and (float(column[i]) < 0.0 or (float(column[i]) == 0.0 and not zero)):
            problem = "must be at least 0" if zero else "must be greater than 0"
            raise InputError(problem, key=f"limit {name}: {field}", value=float(column[i]))
    return column


def checked_order(name: str, lower: ca.SX, upper: ca.SX) -> None:
    """Raise InputError if two numeric bounds have lower > upper; symbolic bounds are checked at run time."""
    if not (lower.is_constant() and upper.is_constant()):
        return
    low, high = float(lower), float(upper)
    if low > high or low == math.inf or high == -math.inf:
        raise InputError(
            "allows no velocity",
            key=f"limit {name}",
            value=[low, high],
            remedy="give lower <= upper, or inf for none",
        )
