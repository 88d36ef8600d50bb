"""Fallback stages: inside the rows; inside rows that are opened as little as possible; otherwise only in the box."""

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
    """Result of a priority mode.

    Attributes:
        v: (n,). target: (n,), the start of the last projection. free: (n,), the solution without rows.
        status: the fallback stage; "optimal" includes the case that rows limit levels; "unconfirmed" means that v
            satisfies the rows but a solver failed to confirm it.
        binding, causes, iterations: as in `CascadeSolution`.
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
    """Return the solution of the first fallback stage that succeeds; v is always finite and inside the box.

    Args:
        find: (rows, inside) → the mode's solution inside the rows, None if no v satisfies them; `inside` (n,) is a
            known feasible point, or None.
        target: (n,), the start of `find`. free: (n,), the solution without rows.
    """
    result = find(rows, inside=None)
    if result is not None:
        return _solution(result, target, rows, free, "optimal" if result.confirmed else "unconfirmed", 0, ())
    relaxed = least_violation(rows, target, backend=backend)
    if relaxed is None:
        return _last_resort(free, target, rows, backend)
    result = find(relaxed.rows, inside=relaxed.inside)
    if result is None:  # only possible after a solver failure, since a feasible point is known
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
    """Solution if actuator rows contradict each other or all solvers fail: the candidate that violates them least."""
    hard = rows.mask("actuator")
    solution = Freedom.whole(free.size).nearest(free, rows.only(hard), backend=backend)
    options = [rows.clamp(option) for option in (solution.x, free, np.zeros(free.size)) if option is not None]
    finite = [option for option in options if np.isfinite(option).all()] or [rows.clamp(np.zeros(free.size))]
    v = min(finite, key=lambda option: float(rows.violation(option)[hard].max(initial=0.0)))
    return Solution(v, target, free, "clamped", iterations=solution.iterations)
