"""Calm commands of a law with sonars: the band around the demanded thrust, and the eased velocity reference."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.control import build_law
from surctl.control.calm import calmed, eased

Array = NDArray[np.float64]
LIMIT, MASS = np.array([5.0, 5.0, 5.0, 0.5]), np.array([95.0, 95.0, 95.0, 1.5])
MODEL = {"mass": ca.SX(MASS), "thrust_limit": ca.SX(LIMIT), "k_v": ca.SX(1.5), "k_r": ca.SX(1.5)}
HALF = 1.5 * 1.5 * MASS * np.array([0.004, 0.004, 0.004, 0.005])  # 1.5 standard deviations times gain and mass
HALF = np.minimum(HALF, 0.3 * LIMIT)
NOISE = (0.004, 0.005)


def _follow(demand: Array, noise: tuple[float, float] = NOISE) -> Array:
    held, out = np.zeros(4), []
    for free in demand:
        held = ca.evalf(calmed(ca.SX(free), ca.SX(held), noise=ca.SX(list(noise)), p=MODEL)).full().ravel()
        out.append(held)
    return np.array(out)


def test_noise_does_not_move_the_thrust_and_a_manoeuvre_does() -> None:
    rng = np.random.default_rng(3)
    steady = np.array([2.0, -1.0, 0.0, 0.1])
    noisy = steady + 0.8 * HALF * rng.uniform(-1, 1, (200, 4))
    command = _follow(noisy)
    assert np.abs(np.diff(command[20:], axis=0)).sum() < 0.02 * np.abs(np.diff(noisy[20:], axis=0)).sum()
    moving = np.outer(np.sin(np.linspace(0, 6, 120)), LIMIT)
    assert np.all(np.abs(_follow(moving) - moving) <= HALF + 1e-12)  # at most the half width from the demand


def test_without_noise_the_demand_is_the_command() -> None:
    demand = np.outer(np.sin(np.linspace(0, 6, 40)), LIMIT)
    assert np.array_equal(_follow(demand, (0.0, 0.0)), demand)


def test_a_poor_estimate_leaves_most_of_the_thrust() -> None:
    far = np.tile(3.0 * LIMIT, (1, 1))
    assert _follow(far, (1.0, 1.0))[0] == pytest.approx(2.7 * LIMIT)  # the limits follow after the band


@pytest.mark.parametrize("seed", range(20))
def test_the_reference_is_slow_where_it_may_and_within_the_bounds_always(seed: int) -> None:
    rng = np.random.default_rng(seed)
    before, desired = rng.normal(0, 0.2, 2), rng.normal(0, 0.1, 2)
    angles = rng.uniform(-np.pi, np.pi, 6)
    normals = np.column_stack([np.cos(angles), np.sin(angles)])
    limits = normals @ desired + rng.uniform(0.0, 0.1, 6)  # the desired velocity respects all of them
    bounds = [(ca.SX(n), ca.SX(b)) for n, b in zip(normals, limits, strict=True)]
    eased_to = eased(ca.SX(desired), ca.SX(before), bounds, time=0.45, dt=0.05)
    found = ca.evalf(eased_to).full().ravel()
    assert np.all(normals @ found <= limits + 1e-12)
    shares = (found - before) / (desired - before)
    assert shares[0] == pytest.approx(shares[1]) and 0.1 - 1e-12 <= shares[0] <= 1 + 1e-12
    if np.all(normals @ (before + 0.1 * (desired - before)) <= limits):
        assert shares[0] == pytest.approx(0.1)


def test_only_laws_with_a_sonar_map_have_the_band() -> None:
    assert "held" in build_law(sonar=True).state
    assert "held" not in build_law().state and "held" not in build_law("paper", sonar=True).state
