from __future__ import annotations

import math

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.sensing import BaseStation, OwnState


def test_obstacles_are_measured_with_the_stated_noise():
    rng = np.random.default_rng(0)
    where, speed = np.tile([1.0, 2.0], (20_000, 1)), np.tile([0.1, -0.2], (20_000, 1))
    station = BaseStation(position_sd=0.01, velocity_sd=0.02)
    seen, moving = station.observe(where, speed, noise=rng.standard_normal((len(where), 4)))
    assert np.std(seen - where, axis=0) == pytest.approx([0.01, 0.01], rel=0.03)
    assert np.std(moving - speed, axis=0) == pytest.approx([0.02, 0.02], rel=0.03)
    assert np.abs(np.corrcoef((seen - where)[:, 0], (moving - speed)[:, 0])[0, 1]) < 0.03
    again, _ = station.observe(where, speed, noise=np.random.default_rng(0).standard_normal((len(where), 4)))
    assert np.array_equal(again, seen)


def test_no_obstacle_is_no_measurement():
    seen, moving = BaseStation().observe(np.zeros((0, 2)), np.zeros((0, 2)), noise=np.zeros((0, 4)))
    assert seen.shape == moving.shape == (0, 2)


def test_own_state_noise_and_truth():
    eta, nu = np.array([1.0, 2.0, -0.15, 0.3]), np.array([0.2, 0.0, 0.0, 0.1])
    rng = np.random.default_rng(0)
    own = OwnState(position_sd=0.01, yaw_sd=0.02)
    errors = np.array([own.measure(eta, nu, noise=rng.standard_normal(4))[0] - eta for _ in range(5000)])
    assert errors.std(axis=0) == pytest.approx([0.01, 0.01, 0.01, 0.02], rel=0.05)
    pose, velocity = OwnState(position_sd=0.0, yaw_sd=0.0).measure(eta, nu, noise=rng.standard_normal(4))
    assert np.array_equal(pose, eta) and np.array_equal(velocity, nu)
    velocity[0] = 9.0
    assert nu[0] == 0.2


@pytest.mark.parametrize(
    "build",
    [
        lambda: BaseStation(position_sd=-0.1),
        lambda: BaseStation(velocity_sd=math.nan),
        lambda: OwnState(yaw_sd=-1.0),
        lambda: BaseStation().observe(np.zeros((2, 2)), np.zeros((3, 2)), noise=np.zeros((2, 4))),
        lambda: OwnState().measure(np.zeros(3), np.zeros(4), noise=np.zeros(4)),
    ],
)
def test_mistakes_are_refused(build):
    with pytest.raises(InputError):
        build()
