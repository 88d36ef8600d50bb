"""Fallback stages of `solve`: satisfy all limits, else relax barrier and set limits, else only velocity bounds."""

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
    """Result of `descend`: the velocity that a priority mode returns, and how it was found.

    Attributes:
        v: (n,), velocity. target: (n,), the velocity to which v must be as near as tasks and limits allow. free: (n,),
            the velocity without limits.
        status: the outcome. "optimal" includes the case that limits prevent a level from being met; "unconfirmed" means
            that v satisfies the limits but no solver confirmed that v is optimal.
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
    """Return the solution of the first fallback stage that succeeds; v is always finite and inside the velocity bounds.

    Args:
        find: function that takes the constraint rows and a velocity (n,) that satisfies them (or None), and returns the
            solution of the priority mode, or None if no velocity satisfies the rows.
        target: (n,), the velocity to which the solution must be as near as possible. free: (n,), the velocity without
            limits.
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
    """Return the velocity with the least violation of the actuator limits, if these conflict or all solvers fail."""
    hard = rows.mask("actuator")
    solution = Freedom.whole(free.size).nearest(free, rows.only(hard), backend=backend)
    options = [rows.clamp(option) for option in (solution.x, free, np.zeros(free.size)) if option is not None]
    finite = [option for option in options if np.isfinite(option).all()] or [rows.clamp(np.zeros(free.size))]
    v = min(finite, key=lambda option: float(rows.violation(option)[hard].max(initial=0.0)))
    return Solution(v, target, free, "clamped", iterations=solution.iterations)
