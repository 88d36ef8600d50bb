from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.sensing import BaseStation, Delivery, OwnState
from tests.oracles import measurements


def test_obstacles_are_measured_with_the_stated_noise():
    rng = np.random.default_rng(0)
    where, speed = np.tile([1.0, 2.0], (20_000, 1)), np.tile([0.1, -0.2], (20_000, 1))
    station = BaseStation(position_sd=0.01, velocity_sd=0.02)
    seen, moving = measurements.observe(station, where, speed, noise=rng.standard_normal((len(where), 4)))
    assert np.std(seen - where, axis=0) == pytest.approx([0.01, 0.01], rel=0.03)
    assert np.std(moving - speed, axis=0) == pytest.approx([0.02, 0.02], rel=0.03)
    assert np.abs(np.corrcoef((seen - where)[:, 0], (moving - speed)[:, 0])[0, 1]) < 0.03
    again, _ = measurements.observe(
        station, where, speed, noise=np.random.default_rng(0).standard_normal((len(where), 4))
    )
    assert np.array_equal(again, seen)


def test_no_obstacle_is_no_measurement():
    seen, moving = measurements.observe(BaseStation(), np.zeros((0, 2)), np.zeros((0, 2)), noise=np.zeros((0, 4)))
    assert seen.shape == moving.shape == (0, 2)


def test_own_state_noise_and_truth():
    eta, nu = np.array([1.0, 2.0, -0.15, 0.3]), np.array([0.2, 0.0, 0.0, 0.1])
    rng = np.random.default_rng(0)
    own = OwnState(position_sd=0.01, yaw_sd=0.02)
    errors = np.array([measurements.measure(own, eta, nu, noise=rng.standard_normal(4))[0] - eta for _ in range(5000)])
    assert errors.std(axis=0) == pytest.approx([0.01, 0.01, 0.01, 0.02], rel=0.05)
    pose, velocity = measurements.measure(OwnState(position_sd=0.0, yaw_sd=0.0), eta, nu, noise=rng.standard_normal(4))
    assert np.array_equal(pose, eta) and np.array_equal(velocity, nu)
    velocity[0] = 9.0
    assert nu[0] == 0.2


def test_a_fix_is_late_noisy_and_its_symbols_agree():
    own = OwnState(fixes=Delivery(loss=0.3, gaps=((2.0, 3.0),)))
    then, tick, noise = ca.SX.sym("then", 3), ca.SX.sym("tick"), ca.SX.sym("noise", 4)
    f = ca.Function("f", [then, tick, noise], list(own.fix_symbols(then, tick, noise=noise, dt=0.05)))
    rng, errors, arrived = np.random.default_rng(0), [], []
    for k in range(4000):
        place, draw = rng.normal(0, 3, 3), rng.standard_normal(4)
        fix, fresh = measurements.fix(own, place, k, noise=draw, dt=0.05)
        same, also = f(place, k, draw)
        assert np.array_equal(np.array(same).ravel(), fix) and bool(also) == fresh
        arrived.append(fresh)
        errors += [fix - place] if fresh else [fix]
        assert fresh or not fix.any()
    assert np.mean(arrived) == pytest.approx(0.5 * 0.7, abs=0.02)
    assert not any(arrived[42:62]) and any(arrived[30:42]) and any(arrived[62:80])
    assert np.std(np.array(errors)[arrived], axis=0) == pytest.approx([0.01] * 3, rel=0.06)


def test_the_imu_measures_yaw_and_rate():
    own, eta, nu = OwnState(yaw_sd=0.02, rate_sd=0.005), np.array([1.0, 2.0, -0.15, 0.3]), np.array([0.2, 0, 0, 0.45])
    rng = np.random.default_rng(0)
    measured = np.array([measurements.imu(own, eta, nu, noise=rng.standard_normal(2)) for _ in range(5000)])
    assert measured.mean(axis=0) == pytest.approx([0.3, 0.45], abs=1e-3)
    assert measured.std(axis=0) == pytest.approx([0.02, 0.005], rel=0.05)
    assert np.corrcoef(measured.T)[0, 1] == pytest.approx(0.0, abs=0.05)
    e, n, z = ca.SX.sym("e", 4), ca.SX.sym("n", 4), ca.SX.sym("z", 2)
    f = ca.Function("f", [e, n, z], list(own.imu_symbols(e, n, noise=z)))
    assert [float(v) for v in f(eta, nu, [1.0, -2.0])] == list(
        measurements.imu(own, eta, nu, noise=np.array([1.0, -2.0]))
    )


def test_a_message_is_late_and_its_symbols_agree():
    station = BaseStation(velocity_sd=0.02, messages=Delivery(loss=0.2))
    then, tick, noise, chance = (
        ca.SX.sym(name, *size)
        for name, size in (("then", (3, 6)), ("tick", (1, 1)), ("noise", (3, 4)), ("chance", (1, 1)))
    )
    f = ca.Function(
        "f", [then, tick, noise, chance], list(station.message_symbols(then, tick, noise=noise, chance=chance, dt=0.05))
    )
    rng, arrived, errors = np.random.default_rng(0), [], []
    for k in range(2000):
        rows, draw, luck = rng.normal(0, 1, (3, 6)), rng.standard_normal((3, 4)), float(rng.standard_normal())
        rows[:, 5] = [1.0, 0.0, 1.0]
        message, fresh = measurements.message(station, rows, k, noise=draw, chance=luck, dt=0.05)
        same, also = f(rows, k, draw, luck)
        assert np.abs(np.array(same) - message).max() <= 1e-12 and bool(also) == fresh
        assert not message[1].any() and (fresh or not message.any())
        arrived.append(fresh)
        errors += [message[0] - rows[0]] if fresh else []
    assert np.mean(arrived) == pytest.approx(0.5 * 0.8, abs=0.03)
    assert np.std(errors, axis=0) == pytest.approx([0.01, 0.01, 0.0, 0.02, 0.02, 0.0], rel=0.1)


@pytest.mark.parametrize(
    "build",
    [
        lambda: BaseStation(position_sd=-0.1),
        lambda: BaseStation(velocity_sd=math.nan),
        lambda: OwnState(yaw_sd=-1.0),
        lambda: OwnState(rate_sd=math.nan),
    ],
)
def test_mistakes_are_refused(build):
    with pytest.raises(InputError):
        build()
