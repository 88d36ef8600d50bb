"""The rows together: none missing, each on the page, and the command line as a process.

`analysis/40_long_checks` computes all of them.
"""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from surctl.cli.app import app
from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.reproduction import WORDS, Item, Reproduction, Result, Simulations, items, reproduce, required
from surctl.marine.reproduction import reproduction as reproducing
from surctl.marine.reproduction.range_test import RangeTest
from surctl.marine.reproduction.reproduction import claim_items, judged, table_items, write_reproduction
from surctl.marine.reproduction.row import agrees
from surctl.marine.reproduction.scenarios import scenario_names
from surctl.marine.simulation import load_scenario, simulate
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import claims
from tests.cli.process import surctl
from tests.pictures import blank_pictures
from tests.report.reader import Reader

KEYS = {
    "id",
    "group",
    "what",
    "paper",
    "ours",
    "verdict",
    "expected",
    "as_expected",
    "numbers",
    "command",
    "seconds",
    "independent",
    "webots",
}


def test_no_row_is_missing_and_no_id_is_used_twice() -> None:
    ids = [item.id for item in items(Simulations(1))]
    assert len(set(ids)) == len(ids)
    assert set(required()) <= set(ids)
    assert len(required()) == 14 + 36 + 21 + 14 + 2


def test_the_commands_name_rows_and_claims_that_exist() -> None:
    all_items = items(Simulations(1))
    known = {item.id for item in all_items} | {claim.name for claim in claims() if claim.paper}
    for item in all_items:
        program, command, name, *rest = item.command.split()
        assert program == "surctl" and command in app.commands and name == item.id and name in known
        assert rest in ([], ["--seeds", "1"], ["--cruise", "0.15", "--cap", "0.25"])


def test_a_quick_row_is_computed_by_a_quick_command() -> None:
    quick = [item for item in items(Simulations(3), samples=512) if item.group == "claims"]
    assert {item.command for item in quick} == {f"surctl reproduce {item.id} --quick" for item in quick}


def test_the_command_of_a_row_has_the_options_that_apply_to_it() -> None:
    commands = {item.id: item.command for item in items(replace(Simulations(2), independent=True, webots=True))}
    assert commands["pool-static"] == "surctl reproduce pool-static --seeds 2 --independent"
    assert commands["pool-static-sonar"] == "surctl reproduce pool-static-sonar --seeds 2 --independent --webots"
    assert commands["E5"] == "surctl reproduce E5"


def test_a_percentage_that_is_recomputed_otherwise_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [item.row() for item in table_items()]
    assert all(row.as_expected for row in rows)
    assert [row.item.id for row in rows if row.result.word == "wrong in print"] == ["table-ii-water-085"]
    other = lambda self, medium: 100 * np.abs(self.errors(medium)) / self.column(medium).measured  # noqa: E731
    monkeypatch.setattr(RangeTest, "percent", other)
    assert sum(not item.row().as_expected for item in table_items()) > 5


def test_a_sensor_with_more_bits_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reproducing, "SonarArray", partial(reproducing.SonarArray, bits=10))
    failing = [row.item.id for row in (item.row() for item in table_items()) if not row.as_expected]
    assert failing == ["table-i-resolution"]


def test_a_claim_that_comes_out_otherwise_is_noticed() -> None:
    item = next(item for item in claim_items({}, samples=256) if item.id == "course-corrected")
    assert item.row().as_expected
    claim = claims(names=["course-corrected"])[0]
    wrong = replace(item, compute=partial(judged, replace(claim, left=-claim.left), 256))
    assert not wrong.row().as_expected


def test_a_row_that_cannot_be_computed_fails_and_says_why() -> None:
    def broken() -> Result:
        raise InputError("is broken", key="it")

    row = Item("x", "errata", "", "", None, broken, "surctl reproduce x").row()
    assert not row.as_expected and "is broken" in row.result.verdict


def test_a_verdict_has_its_reason() -> None:
    for word in ("differs", "wrong in print"):
        with pytest.raises(InputError, match="needs a reason"):
            Result("1", word)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="is not a verdict"):
        Result("1", "perhaps")  # type: ignore[arg-type]


def test_chosen_rows_in_their_order_and_the_nearest_to_a_wrong_one() -> None:
    done = reproduce(["E21", "E2"], quick=True)
    assert done.seeds == 3
    assert [row.item.id for row in done.rows] == ["E21", "E2"] and done.passed and done.missing == ()
    with pytest.raises(InputError, match="did you mean 'course-printed'"):
        reproduce(["course-printd"])


def test_rows_of_every_group_as_json(tmp_path: Path) -> None:
    chosen = ["course-printed", "table-ii-water-085", "table-i-minimum", "E3", "tank-static", "tank-static-transients"]
    done = surctl("reproduce", *chosen, "--quick", "--seeds", "1", "--json", cwd=tmp_path)
    data = done.json
    assert done.status == 0 and data["passed"]
    assert data["seeds"] == 1 and data["missing"] == []
    assert [row["id"] for row in data["rows"]] == chosen
    for row in data["rows"]:
        assert set(row) == KEYS
        assert row["verdict"].split(":")[0] in WORDS
        assert row["ours"] and row["paper"] and row["command"].startswith("surctl ") and row["seconds"] >= 0
        assert row["expected"] in (None, row["verdict"].split(":")[0]) and row["as_expected"], row


def test_the_page_holds_every_row_and_figure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The rows are not computed, and the runs are one of 1 s under the names of all scenarios."""
    blank_pictures(monkeypatch)
    scenario = replace(load_scenario("tank-static"), time_limit=1.0)
    run = simulate(scenario, load_vehicle(scenario.vehicle), gains=load_gains("default"))
    made = Simulations(1)
    made._runs.update({(name, "truth"): replace(run, scenario=load_scenario(name)) for name in scenario_names()})
    rows = tuple(replace(item, compute=lambda: agrees("1")).row() for item in items(made))
    page = write_reproduction(Reproduction(rows, (), 1, made), tmp_path / "page.html", command="surctl reproduce")
    text = page.read_text(encoding="utf-8")
    read = Reader(text)
    assert read.mistakes == []
    shown = " ".join(read.texts)
    assert all(name in shown for name in required())
    assert len(read.all("img")) == 14 * 2 + 4 + 2  # plan and coordinates, two series, two position errors
    assert not re.search(r"(https?:)?//[a-z]", re.sub(r'"data:[^"]*"', "", text))


def test_rows_as_a_process(tmp_path: Path) -> None:
    done = surctl("reproduce", "E2", "E5", "course-printed", "--out", "paper", cwd=tmp_path)
    assert done.status == 0
    assert "residual × -1.000" in done.out and "3 wrong in print; 3 of 3 rows as expected" in done.out
    assert "course-printed" in (tmp_path / "paper" / "reproduction.html").read_text(encoding="utf-8")


def test_verify_gives_the_figures_of_a_claims_row(tmp_path: Path) -> None:
    row = reproduce(["course-printed"]).rows[0]
    assert row.item.command == "surctl verify course-printed --cruise 0.15 --cap 0.25"
    verdict = surctl(*row.item.command.split()[1:], "--json", cwd=tmp_path).json["claims"][0]
    assert verdict["counterexample"]["margin"] == row.result.numbers["margin"]
    assert verdict["fraction"] == row.result.numbers["fraction"]
