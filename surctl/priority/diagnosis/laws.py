"""When NSB equals strict priority, and the velocities of both laws, from Jacobians alone.

For all desired rates x_i, the NSB law, equation (16) of the paper, equals strict (lexicographic) priority

    v_i = v_{i−1} + (J_i N)⁺(x_i − J_i v_{i−1}),   N = I − P,   P the projector on the row space of all tasks above i

if and only if J_iᵀJ_i commutes with P at every level i ≥ 2, where J_i is the Jacobian of level i. The condition is
valid for Jacobians of any rank: a task may be rank-deficient, depend on the tasks above it, or have no freedom left.

All functions accept arrays with additional leading axes, one entry for each sample: J (..., k, n).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.priority.settings import CUTOFF, negligible

Array: TypeAlias = NDArray[np.float64]

TOLERANCE = 1e-9
"""Commutators up to this norm count as zero: far above rounding errors (1e-15), and above the cut-off for ranks."""


class RowVectors(NamedTuple):
    """Right singular vectors (..., n, n) of Jacobians as rows, and their singular values s (..., n); 0 if too small."""

    vectors: Array
    s: Array

    @property
    def rank(self) -> NDArray[np.intp]:
        """Return the number (...,) of nonzero singular values."""
        return np.asarray(np.count_nonzero(self.s, axis=-1), dtype=np.intp)

    @property
    def projector(self) -> Array:
        """Return the orthogonal projector (..., n, n) on the row space."""
        basis = self.vectors * (self.s > 0.0)[..., None]
        return np.asarray(np.swapaxes(basis, -1, -2) @ basis)


def row_vectors(J: Array) -> RowVectors:
    """Return the singular vectors and values of J (..., k, n); values up to `CUTOFF`·‖J‖ or `ZERO_ROW` count as 0."""
    _, singular, vectors = np.linalg.svd(J, full_matrices=True)
    s = np.zeros(vectors.shape[:-1])
    s[..., : singular.shape[-1]] = singular
    return RowVectors(vectors, np.where(s > negligible(s[..., :1]), s, 0.0))


def _joined(P: Array, own: Array) -> Array:
    """Return the projector on the sum of the ranges of two projectors (..., n, n)."""
    N = np.eye(P.shape[-1]) - P
    _, s, vectors = np.linalg.svd(own @ N)
    new = vectors @ N * (s > CUTOFF)[..., None]  # N again, because a short remainder has lost digits
    return np.asarray(P + np.swapaxes(new, -1, -2) @ new)


def projector_above(jacobians: Sequence[Array], i: int) -> Array:
    """Return the projector on the row space of all tasks above level i (from 0)."""
    n = jacobians[i].shape[-1]
    P = np.zeros((*np.broadcast_shapes(*(J.shape[:-2] for J in jacobians)), n, n))
    for J in jacobians[:i]:
        P = _joined(P, row_vectors(J).projector)
    return P


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
    levels = [np.asarray(J, dtype=float) for J in jacobians]
    if not levels:
        raise InputError("has no level", key="jacobians", remedy="give at least one")
    for place, J in enumerate(levels, start=1):
        if J.ndim < 2 or 0 in J.shape or J.shape[-1] != levels[0].shape[-1]:
            remedy = "give (k, n), with the same n for all levels"
            raise InputError(f"J has shape {J.shape}", key=f"level {place}", remedy=remedy)
        if not np.isfinite(J).all():
            raise InputError("J is not finite", key=f"level {place}", remedy="check the inputs for NaN first")
    return np.stack([_norm(row_vectors(J), projector_above(levels, i)) for i, J in enumerate(levels)], axis=-1)


def _norm(task: RowVectors, P: Array) -> Array:
    square = (task.s / np.where(task.s[..., :1] > 0.0, task.s[..., :1], 1.0)) ** 2
    total = square[..., :, None] + square[..., None, :]
    weight = (square[..., None, :] - square[..., :, None]) / np.where(total > 0.0, total, 1.0)
    inside = task.vectors @ P @ np.swapaxes(task.vectors, -1, -2)
    return np.asarray(np.linalg.norm(weight * inside, 2, axis=(-2, -1)))


def strict_velocities(jacobians: Sequence[Array], references: Sequence[Array]) -> Array:
    """Return the velocity v (..., n) of strict priority for each sample (Siciliano and Slotine 1991).

    Level i with Jacobian J_i and desired rate x_i changes v to v + (J_i N)⁺(x_i − J_i v), where N is the projector on
    the null space of all levels above.

    Singular values of J_i N up to `CUTOFF`·‖J_i‖ count as 0. So near poses where a task becomes dependent on the tasks
    above it, v stays bounded but jumps.

    Args:
        jacobians: J (..., k, n) of each level, highest priority first, finite.
        references: x (..., k) of each level [unit of σ per second], finite.
    """
    n = jacobians[0].shape[-1]
    N, v = np.eye(n), np.zeros(n)
    for J, x in zip(jacobians, references, strict=True):
        inverse = _inverse(J @ N, J)
        v = v + times(inverse, x - times(J, v))
        N = N - inverse @ J @ N
    return v


def nsb_velocities(jacobians: Sequence[Array], references: Sequence[Array]) -> Array:
    """Return the velocity (..., n) of the NSB law, equation (16) of the paper, for each sample.

    The law is computed by w ← w + J_i⁺(x_i − J_i w) from the lowest level to the highest. The arguments are those of
    `strict_velocities`.
    """
    w = np.zeros(jacobians[0].shape[-1])
    for J, x in zip(reversed(jacobians), reversed(references), strict=True):
        w = w + times(_inverse(J, J), x - times(J, w))
    return w


def _inverse(M: Array, J: Array) -> Array:
    """Return the pseudo-inverse (..., n, k) of M (..., k, n); singular values up to `CUTOFF`·‖J‖ count as 0."""
    size, least = np.linalg.norm(M, 2, axis=(-2, -1)), negligible(np.linalg.norm(J, 2, axis=(-2, -1)))
    return np.asarray(np.linalg.pinv(M, rcond=least / np.maximum(size, least)))


def times(J: Array, v: Array) -> Array:
    """Return the product J v (..., k)."""
    return np.asarray(np.einsum("...kn,...n->...k", J, v))
