"""Conversion between the frame conventions ENU/FLU, used in all computations, and NED/FRD, used by other programs.

ENU is the frame {E}: x east, y north, z up, ψ counter-clockwise from x. FLU is the frame {B}: x forward, y left, z up.
NED has x north, y east, z down, and ψ clockwise from north. FRD has x forward, y right, z down (Fossen 2021, section
2.1). Each function converts in both directions, because the conversion is its own inverse.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, nearest

__all__ = ["FRAMES", "FRAME_TEXT", "Frame", "check_frame", "swap_body", "swap_pose"]

Frame = Literal["enu", "ned"]
FRAMES: tuple[Frame, ...] = get_args(Frame)

FRAME_TEXT: dict[Frame, str] = {
    "enu": "ENU/FLU: x east, y north, z up, psi counter-clockwise from x; body x forward, y left, z up",
    "ned": "NED/FRD: x north, y east, z down, psi clockwise from x; body x forward, y right, z down",
}
"""The text with which a file states its frame."""


def swap_pose(eta: ArrayLike) -> NDArray[np.float64]:
    """Convert poses (…, 4) of x, y, z [m] and ψ [rad] from ENU to NED or back: (y, x, −z, π/2 − ψ).

    The conversion does not wrap headings to one turn. A NaN is converted to NaN.

    Example:
        >>> import numpy as np
        >>> from surctl.vehicle import swap_pose
        >>> swap_pose([1.0, 2.0, -0.15, np.pi / 2]).tolist()  # heading north
        [2.0, 1.0, 0.15, 0.0]
    """
    pose = _four("pose", eta)
    x, y, z, psi = np.moveaxis(pose, -1, 0)
    return np.stack([y, x, 0.0 - z, np.pi / 2 - psi], axis=-1)


def swap_body(vector: ArrayLike) -> NDArray[np.float64]:
    """Convert body vectors (…, 4) from FLU to FRD or back: (u, −v, −w, −r).

    A body vector is a velocity u, v, w [m/s], r [rad/s], or a thrust [N, N m].

    Example:
        >>> from surctl.vehicle import swap_body
        >>> swap_body([0.2, 0.1, 0.0, 0.3]).tolist()
        [0.2, -0.1, 0.0, -0.3]
    """
    return _four("vector", vector) * [1.0, -1.0, -1.0, -1.0] + 0.0  # no −0


def check_frame(frame: object, *, key: str = "frame") -> Frame:
    """Return the frame name if it is in `FRAMES`; otherwise raise InputError.

    Example:
        >>> from surctl.vehicle import check_frame
        >>> check_frame("ned")
        'ned'
        >>> check_frame("nde")
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: frame = 'nde': is not known; did you mean 'ned'?
    """
    if frame not in FRAMES:
        raise InputError("is not known", key=key, value=frame, remedy=nearest(str(frame), FRAMES))
    return frame


def _four(key: str, value: ArrayLike) -> NDArray[np.float64]:
    values = np.asarray(value, dtype=float)
    if values.shape[-1:] != (4,):
        raise InputError(f"has shape {values.shape}", key=key, remedy="give (4,), or (n, 4)")
    return values
