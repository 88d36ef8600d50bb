"""A study of a vehicle that fits no built-in scenario: missions scaled to it, and without sonars."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from surctl.control import build_law
from surctl.errors import InputError
from surctl.simulation import load_scenario
from surctl.study import conduct, load_plan
from surctl.study.shipping import with_perception
from surctl.tuning import Axis
from tests.pictures import blank_pictures
from tests.tools import need_compiler


@pytest.mark.parametrize("name", ["girona500", "lauv", "sur540-light"])
def test_a_library_vehicle_has_a_study(name: str) -> None:
    plan = load_plan(vehicle=name)
    assert plan.deciding and plan.axes and plan.vehicle.name == name
    if plan.vehicle["Fv_max"] == 0:
        assert plan.law == "steered" and "turning the hull" in plan.unheard
        assert [leg.misfit for leg in plan.legs] == [None] * 3
        assert with_perception(plan, plan.legs[0]).actuators == plan.vehicle.actuators


def test_sonar_for_a_craft_without_sway_force_is_refused_with_the_reason() -> None:
    with pytest.raises(InputError, match="supports only truth, because the sonar map is scanned by turning the hull"):
        build_law("steered", sonar=True)
    with pytest.raises(InputError, match="has its own vehicle"):
        load_plan("default", vehicle="otter")


def test_the_study_of_a_rudder_craft_tells_margins_missions_and_limits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need_compiler()
    blank_pictures(monkeypatch)
    plan = load_plan(vehicle="lauv")
    plan = replace(plan, axes=(Axis("sideslip", (0.2,)),), legs=plan.legs[:1], sweep_seeds=(0,))
    study = conduct(plan, tmp_path, workers=1)
    assert study.passed and [run.sensing for run in study.runs] == ["truth"]
    texts = [note.text for note in study.notes]
    for words in (
        "disk margin of all thrust loops",
        "mass off by ±5% and drag by ±20%",
        "nothing at rest",
        "crab angle",
    ):
        assert any(words in text for text in texts), words
    assert study.sil[0].passed and study.to_dict()["linear"]["worst"]["disk_margin"] >= 0.4
    mission = load_scenario(str(tmp_path / "missions" / "straight-lauv.toml"))
    assert mission.path.waypoints.tolist() == plan.legs[0].scenario.path.waypoints.tolist()
    assert "disk margin of all thrust loops" in study.report.read_text(encoding="utf-8")
