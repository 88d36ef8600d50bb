"""The priority problem of one tick as data: named levels, named rows; printable and saveable."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.tasks.limits import Kind

__all__ = ["Level", "PriorityProblem", "Row", "build_problem"]


@dataclass(frozen=True, eq=False)
class Level:
    """One task at one instant: J v should be x; J (k, n), x (k,) [unit of σ per second]."""

    name: str
    J: NDArray[np.float64]
    x: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Row:
    """One limit at one instant: lower ≤ a·v ≤ upper; a (n,); ±inf where there is none."""

    name: str
    kind: Kind
    a: NDArray[np.float64]
    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class PriorityProblem:
    """Levels, highest priority first, and rows; make it with `build_problem`, which checks it."""

    levels: tuple[Level, ...]
    rows: tuple[Row, ...] = ()

    @property
    def width(self) -> int:
        """n, the number of velocities (4 for this vehicle)."""
        return int(self.levels[0].J.shape[1])

    def __str__(self) -> str:
        """A table: one line a task row, one a limit."""
        lines = [f"{'priority':<9} {'name':<20} row · v"]
        for place, level in enumerate(self.levels, start=1):
            lines += [
                f"{place:<9} {level.name:<20} {_text(row)} -> {x:.6g}" for row, x in zip(level.J, level.x, strict=True)
            ]
        lines += [
            f"{row.kind:<9} {row.name:<20} {_text(row.a)} in [{row.lower:.6g}, {row.upper:.6g}]" for row in self.rows
        ]
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON; an absent bound is null. Numbers survive the round trip exactly."""
        return {
            "levels": [{"name": lv.name, "J": lv.J.tolist(), "x": lv.x.tolist()} for lv in self.levels],
            "rows": [
                {
                    "name": r.name,
                    "kind": r.kind,
                    "a": r.a.tolist(),
                    "lower": _bound(r.lower),
                    "upper": _bound(r.upper),
                }
                for r in self.rows
            ],
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> PriorityProblem:
        """The problem that `to_dict` gave; checked like any other. InputError for a missing key."""
        try:
            levels = [Level(lv["name"], _array(lv["J"]), _array(lv["x"])) for lv in data["levels"]]
            rows = [
                Row(
                    r["name"],
                    r["kind"],
                    _array(r["a"]),
                    _unbound(r["lower"], -math.inf),
                    _unbound(r["upper"], math.inf),
                )
                for r in data["rows"]
            ]
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"is not a saved problem ({type(error).__name__}: {error})",
                key="problem",
                remedy="save it with to_dict",
            ) from None
        return build_problem(levels, rows)


def build_problem(levels: Sequence[Level], rows: Sequence[Row] = ()) -> PriorityProblem:
    """Check and freeze a problem.

    Raises:
        InputError: no level, widths that disagree, a number that is not finite, bounds that cross, an unknown
            kind, or a name used twice; it names the task (and the row inside it) or the limit.
    """
    if not levels:
        raise InputError("has no level", key="problem", remedy="give at least one task")
    _check_names("task", [level.name for level in levels])
    _check_names("limit", [row.name for row in rows])
    checked = tuple(_checked_level(level) for level in levels)
    width = checked[0].J.shape[1]
    for level in checked:
        if level.J.shape[1] != width:
            raise InputError(
                f"J has {level.J.shape[1]} columns, but task {checked[0].name} has {width}",
                key=f"task {level.name}",
                remedy="all Jacobians act on the same velocities",
            )
    return PriorityProblem(checked, tuple(_checked_row(row, width) for row in rows))


def _checked_level(level: Level) -> Level:
    J, x = _array(level.J), _array(level.x).reshape(-1)
    if J.ndim != 2 or J.shape[0] != x.size or J.size == 0:
        raise InputError(
            f"J has shape {J.shape}, x has {x.size} entries",
            key=f"task {level.name}",
            remedy="give J of shape (k, n) and x of shape (k,)",
        )
    if not (np.isfinite(J).all() and np.isfinite(x).all()):
        bad = int(np.flatnonzero(~(np.isfinite(J).all(axis=1) & np.isfinite(x)))[0])
        raise InputError(
            f"row {bad} is not finite",
            key=f"task {level.name}",
            value=[*J[bad], x[bad]],
            remedy="gate the inputs first",
        )
    return Level(level.name, J, x)


def _checked_row(row: Row, width: int) -> Row:
    a, lower, upper = _array(row.a).reshape(-1), float(row.lower), float(row.upper)
    key = f"limit {row.name}"
    if row.kind not in get_args(Kind):
        raise InputError("unknown kind", key=key, value=row.kind, remedy=nearest(str(row.kind), get_args(Kind)))
    if a.size != width:
        raise InputError(f"has {a.size} entries, expected {width}", key=key, remedy="one entry a velocity")
    if not np.isfinite(a).all() or math.isnan(lower) or math.isnan(upper):
        raise InputError("is not finite", key=key, value=[*a, lower, upper], remedy="gate the inputs first")
    if lower > upper or lower == math.inf or upper == -math.inf:
        raise InputError("bounds leave no velocity", key=key, value=[lower, upper], remedy="give lower <= upper")
    return Row(row.name, row.kind, a, lower, upper)


def _check_names(what: str, names: Sequence[str]) -> None:
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(
                f"names both {what} {names.index(name) + 1} and {what} {i + 1}",
                key=f"{what} {name}",
                remedy="rename one of them",
            )


def _array(value: Any) -> NDArray[np.float64]:
    return np.array(value, dtype=float)


def _bound(value: float) -> float | None:
    return None if math.isinf(value) else value


def _unbound(value: float | None, absent: float) -> float:
    return absent if value is None else float(value)


def _text(row: NDArray[np.float64]) -> str:
    return "[" + " ".join(f"{entry: .4g}" for entry in row) + "]"
