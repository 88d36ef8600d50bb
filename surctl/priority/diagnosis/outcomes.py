"""Velocities and residuals of NSB and of strict priority for many samples at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.rowspace import CUTOFF, ZERO_ROW

__all__ = ["nsb_velocities", "residual_norms", "strict_velocities"]

Array: TypeAlias = NDArray[np.float64]


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
    N = np.eye(n)
    v = np.zeros(n)
    for J, x in zip(jacobians, references, strict=True):
        least = np.maximum(CUTOFF * _size(J), ZERO_ROW)
        v = v + _pulled(J @ N, x - _times(J, v), least)
        N = N - _span(J @ N, least)
    return v


def nsb_velocities(jacobians: Sequence[Array], references: Sequence[Array]) -> Array:
    """Return the velocity (..., n) of the NSB law, equation (16) of the paper, for each sample.

    The law is computed by w ← w + J_i⁺(x_i − J_i w) from the lowest level to the highest. The arguments are those of
    `strict_velocities`.
    """
    w = np.zeros(jacobians[0].shape[-1])
    for J, x in zip(reversed(jacobians), reversed(references), strict=True):
        w = w + _pulled(J, x - _times(J, w), np.maximum(CUTOFF * _size(J), ZERO_ROW))
    return w


def residual_norms(jacobians: Sequence[Array], references: Sequence[Array], v: Array) -> Array:
    """Return the residual ‖J_i v − x_i‖ of each level i for each sample, (..., levels) [unit of σ per second]."""
    return np.stack(
        [np.linalg.norm(_times(J, v) - x, axis=-1) for J, x in zip(jacobians, references, strict=True)], axis=-1
    )


def _pulled(J: Array, y: Array, least: Array) -> Array:
    """Return the product J⁺y (..., n); singular values of J up to `least` (..., 1) count as 0."""
    left, s, right = np.linalg.svd(J, full_matrices=False)
    significant = s > least
    share = np.where(significant, np.einsum("...ka,...k->...a", left, y), 0.0) / np.where(significant, s, 1.0)
    pulled: Array = np.einsum("...an,...a->...n", right, share)
    return pulled


def _span(J: Array, least: Array) -> Array:
    """Return the projector J⁺J (..., n, n); singular values of J up to `least` count as 0."""
    _, s, right = np.linalg.svd(J, full_matrices=False)
    rows = right * (s > least)[..., None]
    projector: Array = np.swapaxes(rows, -1, -2) @ rows
    return projector


def _size(J: Array) -> Array:
    size: Array = np.linalg.norm(J, 2, axis=(-2, -1))[..., None]
    return size


def _times(J: Array, v: Array) -> Array:
    product: Array = np.einsum("...kn,...n->...k", J, v)
    return product
