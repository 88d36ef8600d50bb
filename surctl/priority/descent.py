"""Fallback stages of `solve`: satisfy all limits; else open soft limits as little as possible; else only the box."""

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
    """Result of `descend`: the solution of a priority mode.

    Attributes:
        v: (n,), velocity. target: (n,), the point from which the last projection starts. free: (n,), the solution
            without limits.
        status: the fallback stage. "optimal" includes the case that limits keep a level from its value; "unconfirmed"
            means that v satisfies the limits but no solver confirmed that v is optimal.
        binding, causes, iterations: see the attributes of `CascadeSolution`.
        conflict: names of the limits that contradict each other.
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
        find: function (rows, inside) → the solution of the mode subject to the constraint rows, or None if no v
            satisfies these rows; `inside` (n,) is a point known to satisfy the rows, or None.
        target: (n,), the point from which `find` starts. free: (n,), the solution without limits.
    """
    result = find(rows, inside=None)
    if result is not None:
        return _solution(result, target, rows, free, "optimal" if result.confirmed else "unconfirmed", 0, ())
    relaxed = least_violation(rows, target, backend=backend)
    if relaxed is None:
        return _last_resort(free, target, rows, backend)
    result = find(relaxed.rows, inside=relaxed.inside)
    if result is None:  # possible only after a solver failure, since a feasible point is known
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
    """Return the candidate with the least violation of actuator limits, if they conflict or all solvers fail."""
    hard = rows.mask("actuator")
    solution = Freedom.whole(free.size).nearest(free, rows.only(hard), backend=backend)
    options = [rows.clamp(option) for option in (solution.x, free, np.zeros(free.size)) if option is not None]
    finite = [option for option in options if np.isfinite(option).all()] or [rows.clamp(np.zeros(free.size))]
    v = min(finite, key=lambda option: float(rows.violation(option)[hard].max(initial=0.0)))
    return Solution(v, target, free, "clamped", iterations=solution.iterations)
