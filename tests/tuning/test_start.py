"""A search starts from the gains derived from each vehicle, within the ranges."""

from __future__ import annotations

from surctl.marine.control import load_gains
from surctl.marine.simulation import Case, load_scenario
from surctl.marine.tuning import Goal, Request, conditions, derive_gains, gain_ranges
from surctl.marine.vehicle import load_vehicle

NEAR = (Goal("near", "deviation_m", "m", 0.1),)


def test_a_search_starts_from_the_derived_gains_within_the_ranges() -> None:
    scenario, vehicle = load_scenario("pool-behind"), load_vehicle("sur400")
    poor = load_gains("default").with_values({"lookahead": 2.0})
    space = gain_ranges(poor, {"k_v": (0.9, 1.0), "lookahead": (0.3, 2.5), "lambda1": (0.05, 30.0)})
    runs = conditions([Case(scenario, vehicle, poor)], seeds=[0], with_corners=False)
    [start] = Request(NEAR, runs, poor, space).first_sets()
    derived = derive_gains(vehicle, cruise=scenario.cruise).gains
    assert derived["k_v"] > 1.0 and derived["lookahead"] != poor["lookahead"]
    assert start == {"k_v": 1.0, "lookahead": derived["lookahead"], "lambda1": poor["lambda1"]}


def test_a_vehicle_that_cannot_hold_its_speed_has_no_start_and_no_advice_that_no_option_can_set() -> None:
    gains, weak = load_gains("default"), load_vehicle("sur400").with_values({"Fu_max": 0.5})
    runs = conditions([Case(load_scenario("pool-behind"), weak, gains)], seeds=[0], with_corners=False)
    lines: list[str] = []
    request = Request(NEAR, runs, gains, gain_ranges(gains, ["k_v"]))
    assert request.first_sets(lines.append) == []
    assert len(lines) == 1 and lines[0].endswith("the search starts without derived gains")
