"""The scenario's frame {E} and the autopilot's local frame NED."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import cos, isfinite, pi, radians, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.marine.vehicle import heading_velocity

__all__ = ["Site", "parse_site"]

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Site:
    """Place of the autopilot's local NED frame in the scenario's frame {E}.

    Attributes:
        x, y: position of the origin of NED in {E} [m].
        bearing: compass direction of the x axis of {E} [rad]; π/2: the x axis points east.
    """

    x: float = 0.0
    y: float = 0.0
    bearing: float = pi / 2

    @property
    def turn(self) -> float:
        """Angle [rad] by which a vector in ENU is rotated counter-clockwise to get its coordinates in {E}."""
        return self.bearing - pi / 2

    def pose(self, ned: Iterable[float]) -> Vector:
        """Return the pose η (4,) in {E} of a pose north, east, down [m], ψ clockwise from north [rad]."""
        north, east, down, yaw = (float(v) for v in ned)
        c, s = cos(self.turn), sin(self.turn)
        return np.array([self.x + c * east - s * north, self.y + s * east + c * north, -down, self.bearing - yaw])

    def to_ned(self, eta: Iterable[float]) -> Vector:
        """Return the pose in NED (4,) of a pose η in {E}; inverse of `pose`."""
        x, y, z, psi = (float(v) for v in eta)
        c, s = cos(self.turn), sin(self.turn)
        east, north = c * (x - self.x) + s * (y - self.y), c * (y - self.y) - s * (x - self.x)
        return np.array([north, east, -z, self.bearing - psi])

    def velocity(self, ned: Iterable[float]) -> Vector:
        """Return the velocity (3,) in {E} of a velocity north, east, down [m/s]."""
        north, east, down = (float(v) for v in ned)
        c, s = cos(self.turn), sin(self.turn)
        return np.array([c * east - s * north, s * east + c * north, -down])

    def velocity_to_ned(self, velocity: Iterable[float]) -> Vector:
        """Return the velocity in NED (3,) of a velocity in {E}; inverse of `velocity`."""
        x, y, z = (float(v) for v in velocity)
        c, s = cos(self.turn), sin(self.turn)
        return np.array([c * y - s * x, c * x + s * y, -z])

    def body(self, eta: Vector, velocity: Iterable[float], yaw_rate: float) -> Vector:
        """Return ν (4,) in {B} of a velocity (3,) in {E} [m/s] and a yaw rate [rad/s], counter-clockwise from above."""
        vx, vy, vz = (float(v) for v in velocity)
        c, s = cos(eta[3]), sin(eta[3])
        return np.array([c * vx + s * vy, c * vy - s * vx, vz, yaw_rate])


def yaw_rate(roll: float, pitch: float, rates: tuple[float, float, float]) -> float:
    """Return ψ̇ [rad/s], counter-clockwise from above, of a hull with attitude [rad] and rates [rad/s] in FRD."""
    if not abs(pitch) < 0.5 * pi:
        return float("nan")
    return -(sin(roll) * rates[1] + cos(roll) * rates[2]) / cos(pitch)


def body_velocity(velocity: ArrayLike, rates: ArrayLike, *, roll: float, pitch: float) -> Vector:
    """Return ν (4,) in the heading frame {B} of velocity and rates in the hull's FRD frame (Fossen 2021, 2.1)."""
    v, w = np.asarray(velocity, dtype=float), np.asarray(rates, dtype=float)
    flip = np.array([1.0, -1.0, -1.0])
    return heading_velocity(v * flip, w * flip, roll=roll, pitch=-pitch)


def parse_site(text: str, *, key: str = "--origin") -> Site:
    """Return the site of a text "X,Y,DEG": origin of NED in {E} [m], compass direction of the x axis of {E} [deg].

    Raises:
        InputError: the text has another form.

    Example:
        >>> from surctl.marine.bridge import parse_site
        >>> site = parse_site("0.5,2.5,0")  # the autopilot started at (0.5, 2.5), and the x axis points north
        >>> site.pose([2.0, 0.0, 0.15, 0.0]).round(3).tolist()  # 2 m north of its start, heading north
        [2.5, 2.5, -0.15, 0.0]
    """
    try:
        x, y, bearing = (float(word) for word in text.split(","))
    except ValueError:
        x = y = bearing = float("nan")
    if not all(map(isfinite, (x, y, bearing))):
        raise InputError(
            "is not a place and a direction", key=key, value=text, remedy='write "X,Y,DEG", such as 0.5,2.5,90'
        )
    return Site(x, y, radians(bearing))
