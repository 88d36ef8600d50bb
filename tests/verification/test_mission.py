"""Claims about whole missions: which scenarios they apply to, and in which order proofs are tried."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from surctl.certcheck.mission import ON_LEG
from surctl.errors import NotApplicable
from surctl.marine.control import load_gains
from surctl.marine.guidance import path as guidance
from surctl.marine.simulation import Scenario, load_scenario
from surctl.marine.tuning import derive_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import mission
from surctl.marine.verification.mission import (
    MissionClaim,
    MissionProof,
    mission_claim,
    prove_mission,
    prove_scenario,
    slower,
)
from surctl.marine.verification.region import RegionStatement, region_statement

VEHICLE, GAINS = load_vehicle("sur540-flooded"), load_gains("default")


def claim(scenario: Scenario, statement: RegionStatement | None = None, **changes: Any) -> MissionClaim:
    known = {"cruise": 0.15, "cap": 0.22, "at_rest": True} | changes
    return mission_claim(scenario, VEHICLE, GAINS, statement or region_statement(mission.USUAL), **known)


def test_the_checkers_distance_is_that_of_the_law() -> None:
    assert float(ON_LEG) == guidance._ON_LEG


def test_the_yaw_rate_covers_the_corners() -> None:
    assert claim(load_scenario("tank-static")).loop.yaw_rate == 0.5
    turn = np.arctan2(2.6, 1.5) + np.arctan2(2.6, 2.0)
    assert claim(load_scenario("tank-slalom")).loop.yaw_rate == pytest.approx(GAINS["k_psi"] * turn, abs=1e-3)


def test_the_region_is_shaped_for_corners_and_for_the_start_at_rest() -> None:
    straight, bent = load_scenario("tank-static"), load_scenario("tank-slalom")
    assert claim(straight).loop.jumps == ((0.0, -0.15, 0.0),)
    moving = claim(straight, at_rest=False).loop
    assert (moving.jumps, moving.rate) == ((), 0.05)
    assert claim(straight).loop.rate == pytest.approx(0.1 * 0.15 / 9)
    loop = claim(bent, cruise=0.1).loop
    assert loop.rate == pytest.approx(0.6 * 0.1 / 1.5)  # the shortest leg
    legs = np.diff(bent.path.waypoints, axis=0)
    along, across = (legs[:-1] * legs[1:]).sum(axis=1), legs[:-1, 0] * legs[1:, 1] - legs[:-1, 1] * legs[1:, 0]
    sizes = np.linalg.norm(legs[1:], axis=1) * np.linalg.norm(legs[:-1], axis=1)
    jumps = np.array(loop.jumps)
    assert jumps[:8:2, 1:] == pytest.approx(0.1 * np.stack([along / sizes - 1, across / sizes], 1))
    assert jumps[-1].tolist() == [0.0, -0.1, 0.0]


@pytest.mark.parametrize(
    ("changes", "because"),
    [
        ({"corners": "visit"}, "stops at corners"),
        ({"disturbance": {"current_m_per_s": (0.03, 0.04)}}, "current of 0.05 m/s exceeds the 0 m/s"),
        ({"path": {"speeds": np.array([0.0, 0.1])}}, "changes the depth or the speed"),
        ({"path": {"rises": np.array([0.0, 0.1])}}, "changes the depth or the speed"),
    ],
)
def test_missions_that_the_claim_does_not_describe(changes: dict[str, Any], because: str) -> None:
    scenario = load_scenario("tank-static")
    if "path" in changes:
        changes = {"path": replace(scenario.path, **changes["path"])}
    if "disturbance" in changes:
        changes = {"disturbance": scenario.disturbance.model_copy(update=changes["disturbance"])}
    with pytest.raises(NotApplicable, match=because):
        claim(replace(scenario, **changes))


def test_lag_and_held_commands_are_those_of_the_region_claim() -> None:
    loop = claim(load_scenario("tank-static"), region_statement("region-cruise-20-lag"), at_rest=False).loop
    assert (loop.lag, loop.period) == (0.3, 0.05)


def test_region_claims_that_no_chain_covers() -> None:
    scenario = load_scenario("tank-static")
    craft, steered = load_vehicle("otter"), region_statement("region-steered-20")
    gains = derive_gains(craft, cruise=1.1).gains
    with pytest.raises(NotApplicable, match="region-steered-20 is not a claim about a cruise under the law guarded"):
        mission_claim(scenario, craft, gains, steered, cruise=1.1, cap=1.5, at_rest=False)
    with pytest.raises(NotApplicable, match="not below the cap"):
        claim(scenario, cruise=0.22)


def test_a_start_at_rest_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    def prove(one: MissionClaim, **_: Any) -> MissionProof:
        good = one.loop.cruise < (0.05 if one.at_rest else 0.1)
        return MissionProof(one, "proved" if good else "unknown", {}, "" if good else f"V at {one.loop.cruise:g}")

    monkeypatch.setattr(mission, "prove_mission", prove)
    about = load_scenario("tank-static"), VEHICLE, GAINS
    assert prove_scenario(*about, cruise=0.04, cap=0.22).useful
    moving = prove_scenario(*about, cruise=0.09, cap=0.22)
    assert (moving.verdict, moving.useful, moving.rest) == ("proved", False, "V at 0.09")
    neither = prove_scenario(*about, cruise=0.2, cap=0.22)
    assert neither.sentence == "unknown: from rest, V at 0.2; nor with the target's velocity: V at 0.2"


@pytest.mark.parametrize(
    ("rest", "moving", "found"), [(0.05, 0.1, (0.049, True)), (0.0, 0.1, (0.099, False)), (0.0, 0.001, None)]
)
def test_the_largest_lower_speed(
    rest: float, moving: float, found: tuple[float, bool] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = []

    def prove(one: MissionClaim, **_: Any) -> MissionProof:
        tried.append(one.loop.cruise)
        good = one.loop.cruise < (rest if one.at_rest else moving)
        return MissionProof(one, "proved" if good else "unknown", {}, "")

    monkeypatch.setattr(mission, "prove_mission", prove)
    lower = slower(load_scenario("tank-static"), VEHICLE, GAINS, cruise=0.2, cap=0.22)
    assert (lower and (lower.claim.loop.cruise, lower.claim.at_rest)) == found
    assert len(tried) <= 16


def test_the_longest_path_of_the_library_is_proved() -> None:
    scenario, statement = load_scenario("tank-slalom"), region_statement(mission.USUAL)
    one = mission_claim(scenario, VEHICLE, GAINS, statement, cruise=0.02, cap=0.22, at_rest=True)
    proof = prove_mission(one, attempts=24)
    assert (proof.verdict, proof.useful) == ("proved", True), proof.reason
    rates = [shell["rate"] for shell in proof.document["proof"]["loop"]["shells"]]
    assert max(rates) > 3 * rates[-1]  # V falls faster inside the region than at its border
