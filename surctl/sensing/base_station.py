"""What the base station tells the robot: moving obstacles, and the robot's own position.

In this version without latency or loss; noise is white and Gaussian, from standard normal numbers that the caller
draws.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError

__all__ = ["BaseStation", "OwnState"]


@dataclass(frozen=True, kw_only=True)
class BaseStation:
    """Measures position and velocity of moving obstacles.

    Attributes:
        position_sd: standard deviation of each coordinate [m].
        velocity_sd: standard deviation of each component [m/s].
    """

    position_sd: float = 0.01
    velocity_sd: float = 0.01

    def __post_init__(self) -> None:
        """Check the values; InputError names the wrong one."""
        _check("base_station.position_sd", self.position_sd, unit="m")
        _check("base_station.velocity_sd", self.velocity_sd, unit="m/s")

    def observe(
        self, positions: NDArray[np.float64], velocities: NDArray[np.float64], *, noise: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Measured positions (K, 2) [m] and velocities (K, 2) [m/s] in {E} of K obstacles; K may be 0.

        Args:
            positions: (K, 2) [m] in {E}.
            velocities: (K, 2) [m/s] in {E}.
            noise: (K, 4) standard normal numbers, for x, y, and the velocity's.

        Raises:
            InputError: shapes that are not (K, 2), or differ, or noise that does not fit them.
        """
        where, speed = np.asarray(positions, dtype=float), np.asarray(velocities, dtype=float)
        if where.ndim != 2 or where.shape[1] != 2 or where.shape != speed.shape:
            raise InputError(
                f"have shapes {where.shape} and {speed.shape}", key="positions, velocities", remedy="(K, 2)"
            )
        if np.shape(noise) != (len(where), 4):
            raise InputError(f"has shape {np.shape(noise)}", key="noise", remedy=f"give ({len(where)}, 4)")
        return where + self.position_sd * noise[:, :2], speed + self.velocity_sd * noise[:, 2:]


@dataclass(frozen=True, kw_only=True)
class OwnState:
    """Measures the robot itself: position by the camera, yaw by the IMU; zeros give the truth.

    Attributes:
        position_sd: standard deviation of x, y and z [m].
        yaw_sd: standard deviation of ψ [rad].
    """

    position_sd: float = 0.01
    yaw_sd: float = 0.01

    def __post_init__(self) -> None:
        """Check the values; InputError names the wrong one."""
        _check("own_state.position_sd", self.position_sd, unit="m")
        _check("own_state.yaw_sd", self.yaw_sd, unit="rad")

    def measure(
        self, eta: NDArray[np.float64], nu: NDArray[np.float64], *, noise: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Measured η (4,) in {E} [m, rad] and ν (4,) in {B} [m/s, rad/s]; ν comes through without noise.

        Args:
            eta: (4,).
            nu: (4,).
            noise: (4,) standard normal numbers, for x, y, z and ψ.

        Raises:
            InputError: a shape that is not (4,).
        """
        pose, velocity = np.asarray(eta, dtype=float), np.array(nu, dtype=float)
        if pose.shape != (4,) or velocity.shape != (4,) or np.shape(noise) != (4,):
            raise InputError(
                f"have shapes {pose.shape}, {velocity.shape} and {np.shape(noise)}",
                key="eta, nu, noise",
                remedy="give (4,) each",
            )
        spread = np.array((self.position_sd, self.position_sd, self.position_sd, self.yaw_sd))
        return pose + spread * noise, velocity


def _check(key: str, value: float, *, unit: str) -> None:
    if not (isfinite(value) and value >= 0):
        raise InputError("must be at least 0", key=key, value=value, remedy=f"give {unit}")
