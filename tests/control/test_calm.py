"""Law `calm`: the band around the demanded thrust, and the eased velocity reference."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.marine.control import build_law, load_gains
from surctl.marine.control.closing import CALM_GAINS, beside_margin, calmed, eased, pushed, soft_gain

Array = NDArray[np.float64]
LIMIT, MASS, STILL, DT = np.array([5.0, 5.0, 5.0, 0.5]), np.array([95.0, 95.0, 95.0, 1.5]), 0.006, 0.05
GAIN = ca.evalf(soft_gain({"k_v": ca.DM(1.5), "soft": ca.DM(1.0)})).full().ravel()
HALF = np.append(GAIN * 95.0 * STILL, 0.0)  # mass times gain times velocity error; the yaw moment is the demand


def _model(still: float) -> dict[str, Any]:
    shared = {"k_v": 1.5, "soft": 1.0, "feed_forward": 0.5, "still": still, "settle": 2.0}
    return {"mass": ca.DM(MASS), "thrust_limit": ca.DM(LIMIT), **shared}


def _follow(demand: Array, still: float = STILL) -> Array:
    held, out = ca.DM.zeros(4), []
    for free in demand:
        held = calmed(ca.DM(free), held, ca.DM.zeros(2), p=_model(still), dt=DT)
        out.append(held.full().ravel())
    return np.array(out)


def test_noise_moves_the_thrust_little_and_a_manoeuvre_moves_it_at_once() -> None:
    rng = np.random.default_rng(3)
    noisy = np.array([2.0, -1.0, 0.0, 0.1]) + 0.8 * HALF * rng.uniform(-1, 1, (300, 4))
    command = _follow(noisy)
    varied, demanded = (np.abs(np.diff(one[50:, :3], axis=0)).sum() for one in (command, noisy))
    assert varied < 0.06 * demanded
    moving = np.outer(np.sin(np.linspace(0, 6, 120)), LIMIT)
    assert np.all(np.abs(_follow(moving) - moving) <= HALF + 1e-12)


def test_a_steady_error_settles_with_the_time_constant() -> None:
    demand = np.tile([0.5, 0.0, 0.0, 0.0], (80, 1))  # 4 s within the band
    left = 0.5 - _follow(demand)[:, 0]
    assert left[39] / 0.5 == pytest.approx((2.0 / (2.0 + DT)) ** 40) and left[79] < 0.08


def test_a_share_of_the_references_acceleration_is_thrust() -> None:
    command = calmed(ca.DM([0.3, 0, 0, 0]), ca.DM.zeros(4), ca.DM([0.02, -0.01]), p=_model(still=0.0), dt=DT)
    assert command.full().ravel() == pytest.approx([0.3 + 0.5 * 95 * 0.02, -0.5 * 95 * 0.01, 0, 0])
    held = ca.DM.zeros(2)
    for k in range(100):  # 5 s at 0.03 m/s^2: ten time constants of the filter
        held = pushed(ca.DM([0.03 * DT * (k + 1), 0]), ca.DM([0.03 * DT * k, 0]), held, dt=DT)
    assert held.full().ravel() == pytest.approx([0.03, 0.0], abs=1e-5)


def test_no_band_is_the_demand_and_the_widest_leaves_most_of_the_thrust() -> None:
    demand = np.outer(np.sin(np.linspace(0, 6, 40)), LIMIT)
    assert np.allclose(_follow(demand, 0.0), demand, atol=1e-15)
    assert _follow(3 * LIMIT[None], 1.0)[0, :3] == pytest.approx(2.7 * LIMIT[:3])  # the limits follow after the band


@pytest.mark.parametrize("seed", range(8))
def test_the_reference_is_slow_where_it_may_and_within_the_bounds_always(seed: int) -> None:
    rng = np.random.default_rng(seed)
    before, desired = rng.normal(0, 0.2, 2), rng.normal(0, 0.1, 2)
    angles = rng.uniform(-np.pi, np.pi, 6)
    normals = np.column_stack([np.cos(angles), np.sin(angles)])
    limits = normals @ desired + rng.uniform(0.0, 0.1, 6)  # the desired velocity respects all of them
    bounds = [(ca.SX(n), ca.SX(b)) for n, b in zip(normals, limits, strict=True)]
    fastest = 0.5 * float(np.linalg.norm(desired - before))  # binds: a share of 0.5 dt, less than dt / (dt + time)
    reference = ca.evalf(eased(ca.SX(desired), ca.SX(before), bounds, time=0.45, fastest=fastest, dt=DT)).full().ravel()
    assert np.all(normals @ reference <= limits + 1e-12)
    shares = (reference - before) / (desired - before)
    assert shares[0] == pytest.approx(shares[1]) and 0.025 - 1e-12 <= shares[0] <= 1 + 1e-12
    if np.all(normals @ (before + 0.025 * (desired - before)) <= limits):
        assert shares[0] == pytest.approx(0.025)


def test_the_law_has_its_gains_and_others_have_no_band() -> None:
    law = build_law("calm", sonar=True)
    assert "held" in law.state and set(CALM_GAINS) <= {port.name for port in law.gains}
    assert "held" not in build_law(sonar=True).state
    assert load_gains("default").with_own(CALM_GAINS)["settle"] == 0.5


def test_marks_beside_the_course_need_less_margin_than_marks_ahead() -> None:
    p = {"margin": ca.DM(0.05), "beside": ca.DM(0.1)}
    normals = [ca.DM([np.cos(a), np.sin(a)]) for a in np.linspace(0, np.pi, 19)]
    rest, to_x, back = ca.DM.zeros(2), ca.DM([0.1, 0.0]), ca.DM([-0.1, 0.0])
    kept = [float(beside_margin(n, course=to_x, now=rest, full=ca.DM(0), p=p)) for n in normals]
    assert kept[0] == pytest.approx(0.05) and kept[8:] == pytest.approx([0.005] * 11)  # from 80 degrees off the course
    assert kept == sorted(kept, reverse=True)
    everywhere = [float(beside_margin(n, course=rest, now=rest, full=ca.DM(1), p=p)) for n in normals]
    assert everywhere == [0.05] * 19
    assert float(beside_margin(normals[-1], course=to_x, now=back, full=ca.DM(0), p=p)) == pytest.approx(0.05)
