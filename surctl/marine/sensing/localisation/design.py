"""The constant matrices of the own-state filter: transition, process noise, steady covariance, and steady gains."""

from __future__ import annotations

from math import exp  # NumPy's differs in the last bit between processors

import numpy as np
from numpy.typing import NDArray

__all__ = ["ahead", "growth", "steady_covariance", "transition", "white", "yaw_gains"]

Matrix = NDArray[np.float64]

_RECURSION_STEPS = 4000  # steps; the slowest error decays within a few hundred


def transition(dt: float, disturbance_time: float) -> Matrix:
    """Return the transition matrix Φ (3, 3) over a step dt [s] for one axis of {E}.

    The states are position, velocity and disturbance acceleration along the axis.

    The disturbance is constant within a step and decays from step to step with the time constant `disturbance_time`
    [s] (first-order Gauss-Markov process).
    """
    return np.array([[1.0, dt, 0.5 * dt * dt], [0.0, 1.0, dt], [0.0, 0.0, exp(-dt / disturbance_time)]])


def white(dt: float, size: float) -> Matrix:
    """Return the covariance (3, 3) that white acceleration noise [m/s^1.5] adds to the states of one axis in a step."""
    return size**2 * np.array([[dt**3 / 3, dt**2 / 2, 0.0], [dt**2 / 2, dt, 0.0], [0.0, 0.0, 0.0]])


def growth(dt: float, *, acceleration_noise: float, disturbance_sd: float, disturbance_time: float) -> Matrix:
    """Return the process-noise covariance Q (3, 3) of one axis for one step.

    Q is the sum of two parts: white acceleration noise [m/s^1.5], and the noise that keeps the standard deviation of
    the disturbance acceleration [m/s²] constant.
    """
    fresh = disturbance_sd**2 * (1.0 - exp(-2.0 * dt / disturbance_time))
    return white(dt, acceleration_noise) + np.diag([0.0, 0.0, fresh])


def ahead(step: Matrix, noise: Matrix, steps: int) -> tuple[Matrix, Matrix]:
    """Return the transition matrix Φ and the process-noise covariance Q over a number `steps` of steps."""
    whole, grown = np.eye(len(step)), np.zeros_like(step)
    for _ in range(steps):
        whole, grown = step @ whole, step @ grown @ step.T + noise
    return whole, grown


def steady_covariance(step: Matrix, noise: Matrix, *, fix_variance: float, every: int) -> Matrix:
    """Return the steady covariance (3, 3) of the estimate just after a fix, with one fix per `every` steps.

    The function iterates the Riccati recursion.
    """
    whole, grown = ahead(step, noise, every)
    P = np.diag([fix_variance, 1.0, noise[2, 2] / (1.0 - step[2, 2] ** 2)])
    for _ in range(_RECURSION_STEPS):
        before = P
        P = whole @ P @ whole.T + grown
        P = P - np.outer(P[:, 0], P[0, :]) / (P[0, 0] + fix_variance)
        if np.array_equal(P, before):  # no further step changes it
            break
    return P


def yaw_gains(dt: float, *, yaw_sd: float, rate_sd: float, acceleration_noise: float) -> Matrix:
    """Return the steady Kalman gains (2, 2): rows for estimated, columns for measured yaw and yaw rate.

    Args:
        dt: time between two measurements [s].
        yaw_sd: standard deviation of measured yaw [rad].
        rate_sd: standard deviation of measured yaw rate [rad/s].
        acceleration_noise: white noise [rad/s^1.5] that represents the unmodelled yaw acceleration.
    """
    F, Q = np.array([[1.0, dt], [0.0, 1.0]]), white(dt, acceleration_noise)[:2, :2]
    R = np.diag([yaw_sd**2, rate_sd**2])
    P, K = R.copy(), np.zeros((2, 2))
    for _ in range(_RECURSION_STEPS):
        before = P
        P = F @ P @ F.T + Q
        K = P @ np.linalg.inv(P + R)
        P = P - K @ P
        if np.array_equal(P, before):
            break
    return K
