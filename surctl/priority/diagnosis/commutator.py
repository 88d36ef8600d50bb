"""Commutator condition on the task Jacobians, which decides whether the NSB law equals strict priority.

For all desired rates x_i, the NSB law, equation (16) of the paper, equals strict (lexicographic) priority

    v_i = v_{i−1} + (J_i N)⁺(x_i − J_i v_{i−1}),   N = I − P,   P the projector on the row space of all tasks above i

if and only if J_iᵀJ_i commutes with P at every level i ≥ 2, where J_i is the Jacobian of level i. The condition is
valid for Jacobians of any rank: a task may be rank-deficient, depend on the tasks above it, or have no freedom left.

All functions of this module accept arrays with additional leading axes, one entry for each sample: J (..., k, n).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.priority.rowspace import CUTOFF, ZERO_ROW

__all__ = ["TOLERANCE", "Directions", "absorb", "commutator_norms", "directions", "equals_strict_priority"]

Array: TypeAlias = NDArray[np.float64]

TOLERANCE = 1e-9
"""Commutators up to this norm count as zero: far above rounding errors (1e-15), and above the cut-off for ranks."""


@dataclass(frozen=True, eq=False)
class Directions:
    """Right singular vectors and singular values of J (..., k, n); singular values below a cut-off are set to 0.

    Attributes:
        vectors: (..., n, n), unit vectors as rows, largest singular value first.
        s: (..., n), singular values [unit of J]; 0 in the null space.
    """

    vectors: Array
    s: Array

    @property
    def rank(self) -> NDArray[np.intp]:
        """Return the number (...,) of nonzero singular values."""
        count: NDArray[np.intp] = np.asarray(np.count_nonzero(self.s, axis=-1), dtype=np.intp)
        return count

    @property
    def rows(self) -> Array:
        """Return an orthonormal basis (..., n, n) of the row space, one vector in each row, followed by zero rows."""
        basis: Array = self.vectors * (self.s > 0.0)[..., None]
        return basis

    @property
    def projector(self) -> Array:
        """Return the orthogonal projector (..., n, n) on the row space."""
        product: Array = np.swapaxes(self.rows, -1, -2) @ self.rows
        return product


def directions(J: Array, *, cutoff: float = CUTOFF) -> Directions:
    """Return the singular vectors and values of J (..., k, n); values up to `cutoff`·‖J‖ or `ZERO_ROW` count as 0."""
    _, singular, vectors = np.linalg.svd(J, full_matrices=True)
    s = np.zeros(vectors.shape[:-1])
    s[..., : singular.shape[-1]] = singular
    return Directions(vectors, np.where(s > np.maximum(cutoff * s[..., :1], ZERO_ROW), s, 0.0))


def absorb(P: Array, task: Directions) -> Array:
    """Return the projector on the sum of the range of P (..., n, n) and the row space of a task."""
    N = np.eye(P.shape[-1]) - P
    _, s, vectors = np.linalg.svd(task.rows @ N)
    new = vectors @ N * (s > CUTOFF)[..., None]  # N again, because a short remainder has lost digits
    enlarged: Array = P + np.swapaxes(new, -1, -2) @ new
    return enlarged


# Sketch of the proof of the condition. With x_i = 0, both laws for the first i levels must equal the laws for the first
# i − 1 levels inside range(P), because strict priority uses all of range(P) for the levels above i. So the correction
# by level i vanishes in range(P): (J_i N)⁺J_i P = 0, which means N J_iᵀJ_i P = 0. Conversely, N then commutes with
# J_iᵀJ_i, hence with J_i⁺J_i, so that (J_i N)⁺ = N J_i⁺, and N_1 ⋯ N_i projects on the intersection of the null spaces.
def commutator_norms(jacobians: Sequence[Array]) -> Array:
    """Return, for each level i, a norm of the commutator of J_iᵀJ_i and P, (..., levels); 0 for the first level.

    J_i is the Jacobian of level i, and P the projector on the row space of all levels above. The commutator is J_iᵀJ_i
    P − P J_iᵀJ_i, written in the basis of the right singular vectors of J_i. Its entry (a, b) is divided by s_a² +
    s_b², where s are the singular values of J_i; the returned number is the spectral norm of this matrix. This norm has
    no unit, is at most 1/2 for a task of one row and √(n/8) for any task, and is zero if and only if the commutator is
    zero. The division makes short rows of J_i count as much as long rows, because short rows affect both laws as much
    as long rows do.

    Args:
        jacobians: J (..., k, n) of each level, highest priority first.

    Raises:
        InputError: there is no level, the Jacobians have different numbers of columns, or a number is not finite; the
            message names the level.
    """
    levels = _checked(jacobians)
    n = levels[0].shape[-1]
    P = np.zeros((*np.broadcast_shapes(*(J.shape[:-2] for J in levels)), n, n))
    norms = np.zeros((*P.shape[:-2], len(levels)))
    for i, J in enumerate(levels):
        task = directions(J)
        norms[..., i] = _norm(task, P)
        P = absorb(P, task)
    return norms


def equals_strict_priority(jacobians: Sequence[Array], *, tol: float = TOLERANCE) -> bool:
    """Return whether NSB equals strict priority for all desired rates, that is, no commutator norm exceeds `tol`.

    Args:
        jacobians: J (k, n) of each level, highest priority first; with leading axes for samples, the condition must
            hold at all samples.
        tol: largest value of `commutator_norms` that counts as zero.

    Raises:
        InputError: as in `commutator_norms`.
    """
    return bool((commutator_norms(jacobians) <= tol).all())


def _norm(task: Directions, P: Array) -> Array:
    square = (task.s / np.where(task.s[..., :1] > 0.0, task.s[..., :1], 1.0)) ** 2
    total = square[..., :, None] + square[..., None, :]
    weight = (square[..., None, :] - square[..., :, None]) / np.where(total > 0.0, total, 1.0)
    inside = task.vectors @ P @ np.swapaxes(task.vectors, -1, -2)
    norm: Array = np.linalg.norm(weight * inside, 2, axis=(-2, -1))
    return norm


def _checked(jacobians: Sequence[Array]) -> list[Array]:
    levels = [np.asarray(J, dtype=float) for J in jacobians]
    if not levels:
        raise InputError("has no level", key="jacobians", remedy="give at least one")
    for place, J in enumerate(levels, start=1):
        if J.ndim < 2 or 0 in J.shape or J.shape[-1] != levels[0].shape[-1]:
            raise InputError(
                f"J has shape {J.shape}",
                key=f"level {place}",
                remedy="give (k, n), with the same n for all levels",
            )
        if not np.isfinite(J).all():
            raise InputError("J is not finite", key=f"level {place}", remedy="check the inputs for NaN first")
    return levels
