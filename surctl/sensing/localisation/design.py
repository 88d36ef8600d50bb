"""The constant matrices of the own-state filter: how its errors move, grow and settle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["ahead", "growth", "steady_covariance", "transition", "white", "yaw_gains"]

Matrix = NDArray[np.float64]

_RECURSION_STEPS = 4000  # steps; the slowest error decays within some hundred


def transition(dt: float, disturbance_time: float) -> Matrix:
    """Φ (3, 3) of one axis in {E}: position, velocity, disturbing acceleration, over dt [s].

    The disturbance is constant within a step and decays with `disturbance_time` [s] from one to the next
    (first-order Gauss-Markov process).
    """
    return np.array([[1.0, dt, 0.5 * dt * dt], [0.0, 1.0, dt], [0.0, 0.0, np.exp(-dt / disturbance_time)]])


def white(dt: float, size: float) -> Matrix:
    """What white acceleration noise [m/s^1.5] adds to the covariance (3, 3) of one axis in a step."""
    return size**2 * np.array([[dt**3 / 3, dt**2 / 2, 0.0], [dt**2 / 2, dt, 0.0], [0.0, 0.0, 0.0]])


def growth(dt: float, *, acceleration_noise: float, disturbance_sd: float, disturbance_time: float) -> Matrix:
    """Q (3, 3) of one axis and step: white acceleration noise [m/s^1.5], and what keeps the disturbance's sd [m/s²]."""
    fresh = disturbance_sd**2 * (1.0 - np.exp(-2.0 * dt / disturbance_time))
    return white(dt, acceleration_noise) + np.diag([0.0, 0.0, fresh])


def ahead(step: Matrix, noise: Matrix, steps: int) -> tuple[Matrix, Matrix]:
    """Φ and Q of `steps` steps together."""
    whole, grown = np.eye(len(step)), np.zeros_like(step)
    for _ in range(steps):
        whole, grown = step @ whole, step @ grown @ step.T + noise
    return whole, grown


def steady_covariance(step: Matrix, noise: Matrix, *, fix_variance: float, every: int) -> Matrix:
    """Covariance (3, 3) right after a fix when one comes every `every` steps for long: the Riccati recursion's end."""
    whole, grown = ahead(step, noise, every)
    P = np.diag([fix_variance, 1.0, noise[2, 2] / (1.0 - step[2, 2] ** 2)])
    for _ in range(_RECURSION_STEPS):
        P = whole @ P @ whole.T + grown
        P = P - np.outer(P[:, 0], P[0, :]) / (P[0, 0] + fix_variance)
    return P


def yaw_gains(dt: float, *, yaw_sd: float, rate_sd: float, acceleration_noise: float) -> Matrix:
    """Steady Kalman gains (2, 2) of yaw and yaw rate (rows) for their measured values (columns), every dt [s].

    Args:
        dt: [s].
        yaw_sd: [rad].
        rate_sd: [rad/s].
        acceleration_noise: white, of the yaw acceleration that the model does not know [rad/s^1.5].
    """
    F, Q = np.array([[1.0, dt], [0.0, 1.0]]), white(dt, acceleration_noise)[:2, :2]
    R = np.diag([yaw_sd**2, rate_sd**2])
    P, K = R.copy(), np.zeros((2, 2))
    for _ in range(_RECURSION_STEPS):
        P = F @ P @ F.T + Q
        K = P @ np.linalg.inv(P + R)
        P = P - K @ P
    return K
