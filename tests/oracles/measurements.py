"""What base station, camera and IMU measure, in NumPy, and when their messages arrive."""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.sensing import BaseStation, Delivery, OwnState


def delayed(ring: NDArray[np.float64], now: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the value (n,) from k steps ago, and the updated ring buffer (k, n) of the last k values.

    Args:
        ring: (k, n) ring buffer of the last k values, newest first; with k = 0 there is no delay.
        now: (n,) present value.
    """
    known = np.vstack([np.reshape(now, (1, -1)), ring])
    return known[-1], known[:-1]


def observe(
    station: BaseStation, positions: NDArray[np.float64], velocities: NDArray[np.float64], *, noise: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the measured positions (K, 2) [m] and velocities (K, 2) [m/s] of K ≥ 0 obstacles in {E}.

    Args:
        positions: (K, 2) true positions [m] in {E}.
        velocities: (K, 2) true velocities [m/s] in {E}.
        noise: (K, 4) standard normal numbers, for x, y, and both velocity components.

    Raises:
        InputError: if `positions` or `velocities` is not (K, 2), or `noise` is not (K, 4).
    """
    where, speed = np.asarray(positions, dtype=float), np.asarray(velocities, dtype=float)
    if where.ndim != 2 or where.shape[1] != 2 or where.shape != speed.shape:
        raise InputError(
            f"have shapes {where.shape} and {speed.shape}", key="positions, velocities", remedy="give (K, 2) both"
        )
    if np.shape(noise) != (len(where), 4):
        raise InputError(f"has shape {np.shape(noise)}", key="noise", remedy=f"give ({len(where)}, 4)")
    return where + station.position_sd * noise[:, :2], speed + station.velocity_sd * noise[:, 2:]


def message(
    station: BaseStation, past: NDArray[np.float64], step: int, *, noise: NDArray[np.float64], chance: float, dt: float
) -> tuple[NDArray[np.float64], bool]:
    """Return the message (K, 6) about K obstacles that arrives at a control period, and whether one arrives.

    Without a message, all numbers are 0.

    Args:
        past: (K, 6) true states of the obstacles in {E} at the time of measurement, `messages.latency` earlier: x,
            y, radius, vx, vy, valid.
        step: number of the control period, from 0.
        noise: (K, 4) standard normal numbers, for x, y, and both velocity components.
        chance: a standard normal number that decides whether the whole message is lost.
        dt: control period [s].

    Raises:
        InputError: if an argument has a wrong shape, or period or latency is not a multiple of dt.
    """
    rows = np.array(past, dtype=float)
    if rows.ndim != 2 or rows.shape[1] != 6:
        raise InputError(f"has shape {rows.shape}", key="past", remedy="give (K, 6)")
    rows[:, :2], rows[:, 3:5] = observe(station, rows[:, :2], rows[:, 3:5], noise=noise)
    rows[rows[:, 5] < 0.5] = 0.0
    arrived = arrives(station.messages, step, chance=chance, dt=dt)
    return (rows if arrived else np.zeros_like(rows)), arrived


def fix(
    own: OwnState, past: NDArray[np.float64], step: int, *, noise: NDArray[np.float64], dt: float
) -> tuple[NDArray[np.float64], bool]:
    """Return the position fix (3,) [m] in {E} that arrives at a control period, and whether one arrives.

    Without a fix, the three numbers are 0.

    Args:
        past: (3,) true x, y, z of the robot [m] in {E} at the time of measurement, `fixes.latency` earlier.
        step: number of the control period, from 0.
        noise: (4,) standard normal numbers: three for x, y, z, and one that decides whether the fix is lost.
        dt: control period [s].

    Raises:
        InputError: if an argument has a wrong shape, or period or latency is not a multiple of dt.
    """
    place = np.asarray(past, dtype=float)
    if place.shape != (3,) or np.shape(noise) != (4,):
        raise InputError(
            f"have shapes {place.shape} and {np.shape(noise)}", key="past, noise", remedy="give (3,) and (4,)"
        )
    arrived = arrives(own.fixes, step, chance=float(noise[3]), dt=dt)
    return (place + own.position_sd * noise[:3] if arrived else np.zeros(3)), arrived


def imu(
    own: OwnState, eta: NDArray[np.float64], nu: NDArray[np.float64], *, noise: NDArray[np.float64]
) -> tuple[float, float]:
    """Return the measured yaw ψ [rad] and yaw rate r [rad/s].

    `eta` (4,) is the true pose x, y, z, ψ; `nu` (4,) is the true velocity u, v, w, r; `noise` holds two standard
    normal numbers.
    """
    if np.shape(eta) != (4,) or np.shape(nu) != (4,) or np.shape(noise) != (2,):
        raise InputError(
            f"have shapes {np.shape(eta)}, {np.shape(nu)} and {np.shape(noise)}",
            key="eta, nu, noise",
            remedy="give (4,), (4,) and (2,)",
        )
    return float(eta[3] + own.yaw_sd * noise[0]), float(nu[3] + own.rate_sd * noise[1])


def measure(
    own: OwnState, eta: NDArray[np.float64], nu: NDArray[np.float64], *, noise: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the measured pose η (4,) in {E} [m, rad], and the noise-free velocity ν (4,) in {B} [m/s, rad/s].

    Args:
        eta: (4,) true pose η: x, y, z, ψ.
        nu: (4,) true velocity ν: u, v, w, r.
        noise: (4,) standard normal numbers, for x, y, z and ψ.

    Raises:
        InputError: if the shape of an argument is not (4,).
    """
    pose, velocity = np.asarray(eta, dtype=float), np.array(nu, dtype=float)
    if pose.shape != (4,) or velocity.shape != (4,) or np.shape(noise) != (4,):
        raise InputError(
            f"have shapes {pose.shape}, {velocity.shape} and {np.shape(noise)}",
            key="eta, nu, noise",
            remedy="give (4,) each",
        )
    spread = np.array((own.position_sd, own.position_sd, own.position_sd, own.yaw_sd))
    return pose + spread * noise, velocity


def arrives(delivery: Delivery, step: int, *, chance: float, dt: float) -> bool:
    """Return whether a message that was measured `late(dt)` control periods before arrives at period `step`.

    The first measurement takes place at control period 0.

    Args:
        step: number of the control period, from 0.
        chance: a standard normal number that decides the loss, drawn anew for each control period.
        dt: control period [s].

    Raises:
        InputError: if period or latency is not a multiple of dt.
    """
    measured = step - delivery.late(dt)
    due = measured >= 0 and measured % delivery.every(dt) == 0
    lost = any(ceil(a / dt - 1e-9) <= measured < ceil(b / dt - 1e-9) for a, b in delivery.gaps)
    return due and chance >= delivery.lost_below and not lost
