"""The world of a run: drift, movers, waves, clearance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.marine.simulation import Body, Scenario, World, load_scenario
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import load_vehicle
from surctl.marine.world import Disc

TIMES = np.linspace(0, 60, 241)


def _centre(body: Body) -> NDArray[np.float64]:
    assert isinstance(body.shape, Disc)
    return np.array(body.shape.center)


def _world(name: str, *, seed: int = 0, scenario: Scenario | None = None) -> World:
    scenario = scenario or load_scenario(name)
    return build_world(scenario, load_vehicle(scenario.vehicle), seed=seed)


@pytest.mark.parametrize("seed", range(4))
def test_obstacles_drift_on_a_line_within_their_amplitude(seed: int) -> None:
    world = _world("pool-static", seed=seed)
    for k, obstacle in enumerate(world.scenario.obstacles):
        centres = np.array([_centre(world.bodies(t)[k]) for t in TIMES]) - obstacle.centre_m
        along = np.linalg.norm(centres, axis=1)
        assert along.max() <= obstacle.drift_m + 1e-12
        assert along.max() > 0.99 * obstacle.drift_m
        assert np.linalg.svd(centres, compute_uv=False)[1] < 1e-12  # one direction


def test_drift_velocity_is_the_derivative_of_the_position() -> None:
    world, h = _world("pool-static"), 1e-5
    for t in (0.3, 4.0, 7.7):
        for before, now, after in zip(world.bodies(t - h), world.bodies(t), world.bodies(t + h), strict=True):
            difference = (_centre(after) - _centre(before)) / (2 * h)
            np.testing.assert_allclose(now.velocity, difference, atol=1e-8)
            assert not now.moving


def test_the_seed_fixes_drift_and_waves() -> None:
    one, same, other = _world("pool-static"), _world("pool-static"), _world("pool-static", seed=1)
    np.testing.assert_array_equal(one.drift_direction, same.drift_direction)
    np.testing.assert_array_equal(one.force(1.3), same.force(1.3))
    assert np.abs(one.drift_direction - other.drift_direction).max() > 0.01
    assert np.abs(one.force(1.3) - other.force(1.3)).max() > 1e-3


def test_a_mover_goes_straight_to_its_goal_and_is_lifted_out() -> None:
    world = _world("pool-behind")
    start, goal, speed = np.array([0.25, 0.25]), np.array([2.75, 1.75]), 0.2
    way = goal - start
    arrival = float(np.linalg.norm(way)) / speed
    for t in (0.0, 3.0, arrival - 1e-6):
        (body,) = world.bodies(t)
        assert isinstance(body.shape, Disc)
        np.testing.assert_allclose(body.shape.center, start + speed * t * way / np.linalg.norm(way), atol=1e-12)
        np.testing.assert_allclose(body.velocity, speed * way / np.linalg.norm(way), atol=1e-15)
        assert body.shape.radius == 0.2  # that of the vehicle flown
        assert body.moving
    assert world.bodies(arrival + 1e-6) == []
    assert world.clearance(np.array([*goal, -0.15]), world.bodies(arrival + 1)) == np.inf


def test_a_mover_that_is_not_removed_stands_at_its_goal() -> None:
    scenario = load_scenario("pool-behind")
    stays = scenario.obstacles[0].model_copy(update={"removed": False, "radius_m": 0.1})
    (body,) = _world("", scenario=replace(scenario, obstacles=(stays,))).bodies(100.0)
    assert isinstance(body.shape, Disc)
    np.testing.assert_allclose(body.shape.center, [2.75, 1.75])
    np.testing.assert_array_equal(body.velocity, 0)
    assert body.shape.radius == 0.1


def test_a_mover_without_a_radius_has_that_of_the_vehicle() -> None:
    scenario = load_scenario("tank-speed-015")
    (body,) = build_world(scenario, load_vehicle("sur400"), seed=0).bodies(0.0)
    assert isinstance(body.shape, Disc)
    assert body.shape.radius == 0.2


def test_clearance_by_hand() -> None:
    world = _world("tank-static")
    point = np.array([8.0 - 0.15 - 0.5, 2.5, -0.15])  # 0.5 m before the last box
    assert world.clearance(point, world.bodies(0.0)) == pytest.approx(0.5 - 0.27)
    assert world.clearance(np.array([2.5, 1.2, -0.15]), world.bodies(0.0)) < 0
    assert world.wall_clearance(np.array([1.0, 0.1])) == pytest.approx(0.1 - 0.27)


def _pushed(**changes: float) -> World:
    world = _world("pool-static")
    disturbance = world.scenario.disturbance.model_copy(update=changes)
    return replace(world, scenario=replace(world.scenario, disturbance=disturbance))


def test_waves_push_in_one_direction_with_the_given_amplitude() -> None:
    pushed = _pushed(drift_force_n=0.0)
    forces = np.array([pushed.force(t) for t in np.linspace(0, 3, 301)])
    np.testing.assert_array_equal(forces[:, 2:], 0)
    assert np.linalg.norm(forces, axis=1).max() == pytest.approx(0.3, rel=1e-3)
    np.testing.assert_allclose(forces[0], forces[-1], atol=1e-12)  # period 3 s
    np.testing.assert_array_equal(_world("tank-static").force(1.0), 0)


@pytest.mark.parametrize(
    ("name", "seeded"),
    [("tank-static", False), ("tank-speed-015", False), ("pool-static", True), ("pool-behind", True)],
)
def test_a_scenario_knows_whether_its_seed_matters(name: str, seeded: bool) -> None:
    one, other = _world(name), _world(name, seed=1)
    assert one.scenario.seeded == seeded
    same_waves = np.array_equal(one.force(1.3), other.force(1.3))
    places = [[b.shape.nearest((0.0, 0.0))[0] for b in w.bodies(1.3)] for w in (one, other)]
    assert (same_waves and places[0] == places[1]) != seeded


def test_the_drift_is_slow_and_has_a_direction_of_its_own() -> None:
    pushed = _pushed(wave_force_n=0.0)
    forces = np.array([pushed.force(t) for t in np.linspace(0, 40, 401)])
    assert np.linalg.norm(forces, axis=1).max() == pytest.approx(0.1, rel=1e-3)
    np.testing.assert_allclose(forces[0], forces[-1], atol=1e-12)  # period 40 s
    np.testing.assert_allclose(forces, -np.roll(forces[:-1], 200, axis=0)[[*range(400), 0]], atol=1e-12)
    assert np.linalg.matrix_rank(forces, tol=1e-9) == 1
    world = _world("pool-static")
    assert abs(np.cross([*world.wave_direction, 0.0], [*world.slow_direction, 0.0])[2]) > 1e-3


def test_the_thrust_is_off_by_no_more_than_is_stated_and_differently_for_every_axis_and_seed() -> None:
    limit, command = np.array([5.0, 5.0, 5.0, 0.5]), np.array([1.0, -2.0, 3.0, 0.1])
    scenario, vehicle = load_scenario("pool-static"), load_vehicle("sur400")
    worlds = [build_world(scenario, vehicle, seed=seed) for seed in range(400)]
    biases = np.array([world.thrust(np.zeros(4), limit) for world in worlds]) / limit
    gains = np.array([world.thrust(command, limit) - world.thrust(np.zeros(4), limit) for world in worlds]) / command
    for errors, share in ((gains - 1, 0.05), (biases, 0.01)):
        assert np.all(np.abs(errors) <= share)
        assert np.all(np.abs(errors).max(axis=0) > 0.97 * share)
        np.testing.assert_allclose(errors.mean(axis=0), 0, atol=4 * share / np.sqrt(3 * 400))
        assert len(np.unique(errors.round(15))) == errors.size
    exact = _world("tank-static")
    np.testing.assert_array_equal(exact.thrust(command, limit), command)
