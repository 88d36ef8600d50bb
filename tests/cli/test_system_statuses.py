"""One rule of the exit status: 1 if a line says FAIL, or if a claim that is asked for is not proved."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from surctl.cli import lib
from surctl.cli.app import app
from surctl.export.check import BuildReport, CheckReport
from tests.cli.process import surctl_here
from tests.cli.test_lost_output import LOOP
from tests.tools import need_compiler

# the disk margin is that of the gain k, and the speed has decayed to 0.2 m/s after ln(5)/k
FILE = """
import casadi as ca
from surctl.ir import Layout, Port
from surctl.system import Controller, Cost, Plant, System

SPEED, FORCE = Port("speed", (1,), "m/s", "", 1.0), Port("force", (1,), "m/s^2", "")

def loop(k, at_most, within, **stops):
    plant = Plant("cart", Layout((SPEED,)), Layout((FORCE,)), lambda x, f, d, p: {"speed": f["force"]})
    law = Controller(
        "hold", 0.1, Layout((SPEED,)), Layout((FORCE,)), lambda x, u, p: -p["k"] * u["speed"],
        gains=Layout((Port("k", (1,), "1/s", "", k),)),
    )
    slow = Cost(lambda s: ca.fabs(s.x["speed"]) - 0.2, "last_time", "s", at_most=at_most)
    return System(plant, law, costs={"slow": slow}, duration=2.0, within=within, stops=stops)

BOX = {"speed": (-1.0, 1.0)}
def good():
    return loop(2.0, 1.0, BOX)
def slow():
    return loop(1.0, 1.0, BOX)
def wild():
    return loop(18.5, 1.9, {})
def halts():
    return loop(2.0, None, BOX, slower=lambda s: s.x["speed"] < 0.5)
