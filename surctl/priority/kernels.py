"""The solvers themselves, each behind the same three lines: min ½‖y‖² subject to lower ≤ G y ≤ upper."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeAlias

import daqp
import numpy as np
import osqp
import qpsolvers
from numpy.typing import NDArray
from scipy import sparse

from surctl.priority.dual_step import OPTIMAL, STUCK
from surctl.priority.safe_point import nearest_to_zero

__all__ = ["Answer", "Kernel", "daqp_kernel", "osqp_kernel", "own_kernel", "qpsolvers_kernels"]

Array: TypeAlias = NDArray[np.float64]

_NO_BOUND = 1e30
_DAQP_INFEASIBLE = -1


@dataclass(frozen=True)
class Answer:
    """y (d,) or None, multipliers (m,) with y + Gᵀ·multipliers = 0, iterations, and what the solver says."""

    y: Array | None
    multipliers: Array
    iterations: int
    status: Literal["optimal", "infeasible", "failed"]


Kernel: TypeAlias = Callable[[Array, Array, Array], Answer]


def daqp_kernel(G: Array, lower: Array, upper: Array) -> Answer:
    """DAQP (Arnström, Bemporad and Axehill 2022), a dual active-set method; its flag is checked."""
    m, d = G.shape
    y, _, flag, info = daqp.solve(
        np.eye(d),
        np.zeros(d),
        np.ascontiguousarray(G),
        np.minimum(upper, _NO_BOUND),
        np.maximum(lower, -_NO_BOUND),
        np.zeros(m, dtype=np.intc),
        primal_tol=1e-11,
    )
    iterations = int(info["iterations"])
    if flag == 1:
        return Answer(np.array(y, dtype=float), np.array(info["lam"], dtype=float), iterations, "optimal")
    return Answer(None, np.zeros(m), iterations, "infeasible" if flag == _DAQP_INFEASIBLE else "failed")


def osqp_kernel(G: Array, lower: Array, upper: Array) -> Answer:
    """OSQP (Stellato et al. 2020), an operator-splitting method, with tight settings.

    Its default tolerances leave bounds violated by 1e-3 and call feasible problems infeasible.
    """
    m, d = G.shape
    solver = osqp.OSQP()
    solver.setup(
        sparse.eye(d, format="csc"),
        np.zeros(d),
        sparse.csc_matrix(G),
        np.maximum(lower, -_NO_BOUND),
        np.minimum(upper, _NO_BOUND),
        eps_abs=1e-10,
        eps_rel=1e-10,
        eps_prim_inf=1e-10,
        max_iter=20_000,
        polishing=False,  # it prints to the terminal; the caller polishes
        verbose=False,
    )
    result = solver.solve(raise_error=False)
    iterations, status = int(result.info.iter), int(result.info.status_val)
    if status in (
        osqp.SolverStatus.OSQP_SOLVED,
        osqp.SolverStatus.OSQP_SOLVED_INACCURATE,
        osqp.SolverStatus.OSQP_MAX_ITER_REACHED,
    ):
        # inaccurate ones too: the caller polishes and checks
        return Answer(np.array(result.x, dtype=float), np.array(result.y, dtype=float), iterations, "optimal")
    infeasible = status == osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE
    return Answer(None, np.zeros(m), iterations, "infeasible" if infeasible else "failed")


def own_kernel(G: Array, lower: Array, upper: Array) -> Answer:
    """This package's own dual active-set method (`dual_step`), compiled where there is a C compiler."""
    y, multipliers, status, iterations = nearest_to_zero(G, lower, upper)
    if status == OPTIMAL:
        return Answer(y, multipliers, iterations, "optimal")
    return Answer(None, np.zeros(lower.size), iterations, "infeasible" if status == STUCK else "failed")


def qpsolvers_kernels() -> dict[str, Kernel]:
    """One kernel for every other solver that qpsolvers (Caron et al.) finds installed, for cross-checks."""
    others = sorted(set(qpsolvers.available_solvers) - {"daqp", "osqp"})
    return {name: partial(_qpsolvers_kernel, solver=name) for name in others}


def _qpsolvers_kernel(G: Array, lower: Array, upper: Array, *, solver: str) -> Answer:
    m, d = G.shape
    below, above = np.flatnonzero(lower > -_NO_BOUND), np.flatnonzero(upper < _NO_BOUND)
    # qpsolvers knows one-sided rows only, and an infinite bound spoils its own check
    rows, bounds = np.vstack([G[above], -G[below]]), np.concatenate([upper[above], -lower[below]])
    form = sparse.csc_matrix if solver in qpsolvers.sparse_solvers else np.asarray
    problem = qpsolvers.Problem(form(np.eye(d)), np.zeros(d), G=form(rows), h=bounds)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "terminated with status ..." is what the answer says already
        solution = qpsolvers.solve_problem(problem, solver=solver)
    if not solution.found or solution.x is None or solution.z is None:
        # a solver that finds nothing seldom says why: not taken as a proof of infeasibility
        return Answer(None, np.zeros(m), 0, "failed")
    multipliers = np.zeros(m)
    multipliers[above] += solution.z[: len(above)]
    multipliers[below] -= solution.z[len(above) :]
    return Answer(np.asarray(solution.x, dtype=float), multipliers, 0, "optimal")
