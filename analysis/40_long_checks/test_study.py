"""Studies: two vehicles and sonars of two kinds in one study, and a rudder craft's whole study."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from surctl.marine.simulation import load_scenario
from surctl.marine.study import Study, load_plan
from surctl.study import conduct_parts
from surctl.tuning import Axis
from tests.cli.process import surctl
from tests.pictures import blank_pictures
from tests.study.test_study import WIDE
from tests.tools import need_compiler


def test_the_study_of_a_rudder_craft_tells_margins_missions_and_limits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need_compiler()
    blank_pictures(monkeypatch)
    plan = load_plan(vehicle="lauv")
    plan = replace(plan, axes=(Axis("sideslip", (0.2,)),), legs=plan.legs[:1], sweep_seeds=(0,))
    study = Study(plan=plan, workers=1)
    conduct_parts(study, tmp_path)
    assert study.passed and [run.sensing for run in study.data.runs] == ["truth"]
    texts = [note.text for note in study.notes]
    for words in (
        "disk margin",
        "ranges of mass ±5% and of drag ±20%",
        "nothing at rest",
        "crab angle",
    ):
        assert any(words in text for text in texts), words
    assert study.sil[0].passed and study.to_dict()["linear"]["worst"]["disk_margin"] >= 0.4
    mission = load_scenario(str(tmp_path / "missions" / "straight-lauv.toml"))
    assert mission.path.waypoints.tolist() == plan.legs[0].scenario.path.waypoints.tolist()
    assert "disk margin" in study.report.read_text(encoding="utf-8")


# part of the runs and of the sweep of the built-in study
MAIN = """kind = "study"
name = "main"
vehicle = "sur540-flooded"
cruise_m_per_s = [0.05, 0.15]
[[runs]]
scenario = "tank-speed-015"
[[runs]]
scenario = "wide.toml"
vehicle = "sur400"
[sweep]
seeds = [0]
[[sweep.axes]]
gain = "lookahead"
values = [0.5, 0.8]
[[sweep.axes]]
gain = "k_v"
values = [1.5, 2.5]
"""


def test_only_flights_by_the_exported_law_are_replayed_and_claims_that_do_not_apply_are_left_out(
    tmp_path: Path,
) -> None:
    need_compiler()
    (tmp_path / "main.toml").write_text(MAIN)
    (tmp_path / "wide.toml").write_text(WIDE)
    done = surctl("study", "main.toml", "--json", cwd=tmp_path)
    data = done.json
    assert done.status == 1  # with the set `default`, the loop margins and the gain `margin` are too small
    failing = [line["about"] for line in data["assessment"]["lines"] if line["passed"] is False]
    assert failing == ["margins", "runs", "runs", "sweep", "margins"]
    # at tank-speed-015 the cap is the cruise speed: no claim about catching up
    left_out = [v["claim"] for v in data["verdicts"] if v["verdict"] == "not applicable"]
    assert left_out == ["v1-speed-cap", "v1-speed-cap-region"]
    assert all(v["verdict"] == v["expected"] for v in data["verdicts"] if v["claim"] not in left_out)
    runs = {(run["scenario"], run["sensing"]): run for run in data["runs"]}
    assert set(runs) == {(name, how) for name in ("tank-speed-015", "wide") for how in ("truth", "sonar")}
    for (name, how), run in runs.items():
        assert run["vehicle"] == ("sur540-flooded" if name.startswith("tank") else "sur400")
        assert run["decides"] == (how == "sonar") and run["reached"]
    (report,) = data["export"]["sil"]
    assert report["scenario"] == "tank-speed-015" and report["passed"] and report["fault_failures"] == []
    assert max(report["tau"], report["state"], report["telemetry"]) == 0.0
    (note,) = [note for note in data["assessment"]["lines"] if "other sensors" in note["text"]]
    assert note["passed"] is None and note["text"].startswith("wide by sur400, sonar")
