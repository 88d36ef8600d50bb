"""Ctrl-C and kill -9: what is kept is there; Ctrl-C ends with status 130 and one line that is true."""

from __future__ import annotations

import re
import signal
import time
from pathlib import Path

import pytest

from tests.cli.process import surctl_here
from tests.cli.test_lost_output import LOOP
from tests.processes import Running

SWEEP = ("sweep", "k_v=1..3:4000", "--scenario", "tank-static", "--seeds", "50", "--workers", "1", "--out", "a sweep")
CASES = {
    "sweep": (SWEEP, "points,", "the finished points are in a sweep; to continue: surctl sweep", "'a sweep'"),
}


@pytest.mark.parametrize("case", CASES)
def test_ctrl_c_says_what_is_kept(case: str, tmp_path: Path) -> None:
    words, begun, kept, again = CASES[case]
    with Running(["-m", "surctl", *words], cwd=tmp_path) as running:
        running.until(lambda: begun in running.err)
        running.send(signal.SIGINT)
        status, out, err = running.wait(), running.out, running.err
    last = err.splitlines()[-1]
    assert status == 130, (out, err)
    assert last.startswith("surctl: stopped; ") and kept in last and again in last, err
    assert "Traceback" not in err
    assert any((tmp_path / "a sweep").iterdir()) and out == ""


@pytest.mark.parametrize("moment", range(10))
def test_ctrl_c_at_any_moment_is_one_line(moment: int, tmp_path: Path) -> None:
    (tmp_path / "loop.py").write_text(LOOP)
    words = ("tune", "loop.py:build", "--seconds", "20", "--trials", "1000000", "--out", "out")
    with Running(["-m", "surctl", *words], cwd=tmp_path) as running:
        running.until(lambda: "for each gain set" in running.err)
        if moment > 5:
            running.until((tmp_path / "out" / "best-so-far.csv").exists)
        time.sleep(0.03 * moment)
        running.send(signal.SIGINT)
        status, err = running.wait(), running.err
    # a compiler that is interrupted while it starts leaves a pipe open; Python hides this warning by default
    err = re.sub(r"(?s)Exception ignored in: <_io\..*?ResourceWarning: [^\n]*\n", "", err)
    last = err.splitlines()[-1]
    line = "surctl: stopped; " if moment > 5 else "surctl: stopped"  # with finished gain sets, it names their file
    assert status == 130 and last.startswith(line) and "Traceback" not in err, err
    assert not (tmp_path / "out" / "gains.csv").exists()
    assert moment <= 5 or (tmp_path / "out" / "best-so-far.csv").read_text().startswith("k,q\n")


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_what_an_unfinished_tuning_has_found_is_a_whole_file_of_its_own(sent: signal.Signals, tmp_path: Path) -> None:
    (tmp_path / "loop.py").write_text(LOOP)
    (tmp_path / "out").mkdir()
    words = ["-m", "surctl", "tune", "loop.py:build", "--trials", "1000000", "--seconds", "200", "--out", "out"]
    with Running(words, cwd=tmp_path) as running:
        running.until((tmp_path / "out" / "best-so-far.csv").exists)
        running.send(sent)
        status, err = running.wait(), running.err
    rows = (tmp_path / "out" / "best-so-far.csv").read_text().splitlines()
    assert not (tmp_path / "out" / "gains.csv").exists()
    assert len(rows) > 1 and len({row.count(",") for row in rows}) == 1
    if sent == signal.SIGINT:
        assert status == 130 and "Traceback" not in err and "best-so-far.csv" in err.splitlines()[-1]


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_a_stopped_sweep_of_a_system_resumes(sent: signal.Signals, tmp_path: Path) -> None:
    (tmp_path / "loop.py").write_text(LOOP)
    words = ["-m", "surctl", "sweep", "loop.py:build", "k=1..9:1000", "q=1..9:1000", "--seconds", "50", "--out", "out"]
    with Running(words, cwd=tmp_path) as running:
        running.until(lambda: list(tmp_path.glob("out/sweep.chunks/*/*.chunk")))
        running.send(sent)
        status, err = running.wait(), running.err
    stored = len(list(tmp_path.glob("out/sweep.chunks/*/*.chunk")))
    assert not (tmp_path / "out" / "sweep.csv").exists()
    if sent == signal.SIGINT:
        last = err.splitlines()[-1]
        assert status == 130 and "Traceback" not in err
        assert "the finished runs are in out; to continue: surctl sweep loop.py:build k=1..9:1000" in last
    with Running(words, cwd=tmp_path) as running:
        running.until(lambda: "runs" in running.err)
        running.send(signal.SIGKILL)
        running.wait()
        assert f"sweep {4096 * stored}/1000000 runs" in running.err


@pytest.mark.parametrize("part", ["assess", "sweep"])
def test_a_stopped_study_of_a_system_prints_its_run_and_says_how_to_continue(
    part: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    (tmp_path / "loop.py").write_text(LOOP)
    monkeypatch.setattr(f"surctl.cli.system_study.{part}", stopped)
    done = surctl_here("study", "loop.py:build", "--seconds", "1", "--out", "out", cwd=tmp_path)
    assert done.status == 130 and "final" in done.out, done
    last = done.err.splitlines()[-1]
    assert last.startswith("surctl: stopped; what is finished is in out; to continue: surctl study loop.py:build")
    assert (tmp_path / "out" / "export" / "hold.c").exists()


def test_margins_are_printed_where_the_search_for_a_region_is_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    (tmp_path / "loop.py").write_text(LOOP)
    monkeypatch.setattr("surctl.lyapunov.solve", stopped)
    done = surctl_here("verify", "loop.py:build", "within.x=-1..1", cwd=tmp_path)
    assert done.status == 130 and done.out.startswith("ok   margins at the equilibrium: disk margin"), done
    assert done.err.splitlines()[-1] == "surctl: stopped; the region of attraction is not decided"


@pytest.mark.parametrize(
    ("words", "part", "file"),
    [
        (("verify", "within.x=-1..1"), "surctl.report.motion_plots.plot_motion", "cart.json"),
        (("sweep", "k=1..2:2", "--seconds", "1"), "surctl.cli.sweep._pictures", "sweep.csv"),
        (("simulate", "--seconds", "1"), "surctl.system.Record.plot", "cart-hold.csv"),
    ],
)
def test_files_that_are_finished_when_a_command_is_stopped_are_named(
    words: tuple[str, ...], part: str, file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    (tmp_path / "loop.py").write_text(LOOP)
    monkeypatch.setattr(part, stopped)
    command, *others = words
    done = surctl_here(command, "loop.py:build", *others, "--out", "out", cwd=tmp_path)
    assert done.status == 130 and (tmp_path / "out" / file).exists(), done
    last = done.err.splitlines()[-1]
    assert last.startswith("surctl: stopped; ") and last.endswith("what is finished is in out")
    (tmp_path / "out" / "old").mkdir()
    again = surctl_here(command, "loop.py:build", "no=1", *others, "--out", "out", cwd=tmp_path)
    assert again.status == 2 and "finished" not in again.err
