"""The safety claim: its numbers against independent flights and against each other."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from surctl.marine.control import load_gains
from surctl.marine.guidance.braking import (
    Brakes,
    Watch,
    brakes_of,
    fastest_obstacle,
    range_needed,
    stopping_distance_with_drag,
)
from surctl.marine.simulation import SafetyClaim, Scenario, findings, load_scenario
from surctl.marine.simulation.echo_fit import detection_range, unanswered
from surctl.marine.simulation.reflectors import Reflectors, ReflectorTable
from surctl.marine.simulation.safety import safety_claim
from surctl.marine.vehicle import load_vehicle
from tests.guidance.test_braking import fly

SCENARIO = load_scenario("tank-static")
VEHICLE = load_vehicle(SCENARIO.vehicle)
GAINS = load_gains("default")


def claim(**told: Any) -> SafetyClaim:
    return safety_claim(SCENARIO, VEHICLE, GAINS, **told)


def test_the_shipped_margin_is_enough_for_twenty_per_cent_but_not_for_the_whole_ranges() -> None:
    near, wide = claim(spread=0.2), claim()
    assert near.holds and near["covered speed"] == SCENARIO.cap and near["margin needed"] < 0.04
    assert not wide.holds and 0.04 < wide["covered speed"] < 0.08
    assert "DOES NOT HOLD" in wide.lines()[-1] and "holds" in near.lines()[-1]
    assert f'set margin = "{wide.least_margin:g} m" in the gain file' in wide.shortfall and near.shortfall == ""
    assert safety_claim(SCENARIO, VEHICLE, GAINS.with_values({"margin": wide.least_margin})).holds
    assert not safety_claim(SCENARIO, VEHICLE, GAINS.with_values({"margin": wide.least_margin - 1e-3})).holds
    more = GAINS.with_values({"margin": wide["margin needed"] + 1e-6})
    assert safety_claim(SCENARIO, VEHICLE, more).holds
    less = GAINS.with_values({"margin": wide["margin needed"] - 1e-3})
    assert not safety_claim(SCENARIO, VEHICLE, less).holds


def test_the_cap_that_is_proposed_is_one_that_holds() -> None:
    [proposed] = re.findall(r"lower the speed cap, and a faster cruise speed, to (\S+) m/s or less", claim().shortfall)
    assert safety_claim(replace(SCENARIO, cap=float(proposed), cruise=0.01), VEHICLE, GAINS).holds


def shipped(margin: float, excess: float) -> Any:
    """What the law does: full thrust against it as soon as it is faster than its bound by the excess."""

    def rule(brakes: Brakes, watch: Watch, speed: float, *, obstacle: float, fastest: float) -> float:
        s = max(speed - excess, 0.0)
        return s**2 * VEHICLE["m11"] / (2 * GAINS["brake"] * VEHICLE["Fu_max"]) + s * GAINS["reaction"] + margin

    return rule


def test_with_the_margin_needed_the_law_s_bound_hits_nothing_and_without_it_does() -> None:
    wide, brakes = claim(), brakes_of(VEHICLE)
    excess = wide["excess"]
    assert fly(brakes, Watch(), 0.0, seed=1, rule=shipped(wide["margin needed"], excess))[0] >= 0
    assert fly(brakes, Watch(), 0.0, seed=1, rule=shipped(0.0, excess))[0] < 0


def test_the_inertia_barrier_needs_less_beside_its_bound() -> None:
    simple, inertia = claim(), claim(barrier="inertia")
    assert inertia.holds and inertia["margin needed"] < 0.5 * simple["margin needed"]
    assert inertia["least thrust"] == pytest.approx(GAINS["brake"] * VEHICLE["Fu_max"])
    assert simple["least thrust"] == pytest.approx(0.85 * VEHICLE["Fu_max"])


def test_only_a_barrier_on_movers_covers_any() -> None:
    still, kept = claim(spread=0.2), claim(spread=0.2, movers="barrier")
    assert still["obstacle speed"] == 0 < kept["obstacle speed"] < kept["drag equals thrust at"]
    assert "an obstacle at rest" in still.statement and f"{kept['obstacle speed']:.3g} m/s" in kept.statement
    seen = [
        claim(barrier="inertia", movers="barrier", detection=range_m)["obstacle speed"] for range_m in (0.5, 1.0, 2.0)
    ]
    assert seen[0] == 0 < seen[1] < seen[2] < fastest_obstacle(brakes_of(VEHICLE, share=GAINS["brake"]))
    reach = range_needed(
        brakes_of(VEHICLE, share=GAINS["brake"]),
        Watch(),
        SCENARIO.cap,
        obstacle=seen[2],
        stopping=stopping_distance_with_drag,
    )
    assert reach == pytest.approx(2.0, abs=0.02)


def test_what_is_seen_too_late_or_wrong_asks_for_more() -> None:
    plain = claim(spread=0.2)
    watch = Watch(age=0.1, range_error=0.02, speed_error=0.01)
    worse = claim(spread=0.2, watch=watch)
    assert worse["margin needed"] > plain["margin needed"] + 0.02
    assert not worse.holds
    assert not claim(spread=0.2, detection=0.9 * plain["range needed"]).holds
    assert claim(spread=0.2, sideways=0.1)["push"] > 0 == plain["push"]


def test_current_and_waves_of_the_scenario_are_in_it() -> None:
    rough = replace(
        SCENARIO,
        disturbance=SCENARIO.disturbance.model_copy(update={"current_m_per_s": (0.03, 0.04), "drift_force_n": 0.2}),
    )
    told = safety_claim(rough, VEHICLE, GAINS)
    assert told["current"] == pytest.approx(0.05) and told["push"] == pytest.approx(0.2)
    assert told["range needed"] > claim()["range needed"]


def test_it_is_data() -> None:
    told = claim()
    table = told.to_dict()
    assert table["holds"] is False
    values = {row["name"]: row["value"] for row in table["assumptions"]}
    assert values["detection range"] == np.inf and values["thrust lag"] == VEHICLE["thrust_lag"]
    assert json.loads(json.dumps(told.to_dict()))["derived"][0]["name"] == "range needed"
    assert np.isfinite([f.value for f in told.derived if f.name != "covered difference"]).all()
    with pytest.raises(KeyError):
        told["thrust"]


@pytest.mark.parametrize(("name", "told"), [("tank-speed-020", True), ("tank-speed-010", False)])
def test_lint_tells_what_is_only_evaded(name: str, told: bool) -> None:
    scenario = load_scenario(name)
    found = [f for f in findings(scenario, load_vehicle(scenario.vehicle)) if f.level == "info"]
    assert bool(found) == told
    if told:
        assert found[0].key == "obstacles.OM1.speed_m_per_s" and "0.184 m/s" in found[0].text


def test_lint_tells_what_is_seen_too_late() -> None:
    scenario = load_scenario("tank-speed-015")
    array = replace(scenario.sensors.equipment.array, maximum=1.5)
    sensors = replace(scenario.sensors, equipment=replace(scenario.sensors.equipment, array=array))
    found = [f.text for f in findings(replace(scenario, sensors=sensors), VEHICLE) if f.level == "info"]
    assert len(found) == 1 and "the sonars reach 1.5 m" in found[0]


def test_other_depths_rest_on_the_echo_sounders() -> None:
    plain, deep = claim(), safety_claim(replace(SCENARIO, depths=(-1.0, 0.0)), VEHICLE, GAINS)
    added = {f.name for f in deep.assumptions} - {f.name for f in plain.assumptions}
    assert added == {"sounder footprint", "sonar fan"} and deep["sonar fan"] >= GAINS["margin"]
    assert deep.derived == plain.derived


def test_the_claim_names_what_it_assumes_of_surfaces() -> None:
    told = safety_claim(SCENARIO, VEHICLE, GAINS, detection=4.5)
    assert "within 22.5 deg of their normal, and no corner points at the hull" in told.echoes
    assert told.to_dict()["echoes"] == told.echoes
    assert f"  assumes  {told.echoes}" in told.lines() and not claim().echoes


@pytest.mark.parametrize(
    ("echoes", "first", "what"),
    [
        ("ideal", None, ""),
        ("webots", None, ""),
        ("specular", None, "OS1, OS2, OS3 and OS4 are silent beyond 5 deg of the normal"),
        ("webots", "silent", "OS1 is silent"),
    ],
)
def test_a_claim_does_not_hold_where_obstacles_answer_less_than_it_assumes(
    echoes: str, first: str | None, what: str
) -> None:
    one, *others = SCENARIO.obstacles
    obstacles = (one.model_copy(update={"reflector": first}), *others)
    scenario = replace(SCENARIO, sensors=SCENARIO.sensors.hearing(echoes), obstacles=obstacles)
    told = safety_claim(scenario, VEHICLE, GAINS, spread=0.2, detection=detection_range(scenario))
    assert told.contradicted == what and told.holds == (not what)
    assert what in told.shortfall and told.lines()[-1].endswith(told.shortfall if what else "holds")
    exact = safety_claim(scenario, VEHICLE, GAINS, spread=0.2)  # with true positions no echo is needed
    assert exact.holds and exact.contradicted == ""


@pytest.mark.parametrize(("kind", "what"), [("specular", "detected with a probability"), ("quiet", "silent")])
def test_a_cylinder_that_answers_with_a_probability_contradicts_the_claim(kind: str, what: str) -> None:
    pool = load_scenario("pool-static")
    kinds = {"quiet": ReflectorTable(cylinder_range_m=0.0)}
    first, *others = pool.obstacles
    told = replace(pool, obstacles=(first.model_copy(update={"reflector": kind}), *others))
    assert unanswered(replace(told, reflectors=Reflectors(kinds=kinds))) == f"Obstacle1 is {what}"


def test_an_assumed_floor_ends_the_detection_range() -> None:
    """30 degrees of half a beam below the horizontal: the floor 2 m below answers from 4 m, less 0.1 m of tolerance."""

    def over(floor: float | None, opening: float = 60.0) -> Scenario:
        sensors = replace(SCENARIO.sensors.equipment, floor=floor)
        sensors = replace(sensors, array=replace(sensors.array, beam_angle=np.radians(opening), pitch=0.0))
        return replace(SCENARIO, sensors=replace(SCENARIO.sensors, equipment=sensors))

    assert detection_range(over(None)) == SCENARIO.sensors.equipment.array.maximum == 4.5
    assert detection_range(over(2.15)) == pytest.approx(3.9)
    assert detection_range(replace(over(2.15), depths=(-1.15, 0.0))) == pytest.approx(1.9)
    assert detection_range(over(5.0)) == 4.5
    keys = [(f.level, f.key) for f in findings(over(0.4), VEHICLE, gains=GAINS)]
    assert ("error", "sonar.floor_m") in keys and ("warning", "sonar.floor_m") in keys
    [told] = [f for f in findings(over(9.0), VEHICLE, gains=GAINS) if f.key == "sonar.floor_m"]
    assert told.text.endswith("the site is 5 m deep: echoes of the floor mark obstacles")
    assert not [f for f in findings(over(5.05), VEHICLE, gains=GAINS) if f.key == "sonar.floor_m"]
