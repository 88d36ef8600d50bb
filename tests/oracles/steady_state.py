"""Steady deviations of the own-state filter for a robot at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.marine.sensing import OwnStateFilter

__all__ = ["ahead", "steady_covariance", "steady_sd"]

Matrix = NDArray[np.float64]

_RECURSION_STEPS = 4000  # the slowest error decays within a few hundred


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


def steady_sd(own: OwnStateFilter, every: int) -> tuple[float, float]:
    """Return steady standard deviations of position [m] and velocity [m/s] when a fix arrives, one in `every` steps."""
    P = steady_covariance(*own.step, fix_variance=own.position_sd**2, every=every)
    whole, grown = ahead(*own.step, own.late)
    now = whole @ P @ whole.T + grown
    return float(np.sqrt(now[0, 0])), float(np.sqrt(now[1, 1]))
