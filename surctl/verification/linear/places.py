"""The loops of the cascade opened at once: at all thrust commands, at all measurements of the pose, or at both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.verification.cascade import Cascade

__all__ = ["DISK_PLACES", "OpenLoop", "open_loop"]

Array = NDArray[np.float64]

DISK_PLACES = ("thrust", "measurement", "both")
"""The places where all loops are opened at once: the four thrust commands, the measured x_e, y_e, z_e, ψ, or both."""

_AXES = 4


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


def open_loop(cascade: Cascade, place: str) -> OpenLoop:
    """Open the loops of one or several cascades at `place`, one of `DISK_PLACES`; all other connections stay closed.

    Raises:
        InputError: `place` is not one of `DISK_PLACES`.
    """
    A, B, C, K = cascade.A, cascade.B, cascade.C, cascade.K
    thrust, pose = np.arange(K.shape[-2]) < _AXES, np.arange(K.shape[-1]) < _AXES
    nothing = np.zeros((*K.shape[:-2], _AXES, _AXES))
    if place == "thrust":
        # the rows of K for the integral action stay closed
        inner = A - B[..., ~thrust] @ K[..., ~thrust, :] @ C
        return OpenLoop(inner, B[..., thrust], K[..., thrust, :] @ C, nothing)
    if place == "measurement":
        inner = A - B @ K[..., ~pose] @ C[..., ~pose, :]
        return OpenLoop(inner, B @ K[..., pose], C[..., pose, :], nothing)
    if place != "both":
        raise InputError("no such place", key="place", value=place, remedy=nearest(place, DISK_PLACES))
    # the second input u2 is the negative of the measured pose that the law receives
    own, acting = K[..., ~thrust, :], K[..., thrust, :]
    inner = A - B[..., ~thrust] @ own[..., ~pose] @ C[..., ~pose, :]
    enter = np.concatenate([B[..., thrust], B[..., ~thrust] @ own[..., pose]], axis=-1)
    leave = np.concatenate([acting[..., ~pose] @ C[..., ~pose, :], C[..., pose, :]], axis=-2)
    through = np.block([[nothing, -acting[..., pose]], [nothing, nothing]])
    return OpenLoop(inner, enter, leave, through)
