"""What the base station tells the robot: moving obstacles, and the robot's own position.

`observe` and `measure` are at once and never lost; `message` and `fix` come late, at a period, and some never. What was
so long ago, the caller knows: it keeps it (`delayed`), or can say where an obstacle was. Noise is white and Gaussian,
from standard normal numbers that the caller draws. What ends in `_symbols` is the same for a compiled loop.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.sensing.localisation.delivery import Delivery

__all__ = ["BaseStation", "OwnState"]


@dataclass(frozen=True, kw_only=True)
class BaseStation:
    """Measures position and velocity of moving obstacles.

    Attributes:
        position_sd: standard deviation of each coordinate [m].
        velocity_sd: standard deviation of each component [m/s].
        messages: how `message` reaches the robot.
    """

    position_sd: float = 0.01
    velocity_sd: float = 0.01
    messages: Delivery = field(default_factory=Delivery)

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

    def message(
        self, then: NDArray[np.float64], step: int, *, noise: NDArray[np.float64], chance: float, dt: float
    ) -> tuple[NDArray[np.float64], bool]:
        """The message (K, 6) that arrives at a control period, and whether one does; zeros when none.

        Args:
            then: (K, 6) obstacles as they were `messages.latency` ago in {E}: x, y, radius, vx, vy, valid.
            step: number of the control period, from 0.
            noise: (K, 4) standard normal numbers, for x, y, and the velocity's.
            chance: one more, for the loss of the whole message.
            dt: control period [s].

        Raises:
            InputError: a shape that does not fit, or a delivery that is not of whole periods.
        """
        rows = np.array(then, dtype=float)
        if rows.ndim != 2 or rows.shape[1] != 6:
            raise InputError(f"has shape {rows.shape}", key="then", remedy="give (K, 6)")
        rows[:, :2], rows[:, 3:5] = self.observe(rows[:, :2], rows[:, 3:5], noise=noise)
        rows[rows[:, 5] < 0.5] = 0.0
        arrived = self.messages.arrives(step, chance=chance, dt=dt)
        return (rows if arrived else np.zeros_like(rows)), arrived

    def message_symbols(
        self, then: ca.SX, step: ca.SX, *, noise: ca.SX, chance: ca.SX, dt: float
    ) -> tuple[ca.SX, ca.SX]:
        """`message` in symbols: (K, 6), and 0 or 1."""
        arrived = self.messages.arrives_symbols(step, chance=chance, dt=dt)
        place, speed = then[:, :2] + self.position_sd * noise[:, :2], then[:, 3:5] + self.velocity_sd * noise[:, 2:]
        rows = ca.horzcat(place, then[:, 2], speed, then[:, 5])
        received = [ca.if_else(ca.logic_and(arrived, rows[k, 5] >= 0.5), rows[k, :], 0.0) for k in range(rows.shape[0])]
        return ca.vertcat(ca.SX(0, 6), *received), arrived


@dataclass(frozen=True, kw_only=True)
class OwnState:
    """Measures the robot itself: position by the camera, yaw and yaw rate by the IMU; zeros give the truth.

    Attributes:
        position_sd: standard deviation of x, y and z [m].
        yaw_sd: standard deviation of ψ [rad].
        rate_sd: standard deviation of r [rad/s] (*chosen*).
        fixes: how `fix` reaches the robot.
    """

    position_sd: float = 0.01
    yaw_sd: float = 0.01
    rate_sd: float = 0.005
    fixes: Delivery = field(default_factory=Delivery)

    def __post_init__(self) -> None:
        """Check the values; InputError names the wrong one."""
        _check("own_state.position_sd", self.position_sd, unit="m")
        _check("own_state.yaw_sd", self.yaw_sd, unit="rad")
        _check("own_state.rate_sd", self.rate_sd, unit="rad/s")

    def fix(
        self, then: NDArray[np.float64], step: int, *, noise: NDArray[np.float64], dt: float
    ) -> tuple[NDArray[np.float64], bool]:
        """The fix (3,) [m] in {E} that arrives at a control period, and whether one does; zeros when none.

        Args:
            then: (3,) x, y, z as they were `fixes.latency` ago [m].
            step: number of the control period, from 0.
            noise: (4,) standard normal numbers, for x, y, z and the loss.
            dt: control period [s].

        Raises:
            InputError: a shape that does not fit, or a delivery that is not of whole periods.
        """
        place = np.asarray(then, dtype=float)
        if place.shape != (3,) or np.shape(noise) != (4,):
            raise InputError(
                f"have shapes {place.shape} and {np.shape(noise)}", key="then, noise", remedy="give (3,) and (4,)"
            )
        arrived = self.fixes.arrives(step, chance=float(noise[3]), dt=dt)
        return (place + self.position_sd * noise[:3] if arrived else np.zeros(3)), arrived

    def fix_symbols(self, then: ca.SX, step: ca.SX, *, noise: ca.SX, dt: float) -> tuple[ca.SX, ca.SX]:
        """`fix` in symbols: (3,), and 0 or 1."""
        arrived = self.fixes.arrives_symbols(step, chance=noise[3], dt=dt)
        return ca.if_else(arrived, then + self.position_sd * noise[:3], 0.0), arrived

    def imu(
        self, eta: NDArray[np.float64], nu: NDArray[np.float64], *, noise: NDArray[np.float64]
    ) -> tuple[float, float]:
        """Measured ψ [rad] and r [rad/s], of η (4,) and ν (4,), with two standard normal numbers."""
        if np.shape(eta) != (4,) or np.shape(nu) != (4,) or np.shape(noise) != (2,):
            raise InputError(
                f"have shapes {np.shape(eta)}, {np.shape(nu)} and {np.shape(noise)}",
                key="eta, nu, noise",
                remedy="give (4,), (4,) and (2,)",
            )
        return float(eta[3] + self.yaw_sd * noise[0]), float(nu[3] + self.rate_sd * noise[1])

    def imu_symbols(self, eta: ca.SX, nu: ca.SX, *, noise: ca.SX) -> tuple[ca.SX, ca.SX]:
        """`imu` in symbols."""
        return eta[3] + self.yaw_sd * noise[0], nu[3] + self.rate_sd * noise[1]

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
