"""The mode `projected`: the paper's sweep with its last projection kept inside the limits.

w_2 is the sweep of levels 2 … k. Then (1) the point nearest to w_2 that meets task 1 and every row; if there
is none, (2) the point nearest to w_2 among those that meet task 1 as well as the rows allow; if the rows
themselves contradict each other, (3) the same after rows of set-based tasks and, if those are not enough,
barrier rows were relaxed by the least uniform amount. Actuator rows never give way. Without rows that bind
this is (16) exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.backends import LeastDistance, solve_least_distance
from surctl.priority.nsb import nsb_sweep
from surctl.priority.polyhedron import Polyhedron, polyhedron_of
from surctl.priority.problem import Level, PriorityProblem
from surctl.priority.reach import least_violation, nearest_attainable
from surctl.priority.rowspace import project, row_space
from surctl.priority.solution import Outcome, PrioritySolution, residuals_at

__all__ = ["solve_projected"]

Array: TypeAlias = NDArray[np.float64]

_MET = 1e-9  # task 1 counts as met when it misses what its Jacobian can reach by no more than this


@dataclass(frozen=True, eq=False)
class _Point:
    """A rung's answer: v, multipliers of the rows (unit length), solver iterations, and how it came about."""

    v: Array
    multipliers: Array
    iterations: int
    status: Outcome


def solve_projected(problem: PriorityProblem, *, backend: str) -> PrioritySolution:
    """Solve one tick; always a finite v for a problem that `build_problem` passed. See the module's head."""
    first = problem.levels[0]
    rows = polyhedron_of(problem)
    w_2 = nsb_sweep(problem.levels[1:], width=problem.width)
    w_1 = project(w_2, first.J, x=first.x)
    if rows.contains(w_1):  # nothing binds: the projection is known in closed form
        point = _Point(w_1, np.zeros(len(rows.names)), 0, "optimal")
    else:
        point = _descend(first, w_2, rows, backend)
    clamped = rows.clamp(point.v)
    return _solution(problem, rows, replace(point, v=clamped), without=w_1)


def _descend(task: Level, w_2: Array, rows: Polyhedron, backend: str) -> _Point:
    """Down the ladder, one rung after another."""
    # the best value that J_1 can reach at all: the same task, and an equality that can hold
    task = replace(task, x=task.J @ row_space(task.J).particular(task.x))
    found = _meet_first(task, w_2, rows, backend) or _serve_first(task, w_2, rows, backend)
    if found is not None:
        return found
    spent = 0
    relaxed = least_violation(rows, w_2, backend=backend)
    if relaxed is not None:
        allowed, inside, spent = relaxed.rows, relaxed.inside, relaxed.iterations
        found = _meet_first(task, w_2, allowed, backend) or _serve_first(task, w_2, allowed, backend, inside=inside)
        if found is not None:
            status: Outcome = "relaxed" if relaxed.opened else found.status
            return replace(found, iterations=found.iterations + spent, status=status)
    return _last_resort(task, w_2, rows, spent, backend)


def _meet_first(task: Level, w_2: Array, rows: Polyhedron, backend: str) -> _Point | None:
    """Rung 1: task 1 as an equality (its best possible value, if J_1 cannot reach x_1)."""
    answer = _nearest(w_2, rows, task.J, task.x, backend)
    if answer.x is None:
        return None
    return _Point(answer.x, answer.multipliers, answer.iterations, "optimal")


def _serve_first(
    task: Level, w_2: Array, rows: Polyhedron, backend: str, *, inside: Array | None = None
) -> _Point | None:
    """Rung 2: task 1 as well as the rows allow, then nearest to w_2 among those; None if no v keeps the rows.

    `inside` is a point known to keep them, if there is one.
    """
    best = nearest_attainable(task, w_2, rows, backend=backend, inside=inside)
    if best is None:
        return None
    answer = _nearest(w_2, rows, task.J, task.J @ best.v, backend)
    iterations = best.iterations + answer.iterations
    met = np.abs(task.J @ best.v - task.x).max() <= _MET * max(1.0, float(np.abs(task.J).max()))
    status: Outcome = "optimal" if met else "limited"
    if answer.x is None:  # the set of best points is too thin for the solver, but best.v is in it
        return _Point(best.v, best.multipliers, iterations, status)
    # a row that holds task 1 back may be implied by the equality, and then has no multiplier of its own
    multipliers = np.where(best.multipliers != 0.0, best.multipliers, answer.multipliers)
    return _Point(answer.x, multipliers, iterations, status)


def _nearest(target: Array, rows: Polyhedron, J: Array, value: Array, backend: str) -> LeastDistance:
    return solve_least_distance(
        target, A=rows.A, lower=rows.lower, upper=rows.upper, A_eq=J, b_eq=value, backend=backend
    )


def _last_resort(task: Level, w_2: Array, rows: Polyhedron, spent: int, backend: str) -> _Point:
    """Every solver gave up, or the actuator rows contradict each other: what misses those rows least."""
    hard = rows.mask("actuator")
    wanted = project(w_2, task.J, x=task.x)
    answer = solve_least_distance(
        wanted, A=rows.A[hard], lower=rows.lower[hard], upper=rows.upper[hard], backend=backend
    )
    options = [rows.clamp(option) for option in (answer.x, wanted, np.zeros(w_2.size)) if option is not None]
    finite = [option for option in options if np.isfinite(option).all()] or [rows.clamp(np.zeros(w_2.size))]
    v = min(finite, key=lambda option: float(rows.violation(option)[hard].max(initial=0.0)))
    return _Point(v, np.zeros(len(rows.names)), spent + answer.iterations, "clamped")


def _solution(problem: PriorityProblem, rows: Polyhedron, point: _Point, *, without: Array) -> PrioritySolution:
    bite = np.abs(point.multipliers) > 1e-9 * (1.0 + float(np.abs(point.v).max()))
    fallback: Literal[1, 2, 3] = 1 if point.status == "optimal" else 2 if point.status == "limited" else 3
    return PrioritySolution(
        v=point.v,
        mode="projected",
        residuals=residuals_at(point.v, problem.levels),
        without_limits=residuals_at(without, problem.levels),
        binding=tuple((rows.names[i], float(point.multipliers[i] / rows.length[i])) for i in np.flatnonzero(bite)),
        relaxed=rows.missed(point.v),
        fallback=fallback,
        iterations=point.iterations,
        status=point.status,
    )
