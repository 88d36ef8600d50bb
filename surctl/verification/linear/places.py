"""The cascade opened at several places at once: all thrusts, all measurements of the pose, or both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.verification.cascade import Cascade

__all__ = ["DISK_PLACES", "OpenLoop", "open_loop"]

Array = NDArray[np.float64]

DISK_PLACES = ("thrust", "measurement", "both")
"""Where all loops are opened at once: the four thrust commands; x_e, y_e, z_e, ψ as measured; or all eight."""

_AXES = 4


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """L(s) = C (sI − A)⁻¹ B + D under negative feedback u = −L u; square, q channels; one, or many behind an axis.

    Attributes:
        A: (…, n, n) [1/s].
        B: (…, n, q).
        C: (…, q, n).
        D: (…, q, q); I + D must be regular.
    """

    A: Array
    B: Array
    C: Array
    D: Array

    def __getitem__(self, chosen: NDArray[np.intp]) -> OpenLoop:
        """Those of many."""
        return OpenLoop(self.A[chosen], self.B[chosen], self.C[chosen], self.D[chosen])

    def complementary(self) -> OpenLoop:
        """T = L (I + L)⁻¹ in the same form, whose poles are those of the closed loop."""
        inverse = np.linalg.inv(np.eye(self.D.shape[-1]) + self.D)
        B = self.B @ inverse
        return OpenLoop(self.A - B @ self.C, B, inverse @ self.C, self.D @ inverse)

    def response(self, omega: Array) -> NDArray[np.complex128]:
        """C (jω − A)⁻¹ B + D at ω (k,) [rad/s], (…, k, q, q)."""
        A, B, C, D = (m[..., None, :, :] for m in (self.A, self.B, self.C, self.D))
        pencil = 1j * np.asarray(omega)[:, None, None] * np.eye(A.shape[-1]) - A
        inner = np.linalg.solve(pencil, np.broadcast_to(B, (*pencil.shape[:-1], B.shape[-1])))
        return np.asarray(C @ inner + D, dtype=complex)


def open_loop(cascade: Cascade, place: str) -> OpenLoop:
    """One cascade, or many, opened at `DISK_PLACES`, everything else closed.

    Raises:
        InputError: an unknown place.
    """
    A, B, C, K = cascade.A, cascade.B, cascade.C, cascade.K
    thrust, pose = np.arange(K.shape[-2]) < _AXES, np.arange(K.shape[-1]) < _AXES
    nothing = np.zeros((*K.shape[:-2], _AXES, _AXES))
    if place == "thrust":
        # the integral's own rows of K stay closed
        inner = A - B[..., ~thrust] @ K[..., ~thrust, :] @ C
        return OpenLoop(inner, B[..., thrust], K[..., thrust, :] @ C, nothing)
    if place == "measurement":
        inner = A - B @ K[..., ~pose] @ C[..., ~pose, :]
        return OpenLoop(inner, B @ K[..., pose], C[..., pose, :], nothing)
    if place != "both":
        raise InputError("no such place", key="place", value=place, remedy=nearest(place, DISK_PLACES))
    # u2 = −(pose as measured): what the law reads, with the sign of the feedback taken out
    own, acting = K[..., ~thrust, :], K[..., thrust, :]
    inner = A - B[..., ~thrust] @ own[..., ~pose] @ C[..., ~pose, :]
    enter = np.concatenate([B[..., thrust], B[..., ~thrust] @ own[..., pose]], axis=-1)
    leave = np.concatenate([acting[..., ~pose] @ C[..., ~pose, :], C[..., pose, :]], axis=-2)
    through = np.block([[nothing, -acting[..., pose]], [nothing, nothing]])
    return OpenLoop(inner, enter, leave, through)
