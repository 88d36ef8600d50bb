"""Reference solutions of priority problems, by solvers that share no code with surctl's.

`hierarchy` is DAQP's solver for strict priority (Arnström, Bemporad and Axehill 2022). `cascade` solves one level after
another with the interior-point method Clarabel, in coordinates of the null space of the levels above (singular value
decomposition). Limits that contradict each other are relaxed before, by HiGHS.
"""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.optimize import linprog

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from surctl.errors import SolverError
from surctl.priority import PriorityProblem, Row, build_problem
from tests.oracles.priority_references import daqp_hierarchy

__all__ = ["best", "least_opening", "opened", "violation", "worse"]

Array = NDArray[np.float64]

CUTOFF = 1e-10
"""Singular values below CUTOFF·‖J‖ count as 0, as in surctl."""

WITHIN = 1e-11
"""A reference that violates a limit by more than this may be better than the optimum, and is not used."""

_TIGHT = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}


def least_opening(problem: PriorityProblem) -> float:
    """Return the smallest amount by which the barrier limits, scaled to length 1, must be moved outwards."""
    G, h = _one_sided(problem)
    soft = np.repeat([float(row.kind != "actuator") for row in problem.rows], 2)[_finite(problem)]
    n = problem.width
    bounds = [(None, None)] * n + [(0, None)]
    done = linprog(np.eye(n + 1)[n], np.column_stack([G, -soft]), h, bounds=bounds, method="highs-ds", options=_TIGHT)
    return float(done.x[n]) if done.status == 0 else np.nan


def opened(problem: PriorityProblem, by: float) -> PriorityProblem:
    """Return the problem with its barrier limits moved outwards by `by`."""
    rows = []
    for row in problem.rows:
        move = by * float(np.linalg.norm(row.a)) if row.kind != "actuator" else 0.0
        rows.append(Row(row.name, row.kind, row.a, row.lower - move, row.upper + move))
    return build_problem(problem.levels, rows)


def best(problem: PriorityProblem, strict: int) -> list[list[float]]:
    """Return the residuals of the first `strict` levels at every reference solution within the limits to `WITHIN`."""
    few = PriorityProblem(problem.levels[:strict], problem.rows)
    found = []
    with contextlib.suppress(SolverError):
        found.append(daqp_hierarchy(few))
    if not found or violation(few, found[0]) > WITHIN:
        found.append(_cascade(few))
    return [[level.residual(v) for level in few.levels] for v in found if violation(few, v) <= WITHIN]


def worse(found: list[float], other: list[float]) -> bool:
    """Return whether `found` is worse than `other`: by 1e-6 at a level, and not better at a level above.

    Better means by 1e-14. A larger margin would not do: a residual r that is only δ above its minimum lets J v be off
    by √(2 r δ), which the levels below can use.
    """
    for mine, theirs in zip(found, other, strict=True):
        if mine > theirs + 1e-6 * (1.0 + theirs):
            return True
        if mine < theirs - 1e-14 * (1.0 + theirs):
            return False
    return False


def _cascade(problem: PriorityProblem) -> Array:
    G, h = _one_sided(problem)
    n = problem.width
    v, Z = np.zeros(n), np.eye(n)
    for level in problem.levels:
        if level.is_goal:
            v = v + Z @ _least(level.J @ Z, level.x - level.J @ v, G @ Z, h - G @ v)
            _, s, right = np.linalg.svd(level.J @ Z)
            Z = Z @ right[int((s > CUTOFF * max(np.linalg.norm(level.J, 2), 1e-300)).sum()) :].T
        else:  # a slack variable takes J v to its interval
            k, d = len(level.J), Z.shape[1]
            free = np.hstack([np.zeros((k, d)), np.eye(k)])
            both = np.vstack([np.hstack([level.J @ Z, np.eye(k)]), np.hstack([-level.J @ Z, -np.eye(k)])])
            edge = np.append(level.high - level.J @ v, level.J @ v - level.lower)
            wide, limit = np.vstack([np.hstack([G @ Z, np.zeros((len(G), k))]), both]), np.append(h - G @ v, edge)
            y = _least(free, np.zeros(k), wide[np.isfinite(limit)], limit[np.isfinite(limit)])
            v = v + Z @ y[:d]
            value = level.J @ v
            G = np.vstack([G, level.J, -level.J])
            h = np.concatenate([h, np.maximum(level.high, value), -np.minimum(level.lower, value)])
        if Z.shape[1] == 0:
            break
    return v


def _least(M: Array, y: Array, G: Array, h: Array) -> Array:
    """Return the z that minimises ‖M z − y‖ subject to G z ≤ h."""
    k = M.shape[1]
    fine = np.isfinite(h)
    G, h = G[fine], h[fine]
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_iter = False, 200
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-13
    P = sparse.triu(sparse.csc_matrix(M.T @ M)).tocsc()
    cones = [clarabel.NonnegativeConeT(len(h))]
    z = np.array(clarabel.DefaultSolver(P, -M.T @ y, sparse.csc_matrix(G), h, cones, settings).solve().x)
    return z if np.isfinite(z).all() else np.zeros(k)


def _finite(problem: PriorityProblem) -> NDArray[np.bool_]:
    ends = np.array([[row.upper, row.lower] for row in problem.rows]).reshape(-1)
    return np.isfinite(ends)


def _one_sided(problem: PriorityProblem) -> tuple[Array, Array]:
    G, h = [], []
    for row in problem.rows:
        length = float(np.linalg.norm(row.a)) or 1.0
        G += [row.a / length, -row.a / length]
        h += [row.upper / length, -row.lower / length]
    fine = _finite(problem)
    return np.array(G)[fine], np.array(h)[fine]


def violation(problem: PriorityProblem, v: Array) -> float:
    """Return by how much v exceeds a limit at most, limits scaled to length 1; inf for NaN."""
    G, h = _one_sided(problem)
    return float((G @ v - h).max()) if np.isfinite(v).all() else np.inf
