"""Conversion between the frame conventions ENU/FLU, used in all computations, and NED/FRD, used by other programs.

ENU is the frame {E}: x east, y north, z up, ψ counter-clockwise from x. FLU is the frame {B}: x forward, y left, z up.
NED has x north, y east, z down, and ψ clockwise from north. FRD has x forward, y right, z down (Fossen 2021, section
2.1). `swap_pose` and `swap_body` convert in both directions, because the conversion is its own inverse.

{B} is the heading frame: it turns with the heading alone, so its x and y axes stay horizontal when the hull rolls or
pitches. A sensor on the hull, such as a Doppler velocity log, measures in the frame of the hull (`heading_velocity`).
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError

__all__ = ["FRAMES", "FRAME_TEXT", "Frame", "check_frame", "heading_velocity", "swap_body", "swap_pose"]

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
        >>> from surctl.marine.vehicle import swap_pose
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
        >>> from surctl.marine.vehicle import swap_body
        >>> swap_body([0.2, 0.1, 0.0, 0.3]).tolist()
        [0.2, -0.1, 0.0, -0.3]
    """
    return _four("vector", vector) * [1.0, -1.0, -1.0, -1.0] + 0.0  # no −0


def heading_velocity(
    velocity: ArrayLike, rates: ArrayLike, *, roll: ArrayLike, pitch: ArrayLike
) -> NDArray[np.float64]:
    """Convert the velocity of the hull, in the frame of the hull, to ν = (u, v, w, r) in the heading frame {B}.

    Without this conversion, a tilt of 15° turns a quarter of the forward speed into heave.

    Args:
        velocity: linear velocity (…, 3) [m/s], as a Doppler velocity log on the hull measures it: ahead, left, up.
        rates: angular velocity p, q, r (…, 3) [rad/s], as an IMU on the hull measures it.
        roll, pitch: attitude (…) [rad], by the rotation R_z(ψ) R_y(pitch) R_x(roll); a positive pitch lowers the bow.

    Returns:
        ν (…, 4) [m/s, rad/s].

    Raises:
        InputError: the arrays have the wrong shape, or the pitch is not within ±90°.

    Example:
        >>> import numpy as np
        >>> from surctl.marine.vehicle import heading_velocity
        >>> heading_velocity([0.2, 0.0, 0.0], [0.0, 0.0, 0.1], roll=0.0, pitch=np.radians(15)).round(4).tolist()
        [0.1932, 0.0, -0.0518, 0.1035]
    """
    v, w = np.asarray(velocity, dtype=float), np.asarray(rates, dtype=float)
    for key, array in (("velocity", v), ("rates", w)):
        if array.shape[-1:] != (3,):
            raise InputError(f"has shape {array.shape}", key=key, remedy="give (3,), or (n, 3)")
    a, b = np.asarray(roll, dtype=float), np.asarray(pitch, dtype=float)
    if np.any(np.abs(b) >= np.pi / 2):
        raise InputError(
            "must be within 90 degrees", key="pitch", value=float(np.max(np.abs(b))), remedy="give radians"
        )
    across, up = np.cos(a) * v[..., 1] - np.sin(a) * v[..., 2], np.sin(a) * v[..., 1] + np.cos(a) * v[..., 2]
    ahead, up = np.cos(b) * v[..., 0] + np.sin(b) * up, np.cos(b) * up - np.sin(b) * v[..., 0]
    turn = (np.sin(a) * w[..., 1] + np.cos(a) * w[..., 2]) / np.cos(b)
    return np.stack(np.broadcast_arrays(ahead, across, up, turn), axis=-1)


def check_frame(frame: object, *, key: str = "frame", file: object = None) -> Frame:
    """Return the frame name if it is in `FRAMES`; otherwise raise InputError.

    Example:
        >>> from surctl.marine.vehicle import check_frame
        >>> check_frame("ned")
        'ned'
        >>> check_frame("nde")
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: frame = 'nde': is not known; give enu (ENU/FLU) or ned (NED/FRD)
    """
    if frame not in FRAMES:
        raise InputError("is not known", key=key, value=frame, file=file, remedy="give enu (ENU/FLU) or ned (NED/FRD)")
    return frame


def _four(key: str, value: ArrayLike) -> NDArray[np.float64]:
    values = np.asarray(value, dtype=float)
    if values.shape[-1:] != (4,):
        raise InputError(f"has shape {values.shape}", key=key, remedy="give (4,), or (n, 4)")
    return values
