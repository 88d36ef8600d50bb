import numpy as np
import pytest

from surctl.marine.guidance import Follower, Path
from surctl.marine.simulation.run import attitude_of

TIME = np.arange(0.0, 80.0, 0.05)
LINE = Path(np.array([[0.0, 0.0], [20.0, 0.0]]))


def motion(sway: np.ndarray, psi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    zero = np.zeros_like(TIME)
    return np.stack([0.15 * TIME, zero, zero, psi], axis=1), np.stack([zero + 0.15, sway, zero, zero], axis=1)


def test_a_hull_that_crabs_has_its_angle_and_does_not_swing() -> None:
    eta, nu = motion(np.full_like(TIME, 0.15 * np.tan(np.deg2rad(51))), np.full_like(TIME, np.deg2rad(-51)))
    found = attitude_of(Follower(LINE), 0.15, TIME, eta, nu)
    assert found.crab_angle_deg == pytest.approx(51) and found.heading_error_deg == pytest.approx(51)
    assert not found.oscillates and np.isnan(found.period_s)


def test_a_limit_cycle_has_a_period_and_a_decay_or_noise_has_none() -> None:
    swing = 0.05 * np.sin(2 * np.pi * TIME / 7.5)
    found = attitude_of(Follower(LINE), 0.15, TIME, *motion(swing, 0 * TIME))
    assert found.oscillates and found.period_s == pytest.approx(7.5, abs=0.11)
    assert found.swing_m_per_s == pytest.approx(0.05, rel=0.05)
    for other in (swing * np.exp(-TIME / 6), np.random.default_rng(1).normal(scale=0.05, size=len(TIME))):
        assert not attitude_of(Follower(LINE), 0.15, TIME, *motion(other, 0 * TIME)).oscillates


def test_the_leg_that_it_is_on_gives_the_direction_and_a_hull_at_rest_has_no_angle() -> None:
    corner = Path(np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 5.0]]))
    eta = np.array([[1.0, 0.1, 0.0, 0.0], [5.1, 3.0, 0.0, np.pi / 2]])
    nu = np.tile([0.15, 0.0, 0.0, 0.0], (2, 1))
    assert attitude_of(Follower(corner), 0.15, TIME[:2], eta, nu).heading_error_deg == pytest.approx(0, abs=1e-9)
    assert np.isnan(attitude_of(Follower(corner), 0.15, TIME[:2], eta, 0 * nu).crab_angle_deg)
