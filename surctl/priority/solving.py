"""The function `solve`: solve a priority problem in the mode nsb, filter, projected or lexicographic."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.backends import Backend, check_backend
from surctl.priority.cascade import (
    CascadeSolution,
    Freedom,
    damped_point,
    least_violation,
    nsb_sweep,
    solve_cascade,
    without_rows,
)
from surctl.priority.optimality import LOSS, is_least
from surctl.priority.polyhedron import Polyhedron, polyhedron_of
from surctl.priority.problem import Level, PriorityProblem
from surctl.priority.rowspace import CUTOFF
from surctl.priority.settings import Mode, Settings
from surctl.priority.solution import Outcome, PrioritySolution, residuals_at

__all__ = ["solve"]

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Solution:
    """Result of `_descend`: the velocity that a priority mode returns, and how it was found.

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


def _descend(
    find: Callable[..., CascadeSolution | None], target: Array, rows: Polyhedron, *, free: Array, backend: Backend
) -> _Solution:
    """Return the solution of the first fallback stage that succeeds; v is always finite and inside the velocity bounds.

    Args:
        find: function that takes the constraint rows and a velocity (n,) that satisfies them (or None), and returns the
            solution of the priority mode, or None if no velocity satisfies the rows.
        target: (n,), the velocity to which the solution must be as near as possible. free: (n,), the velocity without
            limits.
    """
    result = find(rows, inside=None)
    if result is not None:
        return _solution_at(result, target, rows, free, "optimal" if result.confirmed else "unconfirmed", 0, ())
    relaxed = least_violation(rows, target, backend=backend)
    if relaxed is None:
        return _last_resort(free, target, rows, backend)
    result = find(relaxed.rows, inside=relaxed.inside)
    if result is None:  # possible only after a solver failure, since a feasible point is known
        return _last_resort(free, target, rows, backend)
    status: Outcome = "relaxed" if relaxed.opened else "optimal"
    if not (result.confirmed and relaxed.least):
        status = "unconfirmed"
    return _solution_at(result, target, rows, free, status, relaxed.iterations, relaxed.conflict)


def _solution_at(
    result: CascadeSolution,
    target: Array,
    rows: Polyhedron,
    free: Array,
    status: Outcome,
    spent: int,
    conflict: tuple[str, ...],
) -> _Solution:
    v = rows.clamp(result.v)
    return _Solution(v, target, free, status, result.binding, result.causes, spent + result.iterations, conflict)


def _last_resort(free: Array, target: Array, rows: Polyhedron, backend: Backend) -> _Solution:
    """Return the velocity with the least violation of the actuator limits, if these conflict or all solvers fail."""
    hard = rows.mask("actuator")
    solution = Freedom.whole(free.size).nearest(free, rows.only(hard), backend=backend)
    options = [rows.clamp(option) for option in (solution.x, free, np.zeros(free.size)) if option is not None]
    finite = [option for option in options if np.isfinite(option).all()] or [rows.clamp(np.zeros(free.size))]
    v = min(finite, key=lambda option: float(rows.violation(option)[hard].max(initial=0.0)))
    return _Solution(v, target, free, "clamped", iterations=solution.iterations)


def solve(
    problem: PriorityProblem,
    *,
    mode: Mode = "projected",
    sweeps: int = 1,
    damping: float = 0.0,
    cutoff: float = CUTOFF,
    backend: Backend = "daqp",
) -> PrioritySolution:
    """Solve the priority problem of one control period; the returned velocity v is finite for any problem.

    (1) If possible, v meets the first task and satisfies all limits. (2) If no velocity does both, v satisfies all
    limits and meets the first task as well as they allow. (3) If the limits contradict each other, they are first
    relaxed by the smallest uniform amount: limits of set-based tasks, and barrier limits only if the relaxation of the
    former is not enough. Actuator limits are never relaxed (but see `build_problem` for limits that cross). If the
    result is not shown to be optimal afterwards, the status is "unconfirmed". If no limit is active, v is the velocity
    of the mode without limits.

    Args:
        problem: priority levels and limits, from `build_problem`.
        mode: the priority law. "nsb": the NSB law, equation (16) of the paper, without limits (`relaxed` then lists the
            violated limits). "projected": equation (16) with the projection on the first task restricted to the limits.
            "filter": the velocity that satisfies the limits and is nearest to the result of (16). "lexicographic":
            strict priority within the limits.
        sweeps, damping, cutoff: see `Settings`.
        backend: the QP solver. A name in `BACKENDS`: "daqp", "osqp", "own", or another solver that the package
            qpsolvers finds; or a `Kernel`, for example `PersistentDaqp()`, which stores its state between control
            periods. Mode "nsb" uses no QP solver.

    Raises:
        InputError: the mode or the backend is unknown, or a setting is out of range.

    Example:
        >>> import numpy as np
        >>> from surctl.priority import Level, Row, build_problem, solve
        >>> goal, wall = Level("goal", np.eye(2), np.array([0.3, 0.4]), unit="m/s"), np.array([1.0, 0.0])
        >>> found = solve(build_problem([goal], [Row("wall", "barrier", wall, -np.inf, 0.1)]))
        >>> found.v.round(3).tolist(), found.explain()
        ([0.1, 0.4], 'Task `goal` gave up 0.2 m/s because `wall` binds.')
    """
    settings = Settings(mode, sweeps, damping, cutoff)
    check_backend(backend)
    rows = polyhedron_of(problem)
    with np.errstate(all="ignore"):  # overflow is handled below, so no warning is needed
        try:
            solution = _MODES[settings.mode](problem.levels, rows, settings, backend)
            if np.isfinite(solution.v).all() and np.isfinite(solution.free).all():
                return _solution(problem, settings, rows, solution)
        except (np.linalg.LinAlgError, ArithmeticError):
            pass
        # overflow: v is 0 moved into the box
        v = np.nan_to_num(rows.clamp(np.zeros(problem.width)))
        return _solution(problem, settings, rows, _Solution(v, v, v, "clamped"))


