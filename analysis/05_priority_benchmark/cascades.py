"""Strict priority from general solvers: a QP a level over each backend of qpsolvers, and DAQP's own hierarchy.

The cascade is the one that a user would write: level by level, what a level has fixed is eliminated, and a little
regularisation makes the QP of a level unique. DAQP gets its rows stacked beforehand: only solving is timed.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import casadi as ca
import daqp
import numpy as np
import qpsolvers
from contender import Contender, Missing
from instances import BOX, LEVELS, ROWS, Instance, N
from numpy.typing import NDArray
from ours import NSB, PROJECTED, STRICT
from scipy import sparse

from surctl.priority import nsb_sweep, solve

__all__ = ["cascades", "hierarchies", "others"]

Array: TypeAlias = NDArray[np.float64]

# solvers of qpsolvers for small dense problems, with settings where the default is too loose
SETTINGS: dict[str, dict[str, Any]] = {
    "daqp": {},
    "piqp": {},
    "proxqp": {"eps_abs": 1e-7},
    "quadprog": {},
    "clarabel": {},
    "osqp": {"eps_abs": 1e-6, "eps_rel": 1e-6, "max_iter": 20_000},
}
_WHY = {"quadprog": "not installed (GPL: in no extra of this project)"}
_REGULAR = 1e-6  # from 1e-8 to 1e-10 DAQP fails on some levels; with larger values its solutions are wrong
_INFINITE = 1e30


def cascades(instances: Sequence[Instance]) -> list[Contender | Missing]:
    """One a backend."""
    ticks = [(i.tasks, *_one_sided(i)) for i in instances]
    found: list[Contender | Missing] = []
    for solver, settings in SETTINGS.items():
        name = f"qpsolvers cascade: {solver}"
        if solver not in qpsolvers.available_solvers:
            found.append(Missing(name, _WHY.get(solver, "not installed")))
            continue
        found.append(Contender(name, STRICT, _cascade(solver, settings), ticks))
    return found


def _one_sided(instance: Instance) -> tuple[Array, Array]:
    """Return G and h of G v ≤ h with all rows and the box."""
    A = np.vstack([np.eye(N), instance.A])
    lower, upper = np.append(BOX[0], instance.lower), np.append(BOX[1], instance.upper)
    below = np.isfinite(lower)
    return np.vstack([A, -A[below]]), np.append(upper, -lower[below])


def _cascade(solver: str, settings: dict[str, Any]) -> Callable[..., Array | None]:
    form = np.asarray if solver in qpsolvers.dense_solvers else sparse.csc_matrix

    def run(tasks: list[tuple[Array, Array]], G: Array, h: Array) -> Array | None:
        v, free = np.zeros(N), np.eye(N)
        for J, x in tasks:
            if free.shape[1] == 0:
                break
            reduced = J @ free
            P = reduced.T @ reduced + _REGULAR * np.eye(free.shape[1])
            # v fulfils the rows; a violation by rounding would make the next level infeasible
            slack = np.maximum(h - G @ v, 0.0)
            problem = qpsolvers.Problem(form(P), reduced.T @ (J @ v - x), form(G @ free), slack)
            found = qpsolvers.solve_problem(problem, solver=solver, **settings)
            if not found.found or found.x is None:
                return None
            v = v + free @ found.x
            _, s, right = np.linalg.svd(reduced)
            free = free @ right[np.count_nonzero(s > 1e-9) :].T
        return v

    def quiet(tasks: list[tuple[Array, Array]], G: Array, h: Array) -> Array | None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a level without a solution is counted, without a warning
            return run(tasks, G, h)

    return quiet


def hierarchies(instances: Sequence[Instance]) -> list[Contender]:
    """Return DAQP's hierarchical QP as two contenders: one call per step, and a `Model` that is set up once and
    updated.
    """
    n, at = N, N + ROWS + np.cumsum([0, *LEVELS])
    breaks = at.astype(np.intc)
    sense = np.zeros(at[-1], dtype=np.intc)
    ticks = []
    for i in instances:
        length = np.linalg.norm(
            i.J, axis=1
        )  # rows of length 1: otherwise DAQP weights the rows of a task by their lengths
        rows = np.ascontiguousarray(np.vstack([i.A, i.J / length[:, None]]))
        upper = np.concatenate([BOX[1], i.upper, i.x / length])
        lower = np.concatenate([BOX[0], np.maximum(i.lower, -_INFINITE), i.x / length])
        ticks.append((rows, upper, lower))
    model = daqp.Model()
    model.settings = {"primal_tol": 1e-10}
    flag, _ = model.setup(np.eye(n), np.zeros(n), *ticks[0], sense, breaks)
    if flag < 0:
        raise RuntimeError(f"DAQP's Model cannot be set up: flag {flag}")

    def kept(rows: Array, upper: Array, lower: Array) -> Array | None:
        # without `sense` the solver would start from the active set of the last step
        if model.update(A=rows, bupper=upper, blower=lower, sense=sense) < 0:
            return None
        v, _, flag, _ = model.solve()
        return v if flag > 0 else None

    def fresh(rows: Array, upper: Array, lower: Array) -> Array | None:
        v, _, flag, _ = daqp.solve(None, None, rows, upper, lower, sense, breaks, primal_tol=1e-10)
        return v if flag > 0 else None

    return [
        Contender("DAQP hierarchy: Model kept", STRICT, kept, ticks),
        Contender("DAQP hierarchy: one call", STRICT, fresh, ticks),
    ]


def others(instances: Sequence[Instance]) -> list[Contender]:
    """Return two contenders: CasADi's active-set QP for the last projection, and the printed (16) with numpy's pinv."""
    dense = ca.Sparsity.dense(ROWS + LEVELS[0], N)
    options = {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False}
    solver = ca.conic("last", "qrqp", {"h": ca.Sparsity.diag(N), "a": dense}, options)
    H, ticks = ca.DM.eye(N), list[tuple[Any, ...] | None]()
    for i in instances:
        if solve(i.problem).status != "optimal":  # if the first task cannot be fulfilled, this QP is infeasible
            ticks.append(None)
            continue
        levels = i.problem.levels
        goal = nsb_sweep(levels[1:], start=np.zeros(N))
        A = np.vstack([i.A, levels[0].J])
        low, high = np.append(i.lower, levels[0].x), np.append(i.upper, levels[0].x)
        ticks.append((-goal, A, low, high))

    def qrqp(g: Array, A: Array, low: Array, high: Array) -> Array | None:
        found = solver(h=H, g=g, a=A, lba=low, uba=high, lbx=BOX[0], ubx=BOX[1])["x"]
        return np.array(found).reshape(-1) if solver.stats()["success"] else None

    return [
        Contender("CasADi qrqp from Python (last projection alone)", PROJECTED, qrqp, ticks),
        Contender("numpy nested pinv", NSB, _nested, [(i.tasks,) for i in instances]),
    ]


def _nested(tasks: list[tuple[Array, Array]]) -> Array:
    v = np.zeros(N)
    for J, x in reversed(tasks):
        inverse = np.linalg.pinv(J)
        v = inverse @ x + v - inverse @ (J @ v)
    return v
