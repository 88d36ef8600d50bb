"""The rule of the exit status for vehicles: 1 if a line of the assessment that counts fails, in every command."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from surctl.cli.app import app
from surctl.cli.output import finish
from surctl.marine.control import load_gains, write_gains
from surctl.marine.vehicle import load_vehicle, write_vehicle
from tests.pictures import blank_pictures
from tests.tools import need_compiler

STUDY = """
kind = "study"
name = "mine"
vehicle = "sur400"
gains = "g.toml"
claims = ["m-norm-corrected"]
[[runs]]
scenario = "pool-behind"
[[goals]]
name = "in time"
metric = "time_s"
at_most = "60 s"
kind = "soft"
"""
WORDS = ("--scenario", "pool-behind", "--gains", "g.toml")
TUNING = ("--gain", "lookahead", "--trials", "2", "--seeds", "1", "--rounds", "1", "--monte-carlo", "0")
COMMANDS: dict[str, tuple[str, ...]] = {
    "verify": ("m-norm-corrected", *WORDS),
    "export": (*WORDS, "--out", "code"),
    "sweep": ("k_v=1.4,1.5", *WORDS, "--sensing", "sonar", "--out", "swept"),
    "tune": ("s.toml", *TUNING, "--out", "tuned"),
    "study": ("s.toml", "--out", "studied"),
}


def invoked(*words: str) -> Result:
    return CliRunner().invoke(app, words)


def contact(data: dict[str, Any]) -> dict[str, Any]:
    """The line about no contact in the JSON of a command."""
    if "assessments" in data:
        [table] = data["assessments"]
    else:
        table = data["assessment"]
    lines = table["after"]["lines"] if "after" in table else table["lines"]
    [line] = [line for line in lines if line["text"].startswith("no contact")]
    return dict(line)


@pytest.fixture
def lines(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What commands print without --json, also of runs with it; pictures are blank."""
    blank_pictures(monkeypatch)
    found: list[str] = []

    def noted(result: Mapping[str, Any], printed: Sequence[str], **options: Any) -> None:
        found.extend(printed)
        finish(result, printed, **options)

    for module in ("marine.cli.verify", "cli.export", "cli.sweep", "cli.tune", "cli.study"):
        monkeypatch.setattr(import_module(f"surctl.{module}"), "finish", noted)
    return found


@pytest.mark.parametrize("margin", [0.05, 0.06])  # by sonar, 0.0543 m are needed
@pytest.mark.parametrize("command", COMMANDS)
def test_a_failing_no_contact_line_is_status_1(
    command: str, margin: float, lines: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need_compiler()
    monkeypatch.chdir(tmp_path)
    Path("g.toml").write_text(write_gains(load_gains("default").with_values({"margin": margin})))
    Path("s.toml").write_text(STUDY)
    done = invoked(command, *COMMANDS[command], "--json")
    line = contact(json.loads(done.stdout))
    assert line["passed"] is (margin > 0.0543) and " by sonar " in line["text"]
    assert done.exit_code == int(not line["passed"]), (done.output, done.exception)
    assert any("NOT accepted: " in text for text in lines) is (not line["passed"]), lines


@pytest.mark.parametrize("sensing", [None, "truth"])
def test_verify_and_export_judge_no_contact_by_the_same_sensing(
    sensing: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need_compiler()
    monkeypatch.chdir(tmp_path)
    gains = load_gains("default").with_values({"margin": 0.0535})  # with true positions, 0.0529 m are needed
    Path("g.toml").write_text(write_gains(gains))
    words = () if sensing is None else ("--sensing", sensing)
    lines = []
    for command in ("verify", "export"):
        done = invoked(command, *COMMANDS[command], *words, "--json")
        lines.append(contact(json.loads(done.stdout)))
        assert done.exit_code == int(sensing is None), command
    assert lines[0] == lines[1] and ("by sonar" in lines[0]["text"]) is (sensing is None)


def test_a_law_without_the_barrier_has_no_no_contact_claim(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ("verify", "m-norm-corrected", "--scenario", "pool-behind", "--law", "closed_form")
    line = contact(json.loads(invoked(*words, "--json").stdout))
    assert line["passed"] is None and "concerns law guarded and this is closed_form" in line["text"]
    refused = invoked(*words, "--sensing", "sonar")
    assert "set --sensing truth" in str(refused.exception)


def test_a_gain_of_ones_own_named_like_a_number_of_a_claim_is_exported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need_compiler()
    monkeypatch.chdir(Path(__file__).parents[2] / "analysis" / "27_own_law")  # its law has the gain radius = 0
    mission = ("--scenario", "orbit.toml", "--sensing", "truth", "--law", "station.py:station")
    done = invoked("export", *mission, "--out", str(tmp_path / "code"))
    assert done.exit_code == 0 and "exported; accepted: " in done.stdout, (done.output, done.exception)


def test_no_contact_that_holds_says_on_which_refuted_claim_it_does_not_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    late = load_vehicle("sur400").with_values({"Xuu": 80.0, "Yvv": 80.0, "thrust_lag": 2.0})
    Path("v.toml").write_text(write_vehicle(late))
    Path("g.toml").write_text(write_gains(load_gains("default").with_values({"margin": 2.0})))
    done = invoked("verify", "braking-retreat", "braking-mass", *WORDS, "--vehicle", "v.toml", "--verbose")
    assert done.exit_code == 1 and "braking-retreat is refuted, not proved" in done.stdout
    assert "no contact in pool-behind by sonar holds for obstacles at rest: margin 2 m" in done.stdout
    [beside] = [line for line in done.stdout.splitlines() if line.startswith("no contact does not rest on ")]
    assert "braking-retreat: it is about distances that count during a retreat" in beside
