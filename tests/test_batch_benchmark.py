import importlib
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from surctl.marine.control import load_gains
from surctl.marine.simulation import Case, load_scenario
from surctl.marine.vehicle import load_vehicle
from tests.processes import run_python
from tests.tools import need_compiler

STUDY = Path(__file__).parents[1] / "analysis" / "07_batch_loop"
MODULES = ("contender", "hand", "numba_loop", "python_loop", "run", "scene")


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return run_python([str(STUDY / "run.py"), *arguments], environment={**os.environ, **environment})


def rows(printed: str, width: int) -> dict[str, list[str]]:
    """Table rows of that width by their first cell, without the rules under the heads."""
    split = [[cell.strip() for cell in line[1:-1].split("|")] for line in printed.splitlines() if line.startswith("| ")]
    return {row[0]: row[1:] for row in split if len(row) == width}


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> tuple[subprocess.CompletedProcess[str], Path]:
    need_compiler()
    out = tmp_path_factory.mktemp("batch") / "new"
    return run("--check", "--out", str(out)), out / "results.csv"


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(str(STUDY / "peers"))
    monkeypatch.syspath_prepend(str(STUDY))
    yield importlib.import_module("run")
    for name in MODULES:
        sys.modules.pop(name, None)


def test_everybody_flies_the_same_runs(quick: tuple[subprocess.CompletedProcess[str], Path]) -> None:
    done, _ = quick
    assert done.returncode == 0, done.stdout + done.stderr
    gaps = {name: float(row[0]) for name, row in rows(done.stdout, 2).items() if name != "the same runs"}
    assert {"simulate", "hand-written C -O2"} <= gaps.keys()
    assert all(gap <= 1e-6 for gap in gaps.values())


def test_everybody_is_timed_and_every_bar_judged(quick: tuple[subprocess.CompletedProcess[str], Path]) -> None:
    done, table = quick
    timed = rows(done.stdout, 7)
    assert {"simulate_batch", "simulate", "CasADi map", "CasADi mapaccum", "scipy solve_ivp"} < timed.keys()
    assert all(float(row[0]) > 0 for name, row in timed.items() if name != "who")
    bars = {name: row[-1] for name, row in rows(done.stdout, 4).items() if row[-1]}
    verdicts = [verdict for name, verdict in bars.items() if verdict in ("holds", "**missed**", "not measured")]
    assert len(verdicts) == 7
    assert len(table.read_text().splitlines()) == len(timed)  # one head each


def test_a_loop_that_flies_something_else_is_told(
    study: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    need_compiler()
    scenario = replace(load_scenario("tank-static"), time_limit=4.0)
    case = Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"))
    config = study.load_model(STUDY / "config.toml", study.Config)

    hand = study.HandLoop(tmp_path, ["-O0"])

    class Off:
        def run(self, *given: np.ndarray) -> np.ndarray:
            return hand.run(*given) * (1 + 1e-4)

    assert study.agree(case, {"-O2": Off()}, config, numba=False) is False
    assert "**Wrong**: hand-written C -O2" in capsys.readouterr().out


def test_a_figure_that_only_one_has_is_a_difference(study: ModuleType) -> None:
    nan = np.array([[np.nan, 1.0]])
    assert study.gap(nan, nan) == 0.0
    assert study.gap(nan, np.array([[1.0, 1.0]])) == np.inf
    assert study.gap(np.array([[np.inf, 1.5]]), np.array([[np.inf, 1.0]])) == 0.5


def test_ratios_are_of_the_least_disturbed_turns(study: ModuleType) -> None:
    one, two = (study.Contender(name, lambda: 1.0, 1) for name in "ab")
    one.cpu, two.cpu = [1.0, 10.0, 2.0], [4.0, 2.0]
    one.steps, two.steps = [1.0] * 3, [1.0] * 2
    assert study.ratio(two, one) == 2.0


def test_a_slow_contender_has_fewer_turns(study: ModuleType) -> None:
    fast, slow = study.Contender("a", lambda: 1.0, 1), study.Contender("b", lambda: 1.0, 1, 3)
    study.race([fast, slow], rounds=7)
    assert (len(fast.cpu), len(slow.cpu)) == (7, 3)


def test_the_line_of_growth(study: ModuleType) -> None:
    line = study.fit([1, 2, 3], [5.0, 7.0, 9.0])
    assert np.allclose([line.slope, line.intercept, line.r2], [2, 3, 1])
    assert study.fit([1, 2, 3], [0.0, 1.0, 0.0]).r2 < 0.1


def test_bars_are_held_or_missed(study: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    ours, numba = study.Contender(study.OURS, lambda: 1.0, 1), study.Contender("numba", lambda: 1.0, 1)
    for contender, spent in ((ours, 1.0), (numba, 4.0)):
        contender.cpu, contender.wall, contender.steps = [spent], [spent], [1.0]
    assert study.print_bars([ours, numba], {"numba": 3.0})
    assert not study.print_bars([ours, numba], {"numba": 5.0})
    assert not study.print_bars([ours], {"numba": 5.0})
    assert "not measured" in capsys.readouterr().out


@pytest.mark.parametrize(("wanted", "held"), [(0.0, True), (np.inf, False)])
def test_two_threads_are_judged_on_many_gain_sets(
    study: ModuleType, capsys: pytest.CaptureFixture[str], *, wanted: float, held: bool
) -> None:
    need_compiler()
    scenario = load_scenario("tank-static")
    size = study.load_model(STUDY / "config.toml", study.Config).quick
    case = Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"))
    assert study.print_many(case, size, wanted=wanted) is held
    printed = capsys.readouterr().out
    assert [row[-1] for row in rows(printed, 4).values() if row[-1] == "6400"] == ["6400"] * 2, "steps of each"
    assert ("holds" if held else "**missed**") in printed


@pytest.mark.parametrize("arguments", [["--runs", "3"], ["--check", "--out", __file__]])
def test_bad_options_end_with_2(arguments: list[str]) -> None:
    done = run(*arguments)
    assert done.returncode == 2 and "Traceback" not in done.stderr


def test_without_a_compiler_it_ends_with_2(tmp_path: Path) -> None:
    done = run("--check", "--out", str(tmp_path), CC="no-such-compiler")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
