"""QP solvers DAQP and OSQP that are set up once and store their state between control periods.

Both can be passed as a backend: `solve_least_distance(..., backend=PersistentDaqp())`. The number of inequalities
varies between control periods, because the elimination of equalities removes some of them. Neither solver can change
its problem size, so one solver object is stored for each size. If a solution is not optimal, its solver object is
discarded, and a new one is set up when a problem of this size occurs again.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, TypeAlias

import daqp
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.priority.backends import (
    DAQP_INFEASIBLE,
    DAQP_TOLERANCE,
    FEASIBLE,
    NO_BOUND,
    KernelSolution,
    daqp_solution,
    holds,
    new_osqp,
    osqp_solution,
    unfit,
)

__all__ = ["PersistentDaqp", "PersistentOsqp"]

Array: TypeAlias = NDArray[np.float64]

_MOST = 64  # largest number of stored problem sizes; the oldest is dropped first
_RHO = 0.1  # OSQP's default step size, from which it adapts


class _Persistent(ABC):
    """Base class of the persistent solvers, which stores one solver object for each problem size."""

    def __init__(self, *, warm: bool = False) -> None:
        self.warm = warm
        self._solvers: dict[tuple[int, int], Any] = {}

    def __call__(self, G: Array, lower: Array, upper: Array, /) -> KernelSolution:
        """Return the y (d,) nearest to 0 with lower ≤ G y ≤ upper, G (m, d) with rows of length 1, bounds (m,) or ±inf.

        If lower > upper in some row, the status is "infeasible"; if a number is NaN, the status is "failed". Neither
        case raises an exception.

        Raises:
            InputError: the shapes of G and the bounds disagree (DAQP would then use the old bounds).
        """
        m, d = G.shape
        if not lower.shape == upper.shape == (m,):
            raise InputError(f"have shapes {lower.shape} and {upper.shape}, but G has {m} rows", key="lower, upper")
        low, high = np.maximum(lower, -NO_BOUND), np.minimum(upper, NO_BOUND)
        solution = unfit(G, low, high)
        if solution is not None:  # the solver was not called
            return solution
        # the solver is stored again only after its solution passes the check, since a warm start begins at that point
        solver = self._solvers.pop((m, d), None)
        solver, solution = self._first(G, low, high) if solver is None else self._again(solver, G, low, high)
        if solution.status == "optimal" and holds(solution, G, low, high, FEASIBLE):
            if len(self._solvers) >= _MOST:
                del self._solvers[next(iter(self._solvers))]
            self._solvers[m, d] = solver
        return solution

    @abstractmethod
    def _first(self, G: Array, lower: Array, upper: Array) -> tuple[Any, KernelSolution]:
        """Set up a solver object for this problem size, and solve the problem."""

    @abstractmethod
    def _again(self, solver: Any, G: Array, lower: Array, upper: Array) -> tuple[Any, KernelSolution]:
        """Write the problem into a solver object that was set up for this size, and solve the problem."""


class PersistentDaqp(_Persistent):
    """The QP solver DAQP (Arnström, Bemporad and Axehill 2022), set up once for each problem size.

    Do not share an object between threads.

    Args:
        warm: start from the active set of the last problem of the same size. If False, the solution depends on the
            problem alone, to the last bit.
    """

    def _first(self, G: Array, lower: Array, upper: Array) -> tuple[Any, KernelSolution]:
        m, d = G.shape
        model = daqp.Model()
        model.settings = {"primal_tol": DAQP_TOLERANCE}
        rows = np.ascontiguousarray(G)
        flag, _ = model.setup(np.eye(d), np.zeros(d), rows, upper, lower, np.zeros(m, dtype=np.intc))
        # `solve` raises without a model
        return model, _refused(m, flag) if flag < 0 else daqp_solution(m, *model.solve())

    def _again(self, solver: Any, G: Array, lower: Array, upper: Array) -> tuple[Any, KernelSolution]:
        m = len(G)
        # DAQP keeps the active set unless `sense` resets it
        sense = None if self.warm else np.zeros(m, dtype=np.intc)
        flag = solver.update(A=G, bupper=upper, blower=lower, sense=sense)
        # after a refused update, `solve` would return the last solution and call it optimal
        return solver, _refused(m, flag) if flag < 0 else daqp_solution(m, *solver.solve())


class PersistentOsqp(_Persistent):
    """The QP solver OSQP (Stellato et al. 2020), set up once for each problem size, then updated with new data.

    The settings are those of `osqp_kernel`.

    If constraint rows are degenerate, OSQP may stop before it reaches a tolerance of 1e-8; the status is then
    "unfinished". `solve_least_distance` then improves the point by a direct solution and checks that it is optimal.

    Do not share an object between threads.

    Args:
        warm: start from the point, multipliers and step size of the last problem of the same size. If False, the
            solution depends on the problem alone, to the last bit.
    """

    def _first(self, G: Array, lower: Array, upper: Array) -> tuple[Any, KernelSolution]:
        solver = new_osqp(G, lower, upper, warm=self.warm)
        return solver, osqp_solution(solver)

    def _again(self, solver: Any, G: Array, lower: Array, upper: Array) -> tuple[Any, KernelSolution]:
        solver.update(l=lower, u=upper, Ax=G.T.ravel())
        if not self.warm:
            solver.update_settings(rho=_RHO)  # the step size has adapted to the last problem
        return solver, osqp_solution(solver)


def _refused(m: int, flag: int) -> KernelSolution:
    return KernelSolution(None, np.zeros(m), 0, "infeasible" if flag == DAQP_INFEASIBLE else "failed")
