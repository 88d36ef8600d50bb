"""The priority problem of one control period, in numbers: checks, limits that cross are moved."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, check_known
from surctl.priority.settings import ZERO_ROW
from surctl.tasks.task import Kind

Array: TypeAlias = NDArray[np.float64]

CROSSING = 1e-9
"""Bounds that cross by at most this, relative to 1 + |bound|, cross by rounding: they are moved, but not reported."""


@dataclass(frozen=True, eq=False)
class Level:
    """One priority level, that is, one task at one instant: lower ≤ J v ≤ upper for the velocity v.

    `Level(name, J, x)` requires J v = x. A set-based task has lower < upper in some rows; an absent bound is ±inf. A
    row with lower < upper has no effect while its entry of J v is between the bounds.

    Attributes:
        J: (k, n), Jacobian of the task.
        lower, upper: (k,) bounds of J v, the rate of the task's quantity σ [unit of σ per second]; upper = None means
            upper = lower.
        unit: unit of J v for messages, for example "m/s".
    """

    name: str
    J: Array
    lower: Array
    upper: Array | None = None
    unit: str = ""

    @property
    def x(self) -> Array:
        """Return the desired value (k,) of a level without set-based rows; otherwise the lower bounds of the level."""
        return self.lower

    @property
    def high(self) -> Array:
        """Return the upper bounds (k,) of J v; they equal the lower bounds if `upper` is None."""
        return self.lower if self.upper is None else self.upper

    @property
    def exact(self) -> NDArray[np.bool_]:
        """Return a mask (k,) of the rows of J with one desired value (lower = upper)."""
        rows: NDArray[np.bool_] = self.lower == self.high
        return rows

    @property
    def is_goal(self) -> bool:
        """Return whether every row of J has one desired value (lower = upper)."""
        return self.upper is None or bool(self.exact.all())

    def miss(self, v: Array) -> Array:
        """Return the change (k,) that takes each entry of J v, v (n,), to its nearest bound; 0 between its bounds."""
        value = self.J @ v
        lacks: Array = np.clip(value, self.lower, self.high) - value
        return lacks

    def residual(self, v: Array) -> float:
        """Return the distance between J v and the allowed values; ‖J v − x‖ for a task with one desired value x."""
        return float(np.sqrt((self.miss(v) ** 2).sum()))


@dataclass(frozen=True, eq=False)
class Row:
    """One limit on the velocity v at one instant: lower ≤ a·v ≤ upper with a (n,); an absent bound is ±inf."""

    name: str
    kind: Kind
    a: Array
    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits lower ≤ a·v ≤ upper, scaled to ‖a‖ = 1 so that a violation is a velocity, with names.

    A row with normal 0 is not scaled; all velocities satisfy this row, or none does.

    Attributes:
        A: (m, n), one normal a in each row. lower, upper: (m,), bounds. length: (m,), ‖a‖ before scaling.
        soft: (m,), whether the limit may be relaxed. names: name of each limit (m,).
    """

    A: Array
    lower: Array
    upper: Array
    length: Array
    soft: NDArray[np.bool_]
    names: tuple[str, ...]

    @staticmethod
    def none(n: int) -> Limits:
        """Return the set of all velocities (n,), which has no limit."""
        nothing = np.zeros(0)
        return Limits(np.zeros((0, n)), nothing, nothing, nothing, np.zeros(0, dtype=bool), ())

    def violation(self, v: Array) -> Array:
        """Return the amount (m,) by which v (n,) violates each limit; 0 if v satisfies the limit."""
        value = self.A @ v
        return np.maximum(np.maximum(self.lower - value, value - self.upper), 0.0)

    def missed(self, v: Array) -> dict[str, float]:
        """Return the violation of each limit that v violates by more than rounding, by name, in the limit's unit."""
        amount = self.violation(v)
        tolerance = 1e-8 * (1.0 + float(np.abs(v).max()))
        return {self.names[i]: float(amount[i] * self.length[i]) for i in np.flatnonzero(amount > tolerance)}

    def contains(self, v: Array) -> bool:
        """Return whether v satisfies every limit exactly, without tolerance; False if v contains a NaN."""
        value = self.A @ v
        return bool(((self.lower <= value) & (value <= self.upper)).all())

    def relaxed(self, by: float) -> Limits:
        """Return the set with both bounds of the soft limits moved outwards by `by`."""
        move = np.where(self.soft, by, 0.0)
        return replace(self, lower=self.lower - move, upper=self.upper + move)

    def holding(self, v: Array) -> Limits:
        """Return the set with bounds widened by rounding errors so that v, which must be feasible, satisfies them."""
        value = self.A @ v
        return replace(self, lower=np.minimum(self.lower, value), upper=np.maximum(self.upper, value))

    def also(self, J: Array, lower: Array, upper: Array) -> Limits:
        """Return the set with k additional soft limits lower ≤ J v ≤ upper, J (k, n)."""
        more = _scaled(np.column_stack([J, lower, upper, np.ones(len(J))]), ("",) * len(J))
        names = ("A", "lower", "upper", "length", "soft")
        A, low, up, length, soft = (np.concatenate([getattr(self, name), getattr(more, name)]) for name in names)
        return Limits(A, low, up, length, soft, self.names + more.names)


