"""Down the ladder: inside the rows; inside rows that were opened by the least; in the box at any rate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.backends import Backend
from surctl.priority.cascade import CascadeSolution
from surctl.priority.freedom import Freedom
from surctl.priority.polyhedron import Polyhedron
from surctl.priority.relaxation import least_violation
from surctl.priority.solution import Outcome

__all__ = ["Solution", "descend"]

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Solution:
    """What a mode answers.

    Attributes:
        v: (n,). target: (n,), the point that the last projection started from. free: (n,), the answer without rows.
        status: how it came about; "optimal" here also where rows hold levels back; "unconfirmed" where a solver's
            failure left a point that keeps the rows.
        binding, blame, iterations: as `Reached`.
        conflict: names of the rows that contradict each other.
    """

    v: Array
    target: Array
    free: Array
    status: Outcome
    binding: tuple[tuple[str, float], ...] = ()
    causes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    iterations: int = 0
    conflict: tuple[str, ...] = ()


def descend(
    find: Callable[..., CascadeSolution | None], target: Array, rows: Polyhedron, *, free: Array, backend: Backend
) -> Solution:
    """The first rung that holds; always a finite v inside the box.

    Args:
        find: (rows, inside) → the mode's answer inside the rows, None if no v keeps them; `inside` (n,) is a point
            known to keep them, or None.
        target: (n,), what `find` starts from; free: (n,), the answer without rows.
    """
    result = find(rows, inside=None)
    if result is not None:
        return _solution(result, target, rows, free, "optimal" if result.confirmed else "unconfirmed", 0, ())
    relaxed = least_violation(rows, target, backend=backend)
    if relaxed is None:
        return _last_resort(free, target, rows, backend)
    result = find(relaxed.rows, inside=relaxed.inside)
    if result is None:  # cannot be but by a solver's failure: a point inside is known
        return _last_resort(free, target, rows, backend)
    status: Outcome = "relaxed" if relaxed.opened else "optimal"
    if not (result.confirmed and relaxed.least):
        status = "unconfirmed"
    return _solution(result, target, rows, free, status, relaxed.iterations, relaxed.conflict)


def _solution(
    result: CascadeSolution,
    target: Array,
    rows: Polyhedron,
    free: Array,
    status: Outcome,
    spent: int,
    conflict: tuple[str, ...],
) -> Solution:
    v = rows.clamp(result.v)
    return Solution(v, target, free, status, result.binding, result.causes, spent + result.iterations, conflict)


def _last_resort(free: Array, target: Array, rows: Polyhedron, backend: Backend) -> Solution:
    """The actuator rows contradict each other, or every solver gave up: what misses those rows least."""
    hard = rows.mask("actuator")
    solution = Freedom.whole(free.size).nearest(free, rows.only(hard), backend=backend)
    options = [rows.clamp(option) for option in (solution.x, free, np.zeros(free.size)) if option is not None]
    finite = [option for option in options if np.isfinite(option).all()] or [rows.clamp(np.zeros(free.size))]
    v = min(finite, key=lambda option: float(rows.violation(option)[hard].max(initial=0.0)))
    return Solution(v, target, free, "clamped", iterations=solution.iterations)
