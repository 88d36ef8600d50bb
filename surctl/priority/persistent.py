"""Solvers that keep their memory from tick to tick: DAQP and OSQP through their own interfaces.

Both are kernels: `solve_least_distance(..., backend=KeptDaqp())`. The number of rows changes from tick to tick,
since elimination drops some, and neither solver can change its size: one is kept for each size that occurs. A tick
whose answer does not hold is never built upon: its solver is dropped, and set up anew when that size comes again.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, TypeAlias

import daqp
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.priority.backends import FEASIBLE, holds
from surctl.priority.kernels import (
    DAQP_INFEASIBLE,
    DAQP_TOLERANCE,
    NO_BOUND,
    KernelSolution,
    daqp_solution,
    new_osqp,
    osqp_solution,
    unfit,
)

__all__ = ["PersistentDaqp", "PersistentOsqp"]

Array: TypeAlias = NDArray[np.float64]

_MOST = 64  # sizes kept; the one used first goes first
_RHO = 0.1  # OSQP's default step size, from which it adapts


class _Persistent(ABC):
    """One solver a size; what they share."""

    def __init__(self, *, warm: bool = False) -> None:
        self.warm = warm
        self._solvers: dict[tuple[int, int], Any] = {}

    def __call__(self, G: Array, lower: Array, upper: Array, /) -> KernelSolution:
        """The point nearest to 0 with lower (m,) ≤ G (m, d) y ≤ upper (m,), rows of length 1, ±inf allowed.

        "infeasible" also where bounds cross, "failed" for a NaN; never an exception for either.

        Raises:
            InputError: shapes that disagree (DAQP would leave the old bounds in place).
        """
        m, d = G.shape
        if not lower.shape == upper.shape == (m,):
            raise InputError(f"have shapes {lower.shape} and {upper.shape}, G has {m} rows", key="lower, upper")
        low, high = np.maximum(lower, -NO_BOUND), np.minimum(upper, NO_BOUND)
        solution = unfit(G, low, high)
        if solution is not None:  # the solver has not seen it
            return solution
        # taken out, and put back only when its answer holds, whatever it says: a warm one starts from that point
        solver = self._solvers.pop((m, d), None)
        solver, solution = self._first(G, low, high) if solver is None else self._again(solver, G, low, high)
        if solution.status == "optimal" and holds(solution, G, low, high, FEASIBLE):
            if len(self._solvers) >= _MOST:
                del self._solvers[next(iter(self._solvers))]
            self._solvers[m, d] = solver
        return solution

    @abstractmethod
    def _first(self, G: Array, lower: Array, upper: Array) -> tuple[Any, KernelSolution]:
        """Set a solver up, and solve."""

    @abstractmethod
    def _again(self, solver: Any, G: Array, lower: Array, upper: Array) -> tuple[Any, KernelSolution]:
        """Give a solver of this size new numbers, and solve."""


class PersistentDaqp(_Persistent):
    """DAQP's `Model` (Arnström, Bemporad and Axehill 2022), set up once a size.

    Not to be shared between threads.

    Args:
        warm: start from the last active set of that size. Off, the answer depends on the problem alone, to the bit.
    """

    def _first(self, G: Array, lower: Array, upper: Array) -> tuple[Any, KernelSolution]:
        m, d = G.shape
        model = daqp.Model()
        model.settings = {"primal_tol": DAQP_TOLERANCE}
        rows = np.ascontiguousarray(G)
        flag, _ = model.setup(np.eye(d), np.zeros(d), rows, upper, lower, np.zeros(m, dtype=np.intc))
        # without a model its `solve` raises
        return model, _refused(m, flag) if flag < 0 else daqp_solution(m, *model.solve())

    def _again(self, solver: Any, G: Array, lower: Array, upper: Array) -> tuple[Any, KernelSolution]:
        m = len(G)
        # it keeps the active set unless it is told otherwise
        sense = None if self.warm else np.zeros(m, dtype=np.intc)
        flag = solver.update(A=G, bupper=upper, blower=lower, sense=sense)
        # refused, its `solve` would give the last tick's answer and call it optimal
        return solver, _refused(m, flag) if flag < 0 else daqp_solution(m, *solver.solve())


class PersistentOsqp(_Persistent):
    """OSQP (Stellato et al. 2020), set up once a size, then `update(l, u, Ax)`; settings as in `osqp_kernel`.

    Like a fresh OSQP it may stop short of 1e-8 on degenerate rows, and then says "unfinished"; `solve_least_distance`
    polishes and checks.

    Not to be shared between threads.

    Args:
        warm: start from the last point, multipliers and step size of that size. Off, the answer depends on the
            problem alone, to the bit.
    """

    def _first(self, G: Array, lower: Array, upper: Array) -> tuple[Any, KernelSolution]:
        solver = new_osqp(G, lower, upper, warm=self.warm)
        return solver, osqp_solution(solver)

    def _again(self, solver: Any, G: Array, lower: Array, upper: Array) -> tuple[Any, KernelSolution]:
        solver.update(l=lower, u=upper, Ax=G.T.ravel())
        if not self.warm:
            solver.update_settings(rho=_RHO)  # it has adapted to the last problem
        return solver, osqp_solution(solver)


def _refused(m: int, flag: int) -> KernelSolution:
    return KernelSolution(None, np.zeros(m), 0, "infeasible" if flag == DAQP_INFEASIBLE else "failed")
