"""The form V of a turning cruise in double precision, and the axes of the body.

If the thrust is the present command, V = ξᵀ P ξ. With lag, V = ξᵀ P ξ + q |E|². On axis i, E = n_i · E is the thrust
minus its command, divided by the mass in the law's model. With held commands, V = ξᵀ P ξ + q σ (1 − σ) |E/σ|² at the
share σ of a period.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.region_exact import Matrix, inverse
from surctl.certcheck.turning_terms import UP

__all__ = ["Form", "axes_of"]

Array = NDArray[np.float64]

_WORST = 1e4  # largest condition of the scaled matrix of V


class Form:
    """V in double precision, with the exact P⁻¹ rounded to doubles.

    Args:
        p: matrix P (4, 4).
        weight: the weight q [s⁴/m²]; None for thrust that is the present command.
        k_v: the law's gain k_v [1/s], by which an acceleration changes the command.
    """

    def __init__(self, p: Matrix, weight: Fraction | None = None, k_v: Fraction = Fraction(0)) -> None:
        self.exact = inverse(p)
        size = 4 if weight is None else 6
        self.p, self.covariance, self.change = np.zeros((3, size, size))
        for whole, part in ((self.p, p), (self.covariance, self.exact)):
            whole[:4, :4] = [[float(entry) for entry in row] for row in part]
        self.change[:4, :4] = np.tril(np.linalg.inv(np.linalg.cholesky(self.p[:4, :4])))  # T with T P Tᵀ ≈ I
        for k in range(4, size):
            self.p[k, k], self.covariance[k, k] = float(weight or 0), 1 / float(weight or 0)
            self.change[k, k] = 1 / np.sqrt(self.p[k, k])
        scale = np.abs(self.change) @ np.abs(self.p) @ np.abs(self.change).T
        if not (scale.max() <= _WORST and np.all(np.diag(self.change) > 0)):  # a NaN fails this test too
            raise Rejected("P is too ill-conditioned for double precision")
        entry = np.zeros((size, 2))  # what an acceleration of the vehicle changes: velocity, and thrust behind command
        entry[2:4] = np.eye(2)
        entry[4:] = float(k_v) * np.eye(2)[: size - 4]
        self.entry = entry
        self.lever = self.change @ self.p @ entry
        self.place, self.speed, self.error = self.change[:, :2], self.change[:, 2:4], self.change[:, 4:]

    def rows(self, place: Array, speed: Array) -> Array:
        """Return the matrix (2, n) of a function of position and velocity from its blocks (2, 2)."""
        return np.hstack([place, speed, np.zeros((2, len(self.p) - 4))])

    def largest(self, rows: Array, axes: Array, high: float) -> float:
        """Return a bound on |n · rows ξ| over V ≤ high and unit vectors n with n nᵀ in the hull of `axes` (k, 2, 2)."""
        gram, size = rows @ self.covariance @ rows.T, np.abs(rows) @ np.abs(self.covariance) @ np.abs(rows).T
        at = np.einsum("kij,ij->k", axes, gram) + 1e-12 * np.einsum("kij,ij->k", np.abs(axes), size)
        return float(np.sqrt(max(at.max(), 0.0) * high) * UP + 1e-12)


def axes_of(z: Array) -> tuple[Array, Array]:
    """Return n_1 n_1ᵀ and n_2 n_2ᵀ (k, 2, 2) for points (cos 2ψ, sin 2ψ) (k, 2)."""
    turned = np.stack([np.stack([z[:, 0], z[:, 1]], 1), np.stack([z[:, 1], -z[:, 0]], 1)], 1)
    return (np.eye(2) + turned) / 2, (np.eye(2) - turned) / 2