def _scaled(table: Array, names: tuple[str, ...]) -> Limits:
    A = table[:, :-3]
    largest = np.abs(A).max(axis=1, initial=0.0)
    zero = largest <= ZERO_ROW
    largest[zero] = 1.0
    scaled = A / largest[:, None]  # without this scaling the square of a row of 1e155 would overflow
    length = np.where(zero, 1.0, largest * np.sqrt(np.einsum("ij,ij->i", scaled, scaled)))
    A = np.where(zero[:, None], 0.0, A / length[:, None])
    return Limits(A, table[:, -3] / length, table[:, -2] / length, length, table[:, -1] != 0.0, names)


@dataclass(frozen=True, eq=False)
class PriorityProblem:
    """A priority problem from `build_problem`: levels, highest priority first, and limits as linear constraints.

    Attributes:
        moved: by how much a velocity within the limits must violate a limit whose bounds were moved, because they cross
            those of a harder one, by name and in the limit's unit. `rows` holds the moved bounds.
    """

    levels: tuple[Level, ...]
    rows: tuple[Row, ...] = ()
    moved: Mapping[str, float] = field(default_factory=dict)

    @property
    def width(self) -> int:
        """Return the number of velocities n (4 for this vehicle)."""
        return int(self.levels[0].J.shape[1])

    @cached_property
    def table(self) -> Array:
        """Return the limits as a table (m, n + 3): normal, lower, upper, and 1 if the limit may be relaxed, else 0."""
        m, n = len(self.rows), self.width
        table = np.empty((m, n + 3))
        if m:
            table[:, :n] = np.concatenate([row.a for row in self.rows]).reshape(m, n)
            table[:, n] = [row.lower for row in self.rows]
            table[:, n + 1] = [row.upper for row in self.rows]
            table[:, n + 2] = [row.kind != "actuator" for row in self.rows]
        return table

    @cached_property
    def limits(self) -> Limits:
        """Return the limits as rows of length 1."""
        return _scaled(self.table, tuple(row.name for row in self.rows))

    @cached_property
    def box(self) -> Array:
        """Return the bounds (2, n) of each velocity from the actuator limits on a single velocity; ±inf for none."""
        return _agreed(self.rows, self.width)[2]

    def __str__(self) -> str:
        """Return the problem as a table with one line for each row of each Jacobian and one line for each limit."""
        lines = [f"{'priority':<9} {'name':<20} row · v"]
        for place, level in enumerate(self.levels, start=1):
            lines += [
                f"{place:<9} {level.name:<20} {_text(row)} {_range_text(low, high)}"
                for row, low, high in zip(level.J, level.lower, level.high, strict=True)
            ]
        lines += [
            f"{row.kind:<9} {row.name:<20} {_text(row.a)} in [{row.lower:.6g}, {row.upper:.6g}]" for row in self.rows
        ]
        return "\n".join(lines)


def build_problem(
    levels: Sequence[Level], rows: Sequence[Row] = (), *, moved: Mapping[str, float] | None = None
) -> PriorityProblem:
    """Check levels and limits, and return them as a read-only priority problem.

    If actuator limits that bound a single velocity exclude each other, the earlier limit is harder: the later one is
    moved to the point of the earlier ones that is nearest to it, and listed in `moved`, after those already moved.

    Raises:
        InputError: there is no level, Jacobians and normals have different numbers of columns, a number is not finite,
            lower > upper, a kind of limit is unknown, or a name is empty, has several lines or is used twice. The
            message names the task (and the row of its Jacobian) or the limit.

    Example:
        >>> import numpy as np
        >>> from surctl.priority import Level, Row, build_problem
        >>> ahead, slow = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.15])
        >>> print(build_problem([Level("cruise", ahead[None], slow)], [Row("wall", "barrier", ahead, -np.inf, 0.1)]))
        priority  name                 row · v
        1         cruise               [ 1  0  0  0] -> 0.15
        barrier   wall                 [ 1  0  0  0] in [-inf, 0.1]
    """
    if not levels:
        raise InputError("has no level", key="problem", remedy="give at least one task")
    _check_names("task", [level.name for level in levels])
    _check_names("limit", [row.name for row in rows])
    shared = {level.name for level in levels} & {row.name for row in rows}
    if shared:  # a set-based task can bind like a limit: with equal names, the solution would be ambiguous
        raise InputError("is also the name of a limit", key=f"task {min(shared)}", remedy="rename one of them")
    checked = tuple(_checked_level(level) for level in levels)
    width = checked[0].J.shape[1]
    for level in checked:
        if level.J.shape[1] != width:
            text = f"J has {level.J.shape[1]} columns, but task {checked[0].name} has {width}"
            raise InputError(text, key=f"task {level.name}", remedy="use the same velocities in all Jacobians")
    agreed, more, box = _agreed([_checked_row(row, width) for row in rows], width)
    problem = PriorityProblem(checked, agreed, {**(moved or {}), **more})
    problem.__dict__["box"] = box  # known here
    return problem


