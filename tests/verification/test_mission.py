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
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import mission
from surctl.marine.verification.mission import MissionClaim, MissionProof, mission_claim, prove_scenario, slower
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


def test_a_claim_about_a_start_at_rest_has_a_low_rate() -> None:
    scenario = load_scenario("tank-static")
    assert (claim(scenario).loop.rest, claim(scenario).loop.rate) == (True, 0.02)
    assert (claim(scenario, at_rest=False).loop.rest, claim(scenario, at_rest=False).loop.rate) == (False, 0.05)


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


def test_region_claims_that_no_chain_covers() -> None:
    scenario = load_scenario("tank-static")
    with pytest.raises(NotApplicable, match="not a region claim of the loop turning"):
        claim(scenario, region_statement("region-cruise-20"))
    with pytest.raises(NotApplicable, match="thrust lag"):
        claim(scenario, region_statement("region-turning-20-lag"))
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
    lower = slower(*about, cruise=0.2, cap=0.22)
    assert lower is not None
    assert (lower.claim.loop.cruise, lower.useful) == (0.04, True)
    assert slower(*about, cruise=2.0, cap=2.2) is None
