from dataclasses import replace
from types import MappingProxyType

import pytest

from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.guidance.braking import Watch, brakes_of, range_needed, stopping_distance_with_drag
from surctl.marine.simulation import Case, Obstacle, Reflectors, load_scenario
from surctl.marine.simulation.campaign.summary import assumptions
from surctl.marine.vehicle import load_vehicle

SCENARIO = load_scenario("tank-static")
VEHICLE = load_vehicle(SCENARIO.vehicle)


CASE = Case(SCENARIO, VEHICLE, load_gains("default"), sensing="sonar")


def told(draw=MappingProxyType({}), *, scenario=SCENARIO, detection=1e3, fastest=10.0, **kind):
    return assumptions(replace(CASE, scenario=scenario, **kind), draw, detection=detection, fastest=fastest)


def test_what_holds_is_not_told():
    assert told() == ()


def test_weak_thrust_is_told():
    assert told({"Fu_max": 0.85 * VEHICLE["Fu_max"]}) == ()
    assert told({"Fu_max": 0.84 * VEHICLE["Fu_max"]}) == ("thrust", "range")


def test_a_plant_beyond_its_range_is_told():
    most = VEHICLE.parameters["Nr"].range[1]
    assert told({"Nr": most}) == ()
    assert told({"Nr": 1.01 * most}) == ("range",)
    with pytest.raises(InputError):
        told({"m12": 1.0})


def test_a_quick_obstacle_is_told():
    one = Obstacle(name="b", shape="moving", centre_m=(9, 3), to_m=(8, 3), speed_m_per_s=0.15)
    quick = replace(SCENARIO, obstacles=(one,))
    assert told(scenario=quick, fastest=0.15) == ()
    assert told(scenario=quick, fastest=0.14) == ("obstacle speed",)


def test_an_obstacle_over_the_target_or_start_is_told():
    for place in (SCENARIO.target, SCENARIO.start):
        one = Obstacle(name="b", shape="cylinder", centre_m=tuple(place), radius_m=0.1)
        assert told(scenario=replace(SCENARIO, obstacles=(one,))) == ("hull",)


def test_surfaces_that_stay_silent_are_told():
    for echoes in ("webots", "specular", "diffuse"):
        assert told(scenario=replace(SCENARIO, sensors=SCENARIO.sensors.hearing(echoes))) == ("echoes",)
    smooth = replace(SCENARIO, sensors=SCENARIO.sensors.hearing("webots"))
    assert told(scenario=smooth, sensing="truth") == ()
    # a surface that is heard beyond the longest range changes nothing
    for floor, wanted in ((2.0, ("echoes",)), (5.0, ())):
        site = replace(SCENARIO, site=(10.0, 5.0, floor), reflectors=Reflectors(floor="diffuse"))
        assert told(scenario=site) == wanted


def test_short_sight_is_told():
    far = range_needed(brakes_of(VEHICLE), Watch(), SCENARIO.cap, stopping=stopping_distance_with_drag)
    still = replace(SCENARIO, obstacles=())
    assert told(scenario=still, detection=far) == ()
    assert told(scenario=still, detection=0.99 * far) == ("detection",)


def test_what_is_too_fast_to_be_braked_for_is_seen_too_late_from_any_range():
    one = Obstacle(name="b", shape="moving", centre_m=(9, 3), to_m=(8, 3), speed_m_per_s=0.2)
    assert told(scenario=replace(SCENARIO, obstacles=(one,))) == ("detection",)


def test_masses_that_differ_are_told_where_the_hull_turns():
    one, two = {"m11": 100.0, "m22": 90.0}, {"m11": 125.0, "m22": 75.0}
    assert told(one) == () and told(two) == ("margin",)
    assert told(two, sensing="truth") == ()  # a straight path is flown without turning
    assert told(two, law="paper") == ()  # makes no such claim
    assert told(two, gains=CASE.gains.with_values({"margin": 2.0})) == ()
