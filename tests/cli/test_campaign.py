"""Campaigns from the command line."""

import csv
import json
import re
import signal
from pathlib import Path

import pytest

from tests.cli.process import LIBRARY, surctl, surctl_here
from tests.processes import Running
from tests.tools import need_compiler

SOON = ["simulate", "short.toml", "--law", "closed_form", "--monte-carlo"]
MANY = [*SOON, "--out", "mc"]


@pytest.fixture
def short(tmp_path):
    """The folder, with the first seconds of a built-in scenario in it."""
    text = (LIBRARY / "marine" / "simulation" / "library" / "pool-speed-010.toml").read_text()
    (tmp_path / "short.toml").write_text(re.sub(r"(?m)^time_limit_s = .*", "time_limit_s = 10.0", text))
    return tmp_path


def kept(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_campaign_is_told_and_its_worst_run_flown_again(tmp_path):
    # the overtaker, drawn faster than the cap, is not outrun
    done = surctl(
        "simulate",
        "pool-behind",
        "--monte-carlo",
        "--out",
        "mc",
        "--runs",
        "30",
        "--worst",
        "1",
        "--json",
        cwd=tmp_path,
    )
    assert done.status == 1  # some collide
    (told,) = done.json["campaigns"]
    assert told == json.loads((tmp_path / "mc" / "summary.json").read_text())["campaigns"][0]
    hit = told["stopped"]["collision"]
    assert 0 < hit["count"] / 30 == hit["rate"] < hit["at_most_95"] < 1
    with (tmp_path / "mc" / "pool-behind.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(told["runs"]) == 30 and sum(int(row["collided"]) for row in rows) == hit["count"]
    worst = told["worst"][0]
    assert worst["broken_assumptions"] == ["obstacle speed"] and len(told["worst"]) == 1
    again = surctl("simulate", "--from", f"mc/{worst['file']}", "--out", "plots", "--json", cwd=tmp_path)
    (run,) = again.json["runs"]
    assert again.status == 1 and run["same"] and run["largest_difference"] <= 1e-9 and run["seed"] == worst["seed"]
    assert run["min_clearance_m"] == pytest.approx(worst["min_clearance_m"], abs=1e-9)
    assert len(list((tmp_path / "plots").glob("*.png"))) == 1


def test_many_runs_are_not_printed_one_by_one(short):
    done = surctl(*SOON, "--runs", "101", "--json", cwd=short)
    assert "runs" not in done.json["campaigns"][0] and done.json["campaigns"][0]["number_of_runs"] == 101
    assert [path.name for path in short.iterdir()] == ["short.toml"]


def test_an_altered_figure_is_found_out(short):
    surctl(*MANY, "--runs", "1", "--worst", "1", cwd=short)
    (file,) = (short / "mc" / "worst").iterdir()
    file.write_text(file.read_text().replace("\ntime_s = ", "\ntime_s = 1"))
    done = surctl("simulate", "--from", str(file), cwd=short)
    assert done.status == 1 and "NOT as in the campaign" in done.out


def test_killed_halfway_the_same_command_ends_with_the_same_bytes(short):
    need_compiler()
    runs = ["--runs", "201", "--threads"]  # three chunks
    surctl(*SOON, "--runs", "1", cwd=short)  # compiled
    chunks = short / "mc" / "campaign.chunks" / "pool-speed-010"
    with Running(["-m", "surctl", *MANY, *runs, "1"], cwd=short) as process:
        process.until(lambda: list(chunks.glob("*.chunk")))
        process.send(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
    done = {p.name: p.stat().st_mtime_ns for p in chunks.glob("*.chunk")}
    assert 1 <= len(done) < 3 and not (short / "mc" / "pool-speed-010.csv").exists()
    again = surctl(*MANY, *runs, "2", cwd=short)
    assert again.status == 1  # no run arrives so soon
    assert all((chunks / name).stat().st_mtime_ns == made for name, made in done.items())
    whole = surctl(*SOON, "--out", "whole", *runs, "1", cwd=short)
    assert whole.out.replace("whole/", "mc/") == again.out
    assert kept(short / "mc") == kept(short / "whole")


def test_random_worlds_are_flown_and_kept(tmp_path):
    done = surctl(
        "simulate",
        "--random-worlds",
        "2",
        "--seed",
        "4",
        "--law",
        "closed_form",
        "--worst",
        "1",
        "--out",
        "w",
        "--json",
        cwd=tmp_path,
    )
    (told,) = done.json["campaigns"]
    assert told["number_of_runs"] == 2 and [row["seed"] for row in told["runs"]] == [4, 5]
    (worst,) = told["worst"]
    assert f'"world-{worst["seed"]}"' in (tmp_path / "w" / worst["file"]).read_text()  # flown again: as above


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--monte-carlo"], "needs a scenario"),
        ([], "needs a scenario"),
        (["tank-static", "--fresh"], "--fresh = True: applies only to a campaign"),
        (["tank-static", "--worst", "3"], "--worst = 3: applies only to a campaign"),
        (["tank-static", "--threads", "3"], "--threads = 3: applies only to a campaign"),
        (["tank-static", "--monte-carlo", "--explain"], "--explain: applies only to single runs"),
        (["tank-static", "--monte-carlo", "--fresh"], "--fresh: needs an output folder"),
        (["tank-static", "--monte-carlo", "--worst", "2"], "--worst: needs an output folder"),
        (["tank-static", "tank-static", "--monte-carlo"], "is named twice"),
        (["tank-static", "--random-worlds", "5"], "draws its own scenarios"),
        (["--random-worlds", "5", "--runs", "6"], "already sets the number of runs"),
        (["--random-worlds", "0"], "--random-worlds"),
        (["tank-statik", "--monte-carlo"], "did you mean 'tank-static'"),
        (["tank-static", "--monte-carlo", "--law", "papre"], "law = 'papre'"),
        (["tank-static", "--monte-carlo", "--avoidance", "printed"], "accepts only the corrected form"),
        (["tank-static", "--monte-carlo", "--chance", "dropout=0.1"], "has no effect with true positions"),
        (["tank-static", "--monte-carlo", "--out", "/dev/null"], "--out"),
        (["--from", "none.toml"], "none.toml: no such file"),
        (["--from", "none.toml", "--law", "paper"], "drop --law"),
        (["tank-static", "--from", "none.toml"], "already sets the scenarios; drop the scenarios, or edit the file"),
        (["--from", "none.toml", "--random-worlds", "3"], "drop --random-worlds, or edit the file"),
    ],
)
def test_mistakes_are_told_in_one_line(words, complaint, tmp_path):
    done = surctl_here("simulate", *words, cwd=tmp_path)
    assert done.status == 2 and complaint in done.complaint and done.out == ""
    assert list(tmp_path.iterdir()) == []


def test_a_run_file_of_another_kind_is_told(tmp_path):
    (tmp_path / "s.toml").write_text(
        (Path(__file__).parents[2] / "surctl/marine/simulation/library/tank-static.toml").read_text()
    )
    done = surctl_here("simulate", "--from", "s.toml", cwd=tmp_path)
    assert done.status == 2 and "kind = 'scenario'" in done.complaint