def _agreed(rows: Sequence[Row], width: int) -> tuple[tuple[Row, ...], dict[str, float], Array]:
    """Return the rows with the bounds of an actuator row on one velocity moved to those before it, and the box."""
    low, high = np.full(width, -math.inf), np.full(width, math.inf)
    agreed, moved = [], {}
    for row in rows:
        places = np.flatnonzero(row.a)
        if row.kind == "actuator" and places.size == 1 and abs(row.a[places[0]]) > ZERO_ROW:
            j, a = int(places[0]), float(row.a[places[0]])
            ends = sorted((row.lower / a, row.upper / a))
            apart = ends[0] > high[j] or ends[1] < low[j]
            low[j], high[j] = np.clip(ends, low[j], high[j])
            if apart:
                point = float(low[j] * a)
                by = max(row.lower - point, point - row.upper)
                if by > CROSSING * (1.0 + abs(point)):
                    moved[row.name] = by
                row = replace(row, lower=point, upper=point)
        agreed.append(row)
    return tuple(agreed), moved, np.array([low, high])


def _checked_level(level: Level) -> Level:
    key = f"task {level.name}"
    J, lower, upper = (_numbers(value, key) for value in (level.J, level.lower, level.high))
    lower, upper = lower.reshape(-1), upper.reshape(-1)
    if J.ndim != 2 or J.shape[0] != lower.size or J.size == 0 or lower.size != upper.size:
        entries = f"{lower.size}" if lower.size == upper.size else f"{lower.size} and {upper.size}"
        remedy = "give J of shape (k, n) and k values"
        raise InputError(f"J has shape {J.shape}, but its values have {entries} entries", key=key, remedy=remedy)
    finite = np.isfinite(J).all(axis=1) & ~np.isnan(lower) & ~np.isnan(upper)
    finite &= np.isfinite(lower) | (lower < upper)
    crossed = ~(lower <= upper) | (lower == math.inf) | (upper == -math.inf)
    for wrong, problem, remedy in (
        (~finite, "is not finite", "check the inputs for NaN first"),
        (crossed, "has bounds that exclude every value", "give lower <= upper"),
    ):
        if wrong.any():
            bad = int(np.flatnonzero(wrong)[0])
            ends = [lower[bad]] if level.upper is None else [lower[bad], upper[bad]]
            raise InputError(f"row {bad} {problem}", key=key, value=np.append(J[bad], ends).tolist(), remedy=remedy)
    return Level(level.name, J, lower, None if np.array_equal(lower, upper) else upper, level.unit)


def _checked_row(row: Row, width: int) -> Row:
    key = f"limit {row.name}"
    a, lower, upper = _numbers(row.a, key).reshape(-1), _number(row.lower, key), _number(row.upper, key)
    check_known(row.kind, get_args(Kind), "unknown kind", key=key)
    if a.size != width:
        raise InputError(f"has {a.size} entries, expected {width}", key=key, remedy="give one entry for each velocity")
    if not np.isfinite(a).all() or math.isnan(lower) or math.isnan(upper):
        raise InputError("is not finite", key=key, value=[*a.tolist(), lower, upper], remedy="check the inputs for NaN")
    if lower > upper or lower == math.inf or upper == -math.inf:
        raise InputError("bounds exclude every velocity", key=key, value=[lower, upper], remedy="give lower <= upper")
    return Row(row.name, row.kind, a, lower, upper)


def _check_names(what: str, names: Sequence[str]) -> None:
    for i, name in enumerate(names):
        if not isinstance(name, str) or not name or not name.isprintable():
            raise InputError(
                "is not a name", key=f"name of {what} {i + 1}", value=name, remedy="give a non-empty text of one line"
            )
        if name in names[:i]:
            text = f"is the name of {what} {names.index(name) + 1} and of {what} {i + 1}"
            raise InputError(text, key=f"{what} {name}", remedy="rename one of them")


def _numbers(value: Any, key: str) -> Array:
    try:
        if not np.iscomplexobj(value):
            return np.array(value, dtype=float)
    except (TypeError, ValueError):
        pass
    raise InputError("is not an array of numbers", key=key, value=value, remedy="give real numbers in equal rows")


def _number(value: Any, key: str) -> float:
    number = _numbers(value, key)
    if number.size != 1:
        raise InputError("is not one number", key=key, value=value, remedy="give one lower and one upper bound")
    return float(number.reshape(()))


def _range_text(lower: float, upper: float) -> str:
    return f"-> {lower:.6g}" if lower == upper else f"in [{lower:.6g}, {upper:.6g}]"


def _text(row: Array) -> str:
    return "[" + " ".join(f"{entry: .4g}" for entry in row) + "]"
