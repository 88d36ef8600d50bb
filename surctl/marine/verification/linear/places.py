"""The loops of the cascade opened at once: at all thrust commands, at all measurements of the pose, or at both."""

from __future__ import annotations

import numpy as np

from surctl.errors import InputError, nearest
from surctl.marine.verification.cascade import Cascade
from surctl.verification.linear.open_loop import OpenLoop

__all__ = ["DISK_PLACES", "open_loop"]

DISK_PLACES = ("thrust", "measurement", "both")
"""The places where all loops are opened at once: the four thrust commands, the measured x_e, y_e, z_e, ψ, or both."""

_AXES = 4


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
