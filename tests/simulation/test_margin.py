"""The margin that a vehicle needs: its table, the push of unequal masses, and the rate at which the hull turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from surctl.marine.control import load_gains
from surctl.marine.guidance.braking import brakes_of, stopping_distance_with_drag, tabled_stopping_distance
from surctl.marine.simulation import Obstacle, findings, load_scenario
from surctl.marine.simulation.motion import closest
from surctl.marine.simulation.safety import margin_needed, munk, safety_claim, turn_rate
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import load_vehicle

SCENARIO = load_scenario("tank-static")
VEHICLE = load_vehicle(SCENARIO.vehicle)
GAINS = load_gains("default")


@pytest.mark.parametrize("obstacle", [0.0, 0.08])
@given(speed=st.floats(-0.2, 0.3))
def test_the_table_is_never_short_and_hardly_longer(obstacle: float, speed: float) -> None:
    brakes = brakes_of(VEHICLE, disturbance=0.3, current=0.02)
    exact = stopping_distance_with_drag(brakes, speed, obstacle=obstacle)
    told = tabled_stopping_distance(brakes, 0.3, obstacle=obstacle)(brakes, speed, obstacle=obstacle)
    assert exact * (1 - 1e-3) <= told <= 1.01 * exact


def test_before_what_cannot_be_braked_for_the_table_has_no_way() -> None:
    brakes = brakes_of(VEHICLE, disturbance=10.0)
    assert (
        tabled_stopping_distance(brakes, 0.2)(brakes, 0.1, obstacle=0.0)
        == np.inf
        == stopping_distance_with_drag(brakes, 0.1)
    )


@given(
    heading=st.floats(-np.pi, np.pi),
    course=st.floats(-np.pi, np.pi),
    turning=st.floats(-0.5, 0.5),
    masses=st.tuples(st.floats(50, 125), st.floats(50, 125)),
)
def test_no_turn_pushes_more_than_the_difference_of_the_masses(
    heading: float, course: float, turning: float, masses: tuple[float, float]
) -> None:
    def inertia(angle: float) -> np.ndarray:
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        return turn @ np.diag(masses) @ turn.T

    step = 1e-5
    rate = (inertia(heading + step * turning) - inertia(heading - step * turning)) / (2 * step)
    push = rate @ (0.22 * np.array([np.cos(course), np.sin(course)]))
    most = munk(abs(masses[0] - masses[1]), abs(turning), 0.22)
    assert np.hypot(*push) == pytest.approx(most, abs=1e-6)  # in some direction all of it


def settled(flown: dict[str, float], wanted: float) -> float:
    """Yaw rate after a minute of the yaw loop, stepped."""
    plant, rate = VEHICLE.with_values(flown), 0.0
    believed = VEHICLE
    for _ in range(6000):
        ahead = believed["Nr"] * wanted + believed["Nrr"] * wanted**2
        moment = min(ahead + believed["m44"] * GAINS["k_r"] * (wanted - rate), plant["Fr_max"])
        rate += 0.01 * (moment - plant["Nr"] * rate - plant["Nrr"] * rate**2) / plant["m44"]
    return rate


@pytest.mark.parametrize("flown", [{}, {"Nr": 0.06, "Nrr": 0.25}, {"Nr": 0.95, "Nrr": 2.9, "Fr_max": 0.43}])
def test_the_hull_turns_at_the_rate_at_which_the_loop_comes_to_rest(flown: dict[str, float]) -> None:
    told = turn_rate(SCENARIO, VEHICLE, GAINS, sonar=True, actual=VEHICLE.with_values(flown))
    assert told == pytest.approx(settled(flown, min(GAINS["spin"], VEHICLE.steady_yaw(0.85))), rel=1e-3)
    assert turn_rate(SCENARIO, VEHICLE, GAINS, sonar=True) >= told


def test_with_true_positions_it_turns_where_the_path_does() -> None:
    corner = load_scenario("tank-slalom")
    assert turn_rate(SCENARIO, VEHICLE, GAINS, sonar=False) == 0.0 < turn_rate(corner, VEHICLE, GAINS, sonar=False)


def test_a_larger_difference_needs_more_and_none_turns_into_the_plain_claim() -> None:
    plain = margin_needed(SCENARIO, VEHICLE, GAINS, VEHICLE)
    flown = [VEHICLE.with_values({"m11": 95.0 + d, "m22": 95.0 - d}) for d in (0, 5, 10, 20, 30)]
    needed = [margin_needed(SCENARIO, VEHICLE, GAINS, v, turning=0.4) for v in flown]
    assert plain <= needed[0] < 1.02 * plain and np.all(np.diff(needed) > 0) and needed[-1] > 2 * plain
    shaken = SCENARIO.disturbance.model_copy(update={"thrust_error": 0.1, "thrust_bias": 0.05})
    assert margin_needed(replace(SCENARIO, disturbance=shaken), VEHICLE, GAINS, VEHICLE) > plain


def test_the_claim_tells_how_different_the_masses_may_be() -> None:
    told = safety_claim(SCENARIO, VEHICLE, GAINS, spread=0.2, turning=0.25)
    most = told["covered difference"]
    assert told.holds and told["mass difference"] == 0 < most < 40
    near, far = (
        safety_claim(SCENARIO, VEHICLE, GAINS, spread=0.2, turning=0.25, difference=most + off) for off in (-0.1, 0.1)
    )
    assert near.holds and not far.holds and far["covered difference"] == most
    assert safety_claim(SCENARIO, VEHICLE, GAINS, spread=0.2)["covered difference"] == np.inf
    assert safety_claim(SCENARIO, VEHICLE, GAINS, turning=0.25)["covered difference"] == 0.0


def mover(name: str, start: tuple[float, float], end: tuple[float, float], speed: float, **told: bool) -> Obstacle:
    return Obstacle(name=name, shape="moving", centre_m=start, to_m=end, speed_m_per_s=speed, radius_m=0.2, **told)


@pytest.mark.parametrize("stays", [False, True])
def test_how_near_two_that_move_come_is_what_a_walk_in_small_steps_finds(stays: bool) -> None:
    a = mover("a", (2, 1), (6, 4), 0.1, removed=not stays)
    for b in (mover("b", (6, 1), (2, 4), 0.1), mover("b", (7, 4.5), (5, 4.5), 0.02, removed=not stays)):
        world = build_world(replace(SCENARIO, obstacles=(a, b)), VEHICLE, seed=0)
        found = [world.bodies(t) for t in np.arange(0.0, 200.0, 0.05)]
        apart = [
            np.hypot(*np.subtract(one.shape.center, two.shape.center)) for one, two in (f for f in found if len(f) == 2)
        ]
        assert closest(a, b, until=200.0) == pytest.approx(min(apart), abs=6e-3)
    assert closest(a, mover("b", (6, 1), (2, 4), 0.1), until=1.0) == pytest.approx(4.0 - 0.16, abs=1e-9)


def test_lint_names_two_that_run_into_each_other() -> None:
    pair = mover("a", (2, 1), (6, 4), 0.1), mover("b", (6, 1), (2, 4), 0.1)
    found = [f for f in findings(replace(SCENARIO, obstacles=pair), VEHICLE) if "collide with each other" in f.text]
    assert [(f.level, f.key) for f in found] == [("error", "obstacles.b.to_m")] and "0.40 m" in found[0].text
    late = pair[0], mover("b", (6, 1), (2, 4), 0.05)
    assert not [f for f in findings(replace(SCENARIO, obstacles=late), VEHICLE) if "collide with each other" in f.text]
