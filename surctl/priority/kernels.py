"""QP solvers behind a common interface: each solver minimises ½‖y‖² over y subject to lower ≤ G y ≤ upper."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, Protocol, TypeAlias

import daqp
import numpy as np
from numpy.typing import NDArray

from surctl.priority.solver.dual_step import OPTIMAL, STUCK
from surctl.priority.solver.safe_point import nearest_to_zero

__all__ = [
    "DAQP_INFEASIBLE",
    "DAQP_TOLERANCE",
    "NO_BOUND",
    "Kernel",
    "KernelSolution",
    "daqp_kernel",
    "daqp_solution",
    "new_osqp",
    "osqp_kernel",
    "osqp_solution",
    "own_kernel",
    "qpsolvers_kernels",
    "unfit",
]

Array: TypeAlias = NDArray[np.float64]

NO_BOUND = 1e30
"""The value that DAQP and OSQP use for infinity."""

DAQP_TOLERANCE = 1e-11
"""Largest violation of an inequality that DAQP accepts, for a normal of length 1."""

DAQP_INFEASIBLE = -1
"""The flag with which DAQP reports an infeasible problem."""


@dataclass(frozen=True)
class KernelSolution:
    """Result of one call of a QP solver.

    y: (d,), the minimiser, or None. multipliers: (m,) Lagrange multipliers, with y + Gᵀ·multipliers = 0. iterations:
    number of iterations. status: the status that the solver reports.

    The status "unfinished" means that the solver stopped early, for example at an iteration limit; y is its last
    iterate.
    """

    y: Array | None
    multipliers: Array
    iterations: int
    status: Literal["optimal", "unfinished", "infeasible", "failed"]


class Kernel(Protocol):
    """Protocol of a solver of min ½‖y‖² subject to lower ≤ G y ≤ upper: a function or an object that stores state."""

    def __call__(self, G: Array, lower: Array, upper: Array, /) -> KernelSolution:
        """Solve the problem for G (m, d), whose rows have length 1, and bounds (m,); an absent bound is ±inf."""
        ...


def unfit(G: Array, lower: Array, upper: Array) -> KernelSolution | None:
    """Return a result with status "infeasible" if lower > upper in some row, "failed" for a NaN, and otherwise None.

    The solvers do not handle these cases: DAQP treats an inequality with a NaN as satisfied, and for lower > upper DAQP
    and OSQP return the solution of the previous call.
    """
    if (lower <= upper).all() and np.isfinite(G).all():  # comparisons with a NaN are false
        return None
    whole = np.isfinite(G).all() and not (np.isnan(lower).any() or np.isnan(upper).any())
    return KernelSolution(None, np.zeros(lower.size), 0, "infeasible" if whole else "failed")


def daqp_kernel(G: Array, lower: Array, upper: Array) -> KernelSolution:
    """Solve the QP with DAQP (Arnström, Bemporad and Axehill 2022), a dual active-set method; check its exit flag."""
    m, d = G.shape
    return daqp_solution(
        m,
        *daqp.solve(
            np.eye(d),
            np.zeros(d),
            np.ascontiguousarray(G),
            np.minimum(upper, NO_BOUND),
            np.maximum(lower, -NO_BOUND),
            np.zeros(m, dtype=np.intc),
            primal_tol=DAQP_TOLERANCE,
        ),
    )


def daqp_solution(m: int, y: Any, _: float, flag: int, info: Any) -> KernelSolution:
    """Convert what DAQP returns for m inequalities to a KernelSolution; the exit flag determines the status."""
    iterations = int(info["iterations"])
    if flag == 1:
        return KernelSolution(np.array(y, dtype=float), np.array(info["lam"], dtype=float), iterations, "optimal")
    return KernelSolution(None, np.zeros(m), iterations, "infeasible" if flag == DAQP_INFEASIBLE else "failed")


def osqp_kernel(G: Array, lower: Array, upper: Array) -> KernelSolution:
    """Solve the QP with OSQP (Stellato et al. 2020), an operator-splitting method, with tight tolerances.

    With its default tolerances, OSQP violates bounds by 1e-3 and reports some feasible problems as infeasible.
    """
    low, high = np.maximum(lower, -NO_BOUND), np.minimum(upper, NO_BOUND)
    return unfit(G, low, high) or osqp_solution(new_osqp(G, low, high, warm=False))


def new_osqp(G: Array, lower: Array, upper: Array, *, warm: bool) -> Any:
    """Return an `osqp.OSQP` that stores all entries of G (m, d), zeros included, so that each can be updated.

    lower, upper: bounds (m,), finite.
    """
    import osqp
    from scipy import sparse

    m, d = G.shape
    pattern = (G.T.ravel(), np.tile(np.arange(m), d), np.arange(0, m * d + 1, m))
    solver = osqp.OSQP()
    solver.setup(
        sparse.eye(d, format="csc"),
        np.zeros(d),
        sparse.csc_matrix(pattern, shape=(m, d)),
        lower,
        upper,
        eps_abs=1e-10,
        eps_rel=1e-10,
        eps_prim_inf=1e-10,
        max_iter=20_000,
        polishing=False,  # polishing prints to the terminal; the caller polishes instead
        scaling=0,  # rows already have length 1, and updated scaled data would keep rounding errors of the last problem
        warm_starting=warm,
        verbose=False,
    )
    return solver


def osqp_solution(solver: Any) -> KernelSolution:
    """Run an `osqp.OSQP` that is set up, check its status, and return the solution."""
    import osqp

    result = solver.solve(raise_error=False)
    iterations, status = int(result.info.iter), int(result.info.status_val)
    unfinished = (osqp.SolverStatus.OSQP_SOLVED_INACCURATE, osqp.SolverStatus.OSQP_MAX_ITER_REACHED)
    if status == osqp.SolverStatus.OSQP_SOLVED or status in unfinished:
        said: Literal["optimal", "unfinished"] = "unfinished" if status in unfinished else "optimal"
        return KernelSolution(np.array(result.x, dtype=float), np.array(result.y, dtype=float), iterations, said)
    infeasible = status == osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE
    return KernelSolution(None, np.zeros(solver.m), iterations, "infeasible" if infeasible else "failed")


def own_kernel(G: Array, lower: Array, upper: Array) -> KernelSolution:
    """Solve the QP with this package's own dual active-set method (`dual_step`), compiled if there is a C compiler."""
    y, multipliers, status, iterations = nearest_to_zero(G, lower, upper)
    if status == OPTIMAL:
        return KernelSolution(y, multipliers, iterations, "optimal")
    return KernelSolution(None, np.zeros(lower.size), iterations, "infeasible" if status == STUCK else "failed")


