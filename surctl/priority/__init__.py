"""Who wins: the paper's null-space-based law (16), and the same law kept inside limits by a QP."""

from __future__ import annotations

from typing import get_args

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.priority.backends import BACKENDS, LeastDistance, check_backend, solve_least_distance
from surctl.priority.ladder import safe_tick
from surctl.priority.nsb import nsb, nsb_sweep
from surctl.priority.polyhedron import polyhedron_of
from surctl.priority.problem import Level, PriorityProblem, Row, build_problem
from surctl.priority.projected import solve_projected
from surctl.priority.safe_point import SafePoint, least_distance
from surctl.priority.solution import Mode, PrioritySolution, residuals_at
from surctl.priority.symbolic import nsb_symbolic

__all__ = [
    "BACKENDS",
    "LeastDistance",
    "Level",
    "Mode",
    "PriorityProblem",
    "PrioritySolution",
    "Row",
    "SafePoint",
    "build_problem",
    "least_distance",
    "nsb",
    "nsb_sweep",
    "nsb_symbolic",
    "safe_tick",
    "solve",
    "solve_least_distance",
]


def solve(problem: PriorityProblem, *, mode: Mode = "projected", backend: str = "daqp") -> PrioritySolution:
    """Solve one tick. It always answers: v is finite, whatever the problem holds.

    Args:
        problem: from `build_problem`.
        mode: "projected" keeps every row; "nsb" is the printed law (16), which knows no rows (those that it
            misses are listed in `relaxed`).
        backend: a name in `BACKENDS`: "daqp", "osqp", "own", or another solver that qpsolvers finds; plays no
            part in "nsb".

    Raises:
        InputError: unknown mode or backend.
    """
    if mode not in get_args(Mode):
        raise InputError("no such priority mode", key="mode", value=mode, remedy=nearest(mode, get_args(Mode)))
    check_backend(backend)
    with np.errstate(all="ignore"):  # an overflow is dealt with below, not warned about
        try:
            found = solve_projected(problem, backend=backend) if mode == "projected" else _solve_nsb(problem)
        except (np.linalg.LinAlgError, ArithmeticError):
            return _at_rest(problem, mode)
        return found if np.isfinite(found.v).all() else _at_rest(problem, mode)


def _solve_nsb(problem: PriorityProblem) -> PrioritySolution:
    return _without_rows(problem, nsb(problem), mode="nsb")


def _at_rest(problem: PriorityProblem, mode: Mode) -> PrioritySolution:
    """The numbers ran away: no velocity, or as little as the box allows."""
    v = np.nan_to_num(polyhedron_of(problem).clamp(np.zeros(problem.width)))
    return _without_rows(problem, v, mode=mode, clamped=True)


def _without_rows(
    problem: PriorityProblem, v: NDArray[np.float64], *, mode: Mode, clamped: bool = False
) -> PrioritySolution:
    """A solution that no row has shaped."""
    residuals = residuals_at(v, problem.levels)
    return PrioritySolution(
        v=v,
        mode=mode,
        residuals=residuals,
        without_limits=residuals,
        binding=(),
        relaxed=polyhedron_of(problem).missed(v),
        fallback=3 if clamped else 1,
        iterations=0,
        status="clamped" if clamped else "optimal",
    )
