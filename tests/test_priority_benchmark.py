import importlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from tests.processes import run_python
from tests.tools import need_compiler

STUDY = Path(__file__).parents[1] / "analysis" / "05_priority_benchmark"
MODULES = ("cascades", "contender", "fast", "in_c", "instances", "ours", "peers", "run", "tables")


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return run_python([str(STUDY / "run.py"), *arguments], environment={**os.environ, **environment}, drawn=False)


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(str(STUDY))
    yield importlib.import_module("run")
    for name in MODULES:
        sys.modules.pop(name, None)


def test_a_wrong_answer_is_told(study: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    line = {"problem": "nsb", "typical": 1.0, "median": 1.0, "p99": 1.0, "hard": 1.0, "samples": 1, "asked": 9}
    right = study.Line(name="a", ours=True, silent=0, off=0, gap=1e-9, **line)
    theirs = study.Line(name="b", ours=False, silent=3, off=4, gap=1.0, **line)
    off = study.Line(name="c", ours=True, silent=0, off=1, gap=1e-3, **line)
    silent = study.Line(name="d", ours=True, silent=1, off=0, gap=0.0, **line)
    assert study.print_wrong([right, theirs])
    assert not study.print_wrong([right, off])
    assert not study.print_wrong([silent])
    assert "**Wrong**: c: 1 off by up to 1.0e-03" in capsys.readouterr().out


def test_a_bar_is_held_or_missed(study: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    assert study.print_bars([("low", 1.0, 2.0, True), ("high", 3.0, 2.0, False), ("none", None, 2.0, False)])
    assert not study.print_bars([("low", 3.0, 2.0, True)])
    assert not study.print_bars([("high", 1.0, 2.0, False)])
    assert not study.print_bars([("nan", float("nan"), 2.0, False)])
    assert capsys.readouterr().out.count("**missed**") == 3


def test_what_differs_is_counted(study: ModuleType) -> None:
    need_compiler()
    instances = study.draw_instances(8, seed=1)
    (fast, *_) = study.ours(instances, ["nsb"])

    def off(*tick: object) -> object:
        return fast.run(*tick) + 1e-3

    wrong = study.Contender("wrong", fast.problem, off, fast.ticks, ours=True)
    mute = study.Contender("mute", fast.problem, lambda *tick: None, fast.ticks)
    nan = study.Contender("nan", fast.problem, lambda *tick: off(*tick) * float("nan"), fast.ticks)
    timings = study.warm_up([fast, wrong, mute, nan])
    study.race([fast, wrong, mute, nan], timings, rounds=2, turn=3, budget=1.0)
    first, second, third, fourth = study.lines_of([fast, wrong, mute, nan], timings, {fast.problem: fast.name})
    assert (first.off, first.silent, first.asked, first.samples) == (0, 0, 8, 16)
    assert second.off == 8 and abs(second.gap - 1e-3) < 1e-12
    assert third.silent == 8
    assert fourth.off == 8


@pytest.mark.parametrize("arguments", [["--seed", "-1"], ["--rounds", "3"]])
def test_bad_options_end_with_2(arguments: list[str]) -> None:
    done = run(*arguments)
    assert done.returncode == 2 and "Traceback" not in done.stderr


def test_a_folder_that_cannot_be_written_ends_with_2(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    done = run("--quick", "--out", str(tmp_path / "file"))
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1 and "--out" in done.stderr


def test_without_a_compiler_it_ends_with_2(tmp_path: Path) -> None:
    done = run("--quick", "--out", str(tmp_path), CC="no-such-compiler")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
