"""Measurements of base station, camera and IMU: noise, and period, latency, loss and gaps of messages.

Messages and fixes are periodic, and arrive late or are lost. The caller passes the true state at the earlier time of
measurement, and the standard normal numbers of the noise. Whether a message arrives depends only on the number of the
control period and on a random number.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import ceil, isfinite
from statistics import NormalDist

import casadi as ca

from surctl.errors import InputError, check_number

_ALWAYS = 1e300  # bound that no standard normal number reaches
_ROUNDING = 1e-9  # [1] tolerance of a number of steps


@dataclass(frozen=True, kw_only=True)
class Delivery:
    """Period, latency and losses of one kind of message to the robot.

    Attributes:
        period: time between two measurements [s] (design choice).
        latency: time from a measurement to its arrival [s] (design choice).
        loss: probability that a message is lost, independent for each message.
        gaps: intervals (start, end) [s] of the run without measurements; messages that were measured before still
            arrive.
    """

    period: float = 0.1
    latency: float = 0.1
    loss: float = 0.0
    gaps: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        check_number("delivery.period", self.period, unit="s")
        check_number("delivery.latency", self.latency, unit="s", zero=True)
        if not 0 <= self.loss <= 1:
            raise InputError("must lie between 0 and 1", key="delivery.loss", value=self.loss, remedy="give 0 to 1")
        gaps = tuple(tuple(float(end) for end in gap) for gap in self.gaps)
        for gap in gaps:
            if len(gap) != 2 or not (isfinite(gap[1]) and 0 <= gap[0] < gap[1]):
                raise InputError("is not an interval", key="delivery.gaps", value=gap, remedy="give (start, end) in s")
        object.__setattr__(self, "gaps", gaps)

    @property
    def lost_below(self) -> float:
        """Threshold of loss: a message is lost if the standard normal number drawn for it lies below this value."""
        if self.loss in (0, 1):
            return _ALWAYS if self.loss else -_ALWAYS
        return NormalDist().inv_cdf(self.loss)

    def late(self, dt: float) -> int:
        """Return the number of control periods dt [s] from measurement to arrival; InputError if not a whole number."""
        return whole_steps("delivery.latency", self.latency, dt=dt)

    def every(self, dt: float) -> int:
        """Return the number of control periods dt [s] between two measurements; InputError if not a whole number."""
        return whole_steps("delivery.period", self.period, dt=dt)

    def arrives_symbols(self, step: ca.SX, *, chance: ca.SX, dt: float) -> ca.SX:
        """Return 1 if a message measured `late(dt)` control periods before arrives at period `step` (from 0), else 0.

        The first measurement takes place at control period 0. `chance` is a standard normal number that decides the
        loss.

        Raises:
            InputError: if period or latency is not a multiple of dt.
        """
        measured, every = step - self.late(dt), self.every(dt)
        there = ca.logic_and(measured >= 0, measured - every * ca.floor(measured / every) == 0)
        there = ca.logic_and(there, chance >= self.lost_below)
        for gap in self.gaps:
            start, end = (ceil(time / dt - _ROUNDING) for time in gap)  # first control periods in and after the gap
            there = ca.logic_and(there, ca.logic_or(measured < start, measured >= end))
        return there


def whole_steps(key: str, time: float, *, dt: float) -> int:
    """Return a time [s] as a number of control periods of `dt` [s]."""
    count = round(time / dt)
    if abs(time / dt - count) > 1e-6:
        raise InputError(f"is not a multiple of the control period of {dt:g} s", key=key, value=time)
    return count


def delayed_symbols(ring: ca.SX, now: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the value (n, 1) from k steps ago, and the updated ring (k, n) of the last k values, newest first."""
    known = ca.vertcat(now.T, ring)
    return known[-1, :].T, known[:-1, :]


@dataclass(frozen=True, kw_only=True)
class BaseStation:
    """The base station, which measures position and velocity of moving obstacles.

    Attributes:
        position_sd: standard deviation of each measured coordinate [m].
        velocity_sd: standard deviation of each measured velocity component [m/s].
        messages: period, latency and loss probability of the messages of `message_symbols`.
    """

    position_sd: float = 0.01
    velocity_sd: float = 0.01
    messages: Delivery = field(default_factory=Delivery)

    def __post_init__(self) -> None:
        check_number("base_station.position_sd", self.position_sd, unit="m", zero=True)
        check_number("base_station.velocity_sd", self.velocity_sd, unit="m/s", zero=True)

    def message_symbols(
        self, past: ca.SX, step: ca.SX, *, noise: ca.SX, chance: ca.SX, dt: float
    ) -> tuple[ca.SX, ca.SX]:
        """Return the message (K, 6) about K obstacles, and 1 if one arrives at a control period, else 0.

        Without a message, all numbers are 0.

        Args:
            past: (K, 6) true states of the obstacles in {E}, `messages.latency` earlier: x, y, radius, vx, vy, valid.
            noise: (K, 4) standard normal numbers, for x, y, and both velocity components.
            chance: a standard normal number that decides whether the whole message is lost.
        """
        arrived = self.messages.arrives_symbols(step, chance=chance, dt=dt)
        place, speed = past[:, :2] + self.position_sd * noise[:, :2], past[:, 3:5] + self.velocity_sd * noise[:, 2:]
        rows = ca.horzcat(place, past[:, 2], speed, past[:, 5])
        received = [ca.if_else(ca.logic_and(arrived, rows[k, 5] >= 0.5), rows[k, :], 0.0) for k in range(rows.shape[0])]
        return ca.vertcat(ca.SX(0, 6), *received), arrived


@dataclass(frozen=True, kw_only=True)
class OwnState:
    """Measurement of the robot's own state: position by the camera, yaw and yaw rate by the IMU.

    Attributes:
        position_sd: standard deviation of measured x, y and z [m]; 0 gives exact values.
        yaw_sd: standard deviation of the measured yaw ψ [rad]; 0 gives exact values.
        rate_sd: standard deviation of the measured yaw rate r [rad/s] (design choice); 0 gives exact values.
        fixes: period, latency and loss probability of the position fixes of `fix_symbols`.
    """

    position_sd: float = 0.01
    yaw_sd: float = 0.01
    rate_sd: float = 0.005
    fixes: Delivery = field(default_factory=Delivery)

    def __post_init__(self) -> None:
        check_number("own_state.position_sd", self.position_sd, unit="m", zero=True)
        check_number("own_state.yaw_sd", self.yaw_sd, unit="rad", zero=True)
        check_number("own_state.rate_sd", self.rate_sd, unit="rad/s", zero=True)

    def fix_symbols(self, past: ca.SX, step: ca.SX, *, noise: ca.SX, dt: float) -> tuple[ca.SX, ca.SX]:
        """Return the position fix (3,) [m] in {E}, and 1 if one arrives at this period, else 0; without one, zeros.

        `past` is the true x, y, z (3,) `fixes.latency` earlier; `noise` (4,) are standard normal numbers, three for x,
        y, z, and one that decides whether the fix is lost.
        """
        arrived = self.fixes.arrives_symbols(step, chance=noise[3], dt=dt)
        return ca.if_else(arrived, past + self.position_sd * noise[:3], 0.0), arrived

    def imu_symbols(self, eta: ca.SX, nu: ca.SX, *, noise: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the measured yaw ψ [rad] and yaw rate r [rad/s].

        `eta` (4,) is the true pose x, y, z, ψ; `nu` (4,) is the true velocity u, v, w, r; `noise` (2,) holds standard
        normal numbers.
        """
        return eta[3] + self.yaw_sd * noise[0], nu[3] + self.rate_sd * noise[1]
