"""Symbolic tests that show, for all poses at once, that NSB equals strict priority or that tasks are orthogonal.

The Jacobian of a task is J = A(η) R(ψ), where A = ∂σ/∂η and R is the orthogonal rotation matrix in equation (2) of the
paper. So J_iᵀJ_i commutes with the projector on the row space of the tasks above if and only if A_iᵀA_i commutes with
the corresponding projector formed from A. The tests use A, because A does not contain the sines and cosines of R, and
most A are constant.

True means that the property holds as an identity of the expressions. False means only that no identity was shown.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.priority.rowspace import row_space
from surctl.tasks import Stack

__all__ = ["commuting_levels", "orthogonal_pairs", "world_jacobians"]

Array: TypeAlias = NDArray[np.float64]

_ROUNDING = 1e-12  # constants of this size are rounding errors of zero


def world_jacobians(stack: Stack) -> list[ca.SX]:
    """Return A = ∂σ/∂η (k, 4) of each task, so that σ̇ = A η̇ in {E}; equal subexpressions are shared."""
    parts = [ca.jacobian(task.sigma, stack.eta) for task in stack.tasks]
    together = ca.cse(ca.vertcat(*parts))
    ends = np.cumsum([0, *(task.size for task in stack.tasks)])
    return [together[int(a) : int(b), :] for a, b in pairwise(ends)]


def commuting_levels(stack: Stack) -> tuple[bool, ...]:
    """Return for each level whether its commutator is zero for all poses η and all parameters.

    See module `commutator`. With A_i = ∂σ_i/∂η, the commutator of level i is zero if A_iᵀA_i maps the row space of the
    higher levels into itself, which is tested row by row, or if this row space contains all rows of A_i.
    """
    levels = world_jacobians(stack)
    rows = [[A[i, :].T for i in range(A.shape[0])] for A in levels]
    return tuple(_commutes(levels[i], [row for above in rows[:i] for row in above]) for i in range(len(levels)))


def orthogonal_pairs(stack: Stack) -> set[tuple[int, int]]:
    """Return the pairs (i, j), i < j, of tasks whose Jacobian rows are orthogonal for all poses and parameters."""
    levels = world_jacobians(stack)
    return {(i, j) for j, B in enumerate(levels) for i, A in enumerate(levels[:j]) if _vanishes(A @ B.T)}


def _commutes(A: ca.SX, above: list[ca.SX]) -> bool:
    """Return whether AᵀA maps the span of the vectors `above`, the rows of higher levels as columns, into itself.

    The return value is also valid if the dimension of the span varies from pose to pose.
    """
    # the span is range(P), P the projector on the constant rows, plus the parts of the other rows outside range(P)
    P = _projector([np.array(ca.DM(row)).ravel() for row in above if row.is_constant()], A.shape[1])
    outside = ca.SX(ca.sparsify(ca.DM(np.eye(A.shape[1]) - P)))
    moving = [b for b in (_clean(outside @ row) for row in above if not row.is_constant()) if b.nnz()]
    own = [_clean(outside @ A[i, :].T) for i in range(A.shape[0])]
    if all(a.nnz() == 0 or any(_vanishes(a - b) or _vanishes(a + b) for b in moving) for a in own):
        return True
    G = _clean(outside @ A.T @ A)
    if not _vanishes(G @ ca.SX(ca.sparsify(ca.DM(P)))):
        return False
    factors = _eigenvalues(A)
    images = [(G @ b, b) for b in moving]
    return all(any(_vanishes(image - factor * b) for factor in factors) for image, b in images)


def _projector(rows: list[Array], n: int) -> Array:
    if not rows:
        return np.zeros((n, n))
    basis = row_space(np.array(rows)).rows
    P: Array = basis.T @ basis
    return np.where(np.abs(P - np.round(P)) <= _ROUNDING, np.round(P), P)


def _eigenvalues(A: ca.SX) -> list[float]:
    """Return 0 and, if AᵀA is constant, the eigenvalues of AᵀA."""
    if not A.is_constant():
        return [0.0]
    squares = np.linalg.svd(np.array(ca.DM(A)), compute_uv=False) ** 2
    return [0.0, *(float(np.round(s)) if abs(s - np.round(s)) <= _ROUNDING else float(s) for s in squares)]


def _clean(expression: ca.SX) -> ca.SX:
    entries = ca.SX(*expression.shape)
    simple = ca.simplify(expression)
    for i, j in zip(*simple.sparsity().get_triplet(), strict=True):
        entry = simple[i, j]
        if not (entry.is_constant() and abs(float(entry)) <= _ROUNDING):
            entries[i, j] = entry
    return entries


def _vanishes(expression: ca.SX) -> bool:
    return bool(_clean(expression).nnz() == 0)