def _nsb(levels: Sequence[Level], rows: Polyhedron, settings: Settings, backend: Backend) -> _Solution:
    free = without_rows(levels, width=rows.width, settings=settings)
    return _Solution(free, free, free, "optimal")


def _filter(levels: Sequence[Level], rows: Polyhedron, settings: Settings, backend: Backend) -> _Solution:
    target = without_rows(levels, width=rows.width, settings=settings)
    if rows.contains(target):
        return _Solution(target, target, target, "optimal")
    find = partial(solve_cascade, (), target, backend=backend, cutoff=settings.cutoff)
    return _descend(find, target, rows, free=target, backend=backend)


def _projected(levels: Sequence[Level], rows: Polyhedron, settings: Settings, backend: Backend) -> _Solution:
    v = without = np.zeros(rows.width)
    bound = False
    for _ in range(settings.sweeps):
        target = nsb_sweep(levels[1:], start=v, settings=settings)
        free = nsb_sweep(levels[:1], start=target, settings=settings)
        # as long as no row has bound, the sweeps with rows and those without are the same
        without = nsb_sweep(levels, start=without, settings=settings) if bound else free
        if rows.contains(free):
            solution = _Solution(free, target, without, "optimal")
        else:
            find: Callable[..., CascadeSolution | None] = partial(
                solve_cascade, levels[:1], target, backend=backend, cutoff=settings.cutoff
            )
            if settings.damping > 0.0:
                find = partial(_damped, levels[0], target, damping=settings.damping, backend=backend)
            solution, bound = _descend(find, target, rows, free=without, backend=backend), True
        v = solution.v
    return solution


def _lexicographic(levels: Sequence[Level], rows: Polyhedron, settings: Settings, backend: Backend) -> _Solution:
    target = np.zeros(rows.width)
    free = without_rows(levels, width=rows.width, settings=settings)
    if rows.contains(free):
        return _Solution(free, target, free, "optimal")
    find = partial(solve_cascade, levels, target, backend=backend, cutoff=settings.cutoff)
    return _descend(find, target, rows, free=free, backend=backend)


_MODES: Mapping[Mode, Callable[[Sequence[Level], Polyhedron, Settings, Backend], _Solution]] = {
    "nsb": _nsb,
    "filter": _filter,
    "projected": _projected,
    "lexicographic": _lexicographic,
}


def _damped(
    level: Level, target: Array, rows: Polyhedron, *, damping: float, backend: Backend, inside: Array | None = None
) -> CascadeSolution | None:
    spent = 0
    if inside is None:
        start = Freedom.whole(target.size).nearest(target, rows, backend=backend)
        inside, spent = start.x, start.iterations
    if inside is None:
        return None
    solution = damped_point(level, target, rows, damping=damping, inside=inside)
    return CascadeSolution.of(
        solution.v, rows, solution.multipliers, spent + solution.iterations, confirmed=solution.converged
    )


def _solution(problem: PriorityProblem, settings: Settings, rows: Polyhedron, solution: _Solution) -> PrioritySolution:
    limited = solution.status == "optimal" and problem.levels[0].name in solution.causes
    status: Outcome = "limited" if limited else solution.status
    if solution.iterations > 0 and status in ("optimal", "limited", "relaxed"):
        shown = is_least(solution.v, problem, settings=settings, target=solution.target, tol=LOSS)
        status = status if shown else "unconfirmed"
    if problem.moved and settings.mode != "nsb" and status in ("optimal", "limited"):
        status = "relaxed"
    fallback: Literal[1, 2, 3] = 1 if status == "optimal" else 2 if status == "limited" else 3
    return PrioritySolution(
        v=solution.v,
        settings=settings,
        target=solution.target,
        residuals=residuals_at(solution.v, problem.levels),
        without_limits=residuals_at(solution.free, problem.levels),
        binding=solution.binding,
        causes=solution.causes,
        relaxed={**problem.moved, **rows.missed(solution.v)},
        conflict=tuple(dict.fromkeys((*problem.moved, *solution.conflict))),
        fallback=fallback,
        iterations=solution.iterations,
        status=status,
        units={level.name: level.unit for level in problem.levels},
    )
