"""The own-state filter's matrices against simulated random walks and an independent Riccati solver."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from surctl.marine.sensing import OwnStateFilter
from tests.oracles.steady_state import ahead, steady_covariance

DT = 0.05
DRIFTING = OwnStateFilter(dt=DT, acceleration_noise=0.01, disturbance_sd=0.03, disturbance_time=2.0)


def test_white_noise_is_that_of_its_density():
    """Velocity and position after a step of many small ones, each with noise of variance size² / (its length)."""
    rng, parts, size = np.random.default_rng(0), 50, 0.3
    h = DT / parts
    acceleration = size / np.sqrt(h) * rng.standard_normal((40_000, parts))
    velocity = np.cumsum(acceleration * h, axis=1)
    position = np.sum(velocity * h, axis=1)
    measured = np.cov(position, velocity[:, -1])
    white = OwnStateFilter(dt=DT, model_noise=size).model_covariance
    assert measured == pytest.approx(white[:2, :2], rel=0.05)
    assert not white[2].any()


def test_the_disturbance_keeps_its_deviation_and_forgets_itself():
    step, noise = DRIFTING.step
    phi, Q = ahead(step, noise, 40)
    assert phi[2, 2] == pytest.approx(np.exp(-1.0))
    assert phi[2, 2] ** 2 * 0.03**2 + Q[2, 2] == pytest.approx(0.03**2)
    assert phi[:2, :2] == pytest.approx(np.array([[1.0, 2.0], [0.0, 1.0]]))
    assert Q[1, 1] > 40 * noise[1, 1] and np.linalg.eigvalsh(Q).min() > 0


def test_the_settled_covariance_solves_its_riccati_equation():
    step, noise = DRIFTING.step
    phi, Q = ahead(step, noise, 2)
    H, R = np.array([[1.0, 0.0, 0.0]]), np.array([[1e-4]])
    before = solve_discrete_are(phi.T, H.T, Q, R)
    after = before - before @ H.T @ H @ before / (before[0, 0] + 1e-4)
    assert steady_covariance(step, noise, fix_variance=1e-4, every=2) == pytest.approx(after, rel=1e-6)


def test_the_yaw_gains_are_kalman_s():
    own = OwnStateFilter(dt=DT, yaw_sd=0.01, rate_sd=0.005, yaw_acceleration_noise=0.1, model_noise=0.1)
    F, Q, R = np.array([[1.0, DT], [0.0, 1.0]]), own.model_covariance[:2, :2], np.diag([1e-4, 2.5e-5])
    P = solve_discrete_are(F.T, np.eye(2), Q, R)
    K = P @ np.linalg.inv(P + R)
    assert own.yaw_gains == pytest.approx(K, rel=1e-8)
