"""An open loop with several channels as matrices: several loops opened at once, or one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["OpenLoop"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """The open loop L(s) = C (sI − A)⁻¹ B + D with q channels, for negative feedback; leading axes hold several loops.

    Attributes:
        A: system matrix (…, n, n) [1/s].
        B: input matrix (…, n, q).
        C: output matrix (…, q, n).
        D: feedthrough matrix (…, q, q) of L; I + D must be invertible.
    """

    A: Array
    B: Array
    C: Array
    D: Array

    def __getitem__(self, chosen: NDArray[np.intp]) -> OpenLoop:
        """Return the loops at the given indices of the leading axis."""
        return OpenLoop(self.A[chosen], self.B[chosen], self.C[chosen], self.D[chosen])

    def complementary(self) -> OpenLoop:
        """Return the complementary sensitivity T = L (I + L)⁻¹; the poles of T are those of the closed loop."""
        inverse = np.linalg.inv(np.eye(self.D.shape[-1]) + self.D)
        B = self.B @ inverse
        return OpenLoop(self.A - B @ self.C, B, inverse @ self.C, self.D @ inverse)

    def response(self, omega: Array) -> NDArray[np.complex128]:
        """Return the frequency response L(jω) (…, k, q, q) at the frequencies ω (k,) [rad/s]."""
        A, B, C, D = (m[..., None, :, :] for m in (self.A, self.B, self.C, self.D))
        pencil = 1j * np.asarray(omega)[:, None, None] * np.eye(A.shape[-1]) - A
        inner = np.linalg.solve(pencil, np.broadcast_to(B, (*pencil.shape[:-1], B.shape[-1])))
        return np.asarray(C @ inner + D, dtype=complex)
