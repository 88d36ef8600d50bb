"""Studies: a rudder craft's whole study."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from surctl.simulation import load_scenario
from surctl.study import conduct, load_plan
from surctl.tuning import Axis
from tests.pictures import blank_pictures
from tests.tools import need_compiler


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
