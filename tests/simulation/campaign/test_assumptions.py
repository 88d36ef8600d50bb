from dataclasses import replace
from types import MappingProxyType

import pytest

from surctl.errors import InputError
from surctl.simulation import Obstacle, load_scenario
from surctl.simulation.campaign import assumptions, braking_distance
from surctl.vehicle import load_vehicle

SCENARIO = load_scenario("tank-static")
VEHICLE = load_vehicle(SCENARIO.vehicle)


def told(draw=MappingProxyType({}), *, scenario=SCENARIO, detection=1e3, fastest=10.0):
    return assumptions(scenario, VEHICLE, draw, detection=detection, fastest=fastest)


def test_what_holds_is_not_told():
    assert told() == ()


def test_weak_thrust_is_told():
    assert told({"Fu_max": 0.85 * VEHICLE["Fu_max"]}) == ()
    assert told({"Fu_max": 0.84 * VEHICLE["Fu_max"]}) == ("thrust", "range")


def test_a_plant_beyond_its_range_is_told():
    most = VEHICLE.parameters["m11"].range[1]
    assert told({"m11": most}) == ()
    assert told({"m11": 1.01 * most}) == ("range",)
    with pytest.raises(InputError):
        told({"m12": 1.0})


def test_a_quick_obstacle_is_told():
    one = Obstacle(name="b", shape="moving", centre_m=(9, 3), to_m=(8, 3), speed_m_per_s=0.2)
    quick = replace(SCENARIO, obstacles=(one,))
    assert told(scenario=quick, fastest=0.2) == ()
    assert told(scenario=quick, fastest=0.19) == ("obstacle speed",)


def test_an_obstacle_over_the_target_or_start_is_told():
    for place in (SCENARIO.target, SCENARIO.start):
        one = Obstacle(name="b", shape="cylinder", centre_m=tuple(place), radius_m=0.1)
        assert told(scenario=replace(SCENARIO, obstacles=(one,))) == ("hull",)


def test_short_sight_is_told():
    far = braking_distance(VEHICLE, speed=SCENARIO.cap)
    still = replace(SCENARIO, obstacles=())
    assert told(scenario=still, detection=far) == ()
    assert told(scenario=still, detection=0.99 * far) == ("detection",)


def test_without_lag_the_way_is_that_of_constant_force():
    quick = VEHICLE.with_values({"thrust_lag": 0.0})
    ways = [quick[m] * 0.2**2 / (2 * 0.85 * quick[f]) for m, f in (("m11", "Fu_max"), ("m22", "Fv_max"))]
    assert braking_distance(quick, speed=0.2) == pytest.approx(max(ways), rel=1e-12)
    assert braking_distance(VEHICLE, speed=0.2, obstacle=1e3) == float("inf")


@pytest.mark.parametrize("obstacle", [0.0, 0.1])
def test_lag_is_like_braking_from_the_speed_that_it_adds(obstacle):
    ways = []
    for m, linear, quadratic, f in (("m11", "Xu", "Xuu", "Fu_max"), ("m22", "Yv", "Yvv", "Fv_max")):
        added = 1.85 * VEHICLE[f] * VEHICLE["thrust_lag"] / VEHICLE[m]
        left = 0.85 * VEHICLE[f] - VEHICLE[linear] * obstacle - VEHICLE[quadratic] * obstacle**2
        ways.append(VEHICLE[m] * (0.2 + obstacle + added) ** 2 / (2 * left))
    assert braking_distance(VEHICLE, speed=0.2, obstacle=obstacle) == pytest.approx(max(ways), rel=1e-12)
