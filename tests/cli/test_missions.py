"""`surctl verify mission`: the claim about the path of a scenario."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from surctl.cli.verify import Decided, decide_claims
from surctl.errors import InputError, NotApplicable
from surctl.marine.assessment import Mission
from surctl.marine.cli.claims import is_mission, mission_claims
from surctl.marine.control import load_gains
from surctl.marine.simulation import Scenario, load_scenario
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import mission
from surctl.marine.verification.mission import MissionClaim, MissionProof, certificate_of, mission_claim
from surctl.marine.verification.region import region_statement
from tests.cli.process import surctl_here

MEMBER = Path(__file__).parents[1] / "certcheck" / "region-turning.json"
VEHICLE, GAINS = load_vehicle("sur540-flooded"), load_gains("default")
ABOUT = Mission(VEHICLE, GAINS, 0.15, 0.22, "guarded")


def decided(scenario: Scenario, out: Path | None = None, **changed: Any) -> Decided:
    """The claim `mission` about a scenario, decided."""
    claims = mission_claims(["mission"], scenario, replace(ABOUT, **changed), out=out)
    [done] = decide_claims(claims, out=out, as_json=True)
    return done


def proof(claim: MissionClaim) -> MissionProof:
    """Return a proof whose region is that of another vehicle."""
    document = certificate_of(claim, json.loads(MEMBER.read_text()))
    return MissionProof(claim, "proved", document, "", (0.1, 0.2), 0.3, 0.1)


def test_words_of_missions() -> None:
    assert is_mission("mission")
    assert is_mission("mission:region-turning-20")
    assert not is_mission("missions")


def test_a_mission_needs_its_scenario(tmp_path: Path) -> None:
    done = surctl_here("verify", "mission", cwd=tmp_path)
    assert done.status == 2
    assert "is about the path of a scenario" in done.err
    assert "--scenario" in done.err
    with pytest.raises(InputError, match="second claim about the mission"):
        mission_claims(["mission", "mission:region-turning"], load_scenario("tank-static"), ABOUT)


def test_a_proof_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mission, "prove_mission", lambda claim, **_: proof(claim))
    done = decided(load_scenario("tank-static"), out=tmp_path)
    [line], [file] = done.lines, done.files
    assert line.startswith(
        "ok   mission-tank-static    proved without obstacles, walls, thrust lag and held commands: "
    )
    assert json.loads(file.read_text())["kind"] == "mission"
    assert (done.data["verdict"], done.data["at_rest"]) == ("proved", True)


def test_a_mission_that_is_not_proved_names_a_lower_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = load_scenario("tank-static")

    def slow(claim: MissionClaim, **_: Any) -> MissionProof:
        return proof(claim) if claim.loop.cruise < 0.1 else MissionProof(claim, "unknown", {}, "V may grow to 2")

    monkeypatch.setattr(mission, "prove_mission", slow)
    for speed, word in ((0.15, "unknown: from rest, V may grow to 2"), (0.22, "not applicable to these speeds")):
        done = decided(scenario, cruise=speed)
        assert f"; at {speed} m/s, {word}" in done.lines[0]
        assert done.lines[0][28:].startswith("with --cruise 0.09")
        assert done.data["at_lower_speed"]["verdict"] == "proved"


def test_a_mission_under_another_law_is_not_applicable() -> None:
    done = decided(load_scenario("tank-static"), law="calm")
    assert "not applicable to law calm" in done.lines[0]


def test_a_mission_with_visits_is_not_applicable() -> None:
    scenario = replace(load_scenario("tank-slalom"), corners="visit")
    done = decided(scenario)
    assert "not applicable to this mission, because the robot stops at corners that it visits" in done.lines[0]
    with pytest.raises(NotApplicable):
        mission_claim(scenario, VEHICLE, GAINS, region_statement(mission.USUAL), cruise=0.15, cap=0.22, at_rest=True)
