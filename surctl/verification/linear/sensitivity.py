"""Sensitivity S = (I + L)⁻¹ and complementary sensitivity T = L (I + L)⁻¹ of several loops, over frequency."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.verification.linear.open_loop import OpenLoop

__all__ = ["Sensitivity", "sensitivity_of"]

Array = NDArray[np.float64]

_LOWEST, _POINTS = 1e-3, 200


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """The largest singular values of the sensitivity S and the complementary sensitivity T over frequency.

    Attributes:
        place: where the loops are opened.
        omega: frequencies (k,) [rad/s].
        S: (k,) largest singular value of S: the largest amplification of disturbances and model errors.
        T: (k,) largest singular value of T: the largest amplification of measurement noise and references.
    """

    place: str
    omega: Array
    S: Array
    T: Array

    def to_dict(self) -> dict[str, Any]:
        """The singular values and their peaks as plain data for JSON."""
        return {
            "place": self.place,
            "omega_rad_s": self.omega.tolist(),
            "S": self.S.tolist(),
            "T": self.T.tolist(),
            "peak_S": float(self.S.max()),
            "peak_T": float(self.T.max()),
        }


def sensitivity_of(loop: OpenLoop, place: str = "", *, highest: float) -> Sensitivity:
    """Compute the largest singular values of S and T of a stable loop, from 0.001 rad/s to `highest` [rad/s].

    Raises:
        InputError: the closed loop is unstable and therefore has no frequency response.

    Example:
        >>> import numpy as np
        >>> from surctl.verification.linear import OpenLoop, sensitivity_of
        >>> found = sensitivity_of(OpenLoop(*(np.array([[x]]) for x in (0.0, 1.0, 2.0, 0.0))), highest=100.0)
        >>> round(float(found.T[0]), 3), round(float(found.S[-1]), 3)  # 2/s
        (1.0, 1.0)
    """
    closed = loop.complementary()
    if not np.all(np.linalg.eigvals(closed.A).real < 0):
        raise InputError(
            "is unstable and has no frequency response", key="loop", value=place, remedy="lower the cruise speed"
        )
    omega = np.geomspace(_LOWEST, highest, _POINTS)
    T = closed.response(omega)
    S = np.eye(T.shape[-1]) - T
    return Sensitivity(place, omega, *(np.linalg.norm(m, 2, axis=(1, 2)) for m in (S, T)))