def qpsolvers_kernels() -> dict[str, Kernel]:
    """Return, by name, a `Kernel` for each further QP solver that the package qpsolvers (Caron et al.) finds."""
    import qpsolvers

    others = sorted(set(qpsolvers.available_solvers) - {"daqp", "osqp"})
    return {name: partial(_qpsolvers_kernel, solver=name) for name in others}


def _qpsolvers_kernel(G: Array, lower: Array, upper: Array, *, solver: str) -> KernelSolution:
    import qpsolvers
    from scipy import sparse

    m, d = G.shape
    below, above = np.flatnonzero(lower > -NO_BOUND), np.flatnonzero(upper < NO_BOUND)
    # qpsolvers accepts one-sided rows only, and an infinite bound breaks its own check
    rows, bounds = np.vstack([G[above], -G[below]]), np.concatenate([upper[above], -lower[below]])
    form = sparse.csc_matrix if solver in qpsolvers.sparse_solvers else np.asarray
    problem = qpsolvers.Problem(form(np.eye(d)), np.zeros(d), G=form(rows), h=bounds)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the returned status already contains the warning "terminated with status ..."
        solution = qpsolvers.solve_problem(problem, solver=solver)
    if not solution.found or solution.x is None or solution.z is None:
        # a solver without a solution rarely reports why, so this is not treated as a proof of infeasibility
        return KernelSolution(None, np.zeros(m), 0, "failed")
    multipliers = np.zeros(m)
    multipliers[above] += solution.z[: len(above)]
    multipliers[below] -= solution.z[len(above) :]
    return KernelSolution(np.asarray(solution.x, dtype=float), multipliers, 0, "optimal")
