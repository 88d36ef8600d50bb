"""Independent implementations of the priority laws, for comparison with the solvers, with which they share no code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import daqp
import numpy as np
from numpy.typing import NDArray

from surctl.errors import SolverError
from surctl.priority.problem import Level, PriorityProblem

__all__ = ["daqp_hierarchy", "printed_law", "svd_cascade"]

Array: TypeAlias = NDArray[np.float64]

_CUTOFF = 1e-10
_NO_BOUND = 1e30


def printed_law(levels: Sequence[Level]) -> Array:
    """Return the velocity of the NSB law, equation (16) of the paper, as the sum v_1 + N_1 v_2 + N_1 N_2 v_3 + …"""
    n = levels[0].J.shape[1]
    v, chain = np.zeros(n), np.eye(n)
    for level in levels:
        inverse = np.linalg.pinv(level.J, rcond=_CUTOFF)
        v = v + chain @ inverse @ level.x
        chain = chain @ (np.eye(n) - inverse @ level.J)
    return v


def svd_cascade(levels: Sequence[Level]) -> Array:
    """Return the velocity of strict priority without limits, by v ← v + (J N)⁺(x − J v) for one level after another.

    J is the Jacobian of the level, x its desired rate, and N the null-space projector of all levels above. Singular
    values of J N below 1e-10·‖J‖ count as 0.
    """
    n = levels[0].J.shape[1]
    v, N = np.zeros(n), np.eye(n)
    for level in levels:
        left, s, right = np.linalg.svd(level.J @ N, full_matrices=False)
        keep = s > _CUTOFF * np.linalg.norm(level.J, 2)
        v = v + right[keep].T @ ((left[:, keep].T @ (level.x - level.J @ v)) / s[keep])
        N = N - right[keep].T @ right[keep]
    return v


def daqp_hierarchy(problem: PriorityProblem) -> Array:
    """Solve the problem with DAQP's solver for strict priority (Arnström, Bemporad and Axehill 2022).

    The limits are the first level of this solver. DAQP scales every Jacobian row and every limit to length 1, so its
    residuals can be compared with those of this package only if all rows already have length 1.

    Raises:
        SolverError: DAQP finds no solution.
    """
    levels, rows = problem.levels, problem.rows
    A = np.vstack([*[row.a for row in rows], *[level.J for level in levels]])
    lower = np.concatenate([[row.lower for row in rows], *[level.lower for level in levels]])
    upper = np.concatenate([[row.upper for row in rows], *[level.high for level in levels]])
    ends = np.cumsum([len(rows), *[level.lower.size for level in levels]]).astype(np.intc)
    v, _, flag, _ = daqp.solve(
        None,
        None,  # a vector of zeros here would leave the solution uninitialised
        A,
        np.minimum(upper, _NO_BOUND),
        np.maximum(lower, -_NO_BOUND),
        np.zeros(upper.size, dtype=np.intc),
        break_points=ends,
        primal_tol=1e-11,
        dual_tol=1e-11,
    )
    if flag <= 0:
        raise SolverError(f"DAQP's hierarchical solver failed with flag {flag}")
    return np.array(v, dtype=float)