"""
# k over which it is swept; whether the run fails (a bound is not met, or a stop ends it), and a margin
SYSTEMS = {"good": ("2,3", 0, 0), "slow": ("0.5,1", 1, 0), "wild": ("18,18.5", 0, 1), "halts": ("2,3", 1, 0)}
COMMANDS = {
    "simulate": "slow", "verify": "margin", "study": "both", "export": "both", "sweep": "both", "tune": "both",
}  # fmt: skip


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_line_that_fails_is_status_1_in_every_command(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need_compiler()
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(FILE)
    axis, slow, margin = SYSTEMS[name]
    figures: dict[str, set[float]] = {}
    for command, about in COMMANDS.items():
        words = [command, f"mine.py:{name}"]
        words += [f"k={axis}"] if command == "sweep" else ["k=1..2:2"] * (command == "study")
        words += ["--trials", "2", "--gain", f"k={axis.replace(',', '..')}"] if command == "tune" else []
        words += [] if command in ("simulate", "verify") else ["--out", command]
        done = CliRunner().invoke(app, [*words, "--verbose"])
        fails = any(line.lstrip().startswith("FAIL") for line in done.output.split("\n"))
        expected = {"slow": slow, "margin": margin, "both": slow or margin}[about]
        assert (done.exit_code, fails) == (expected, bool(expected)), (command, done.output, done.exception)
        if command in ("study", "export"):
            folder = Path(command, "export") if command == "study" else Path(command)
            assessed = json.loads((folder / "manifest.json").read_text())["evidence"]["assessment"]
            for key, figure in assessed["figures"].items():
                figures.setdefault(key, set()).add(figure["value"])
            assert ("region" in assessed["not_assessed"]) is (command == "export" or name == "wild")
    assert figures["disk_margin"] and all(len(values) <= 1 + (key == "region_share") for key, values in figures.items())


def test_results_of_other_options_are_replaced_with_their_command_and_not_silently(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need_compiler()
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(FILE)

    def surctl(*words: str) -> str:
        monkeypatch.setattr("sys.argv", ["surctl", *words])
        done = CliRunner().invoke(app, list(words))
        assert done.exit_code == 0, (done.output, done.exception)
        return done.stderr

    says = "contains results of another command, which this command replaces: "
    long, short = ("export", "mine.py:good", "--out", "c"), ("export", "mine.py:good", "--seconds", "1.5", "--out", "c")
    assert says not in surctl(*long) + surctl(*long, "--json", "--verbose")
    assert f"c {says}surctl {' '.join(long)}\n" in surctl(*short)
    study = ("study", "mine.py:good", "k=1.5..2:2", "--out", ".")
    assert says not in surctl(*study) + surctl(*study, "--workers", "1")
    assert f"export {says}surctl study mine.py:good k=1.5..2:2 --seconds 2 --out .\n" in surctl(
        "export", "mine.py:good", "--out", "export"
    )
    tune = ("tune", "mine.py:good", "--trials", "2", "--gain", "k=2..3", "--out", "t")
    assert says not in surctl(*tune) and f"t {says}surctl {' '.join(tune)}\n" in surctl(*tune, "--seed", "1")


def test_the_next_export_is_the_run_of_the_system_and_a_study_shows_its_region(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need_compiler()
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SURCTL_VERBOSE", raising=False)
    for duration, time in (("2.0", []), ("None", ["--seconds", "10"])):
        Path("mine.py").write_text(FILE.replace("duration=2.0", f"duration={duration}"))
        then = CliRunner().invoke(app, ["verify", "mine.py:good"]).stdout.split("next ")[-1]
        assert then.split() == ["surctl", "export", "mine.py:good", *time, "--out", "firmware"]
    words = ["study", "mine.py:good", "k=1.5..2:2", "--seconds", "2"]
    summary = CliRunner().invoke(app, words).stdout.splitlines()
    assert summary[1].startswith(
        "ok   region of attraction: proved cart (speed -0.99 to 0.99 m/s): sampled every 0.1 s"
    )
    assert len(summary) == 5
    assert summary[0].endswith(" All that is assessed holds. Next: least slow.")
    assert max(map(len, summary)) <= 100


def test_a_summary_of_a_sweep_says_at_which_point_a_line_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need_compiler()
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SURCTL_VERBOSE", raising=False)
    cost = '"slow": slow, "far": Cost(lambda s: s.x["speed"], "max", "m/s")'
    Path("mine.py").write_text(FILE.replace('"slow": slow', cost))
    shown = CliRunner().invoke(app, ["sweep", "mine.py:slow", "k=0.5,1", "--seconds", "2"]).stdout.splitlines()
    assert [line.partition(": slow = ")[0] for line in shown if line.startswith("FAIL")] == [
        "FAIL for the least slow", "FAIL for the least far",
    ]  # fmt: skip
    words = ["sweep", "mine.py:slow", "k=0.5..1", "start.speed=0.9..1", "--sensitivity", "far", "--points", "16"]
    shown = CliRunner().invoke(app, words).stdout.splitlines()  # the indices, although two lines fail
    assert shown[0].startswith("far: share of the variance (with interactions): start.speed 0.")
    assert ", k 0." in shown[0] and shown[1].startswith("FAIL for the least slow")


def test_a_summary_says_that_the_integration_step_is_too_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need_compiler()
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SURCTL_VERBOSE", raising=False)
    fast = '{"speed": f["force"] - 100 * x["speed"]}'
    Path("mine.py").write_text(FILE.replace('{"speed": f["force"]}', fast))
    for words in (("simulate",), ("sweep", "k=1,2"), ("tune", "--trials", "2", "--gain", "k=1..2", "--out", "t")):
        shown = CliRunner().invoke(app, [words[0], "mine.py:good", *words[1:]])
        assert shown.exit_code == 0 and shown.stdout.count("open the integration step is too long") == 1, shown.stdout


def test_a_cost_that_fails_is_shown_once_and_advice_of_the_parser_ends_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SURCTL_VERBOSE", raising=False)
    Path("loop.py").write_text(LOOP.replace('"at the end")', '"at the end", at_most=-1.0)'))
    shown = CliRunner().invoke(app, ["simulate", "loop.py:build", "--seconds", "1"]).stdout
    assert "\nFAIL final = 0.134218 m, at most -1 m" in shown and shown.count("final ") == 1
    for words, end in (
        (("--seconds", "abc"), "'abc' is not a valid float; see surctl simulate --help"),
        (("--sensng", "x"), "'--sensng' (Did you mean one of: '--seconds', '--sensing'); see surctl simulate --help"),
    ):
        wrong = surctl_here("simulate", "loop.py:build", *words, cwd=tmp_path)
        assert wrong.status == 2 and wrong.err.rstrip().endswith(end)


@pytest.mark.parametrize(("target", "remedy"), [("cortex-m3", "; use --real float32"), ("gcc-O0", "")])
def test_steps_that_differ_on_a_processor_without_double_have_a_remedy(
    target: str, remedy: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need_compiler()
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(FILE)
    report = CheckReport("float64", 1, 1, (BuildReport(target, "gcc", 2, 1, 0),), {})
    monkeypatch.setattr(lib, "check_builds", lambda *_, **__: report)
    done = CliRunner().invoke(app, ["export", "mine.py:good", "--check"])
    assert done.exit_code == 1 and f"NOT accepted: C and Python differ in --check{remedy}\n" in done.output
