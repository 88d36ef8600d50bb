"""Pictures that cannot be drawn, and streams that cannot be written: one line, and the results are there."""

from __future__ import annotations

import ast
import errno
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from tests.cli.process import LIBRARY, Outcome, surctl_here

LOOP = """
from surctl.ir import Layout, Port
from surctl.system import Controller, Cost, Plant, System

X, U = Port("x", (1,), "m", "", 1.0), Port("u", (1,), "m/s", "")
K = Layout((Port("k", (1,), "1/s", "", 2.0), Port("q", (1,), "1", "", 1.0)))

def build():
    plant = Plant("cart", Layout((X,)), Layout((U,)), lambda x, f, d, p: {"x": f["u"]})
    law = Controller("hold", 0.1, Layout((X,)), Layout((U,)), lambda x, u, p: -p["k"] * p["q"] * u["x"], gains=K)
    return System(plant, law, costs={"final": Cost(lambda s: s.x["x"], "final", "m", "at the end")})
"""
_ACCEPTED = ("--scenario", "pool-behind", "--law", "closed_form")  # the set `default` has too little margin to brake
DRAWING = {  # command: the files of its result
    ("simulate", "pool-behind", "--save", "csv", "--explain", "--animate", "out/run.gif", "--out", "out"): {"csv"},
    ("simulate", "loop.py:build", "--seconds", "1", "--out", "out"): {"csv"},
    ("sweep", "loop.py:build", "k=1,2", "q=1,2", "--seconds", "1", "--out", "out"): {"csv", "nc"},
    ("sweep", "k_v=1,1.5", "k_r=0.5,0.7", *_ACCEPTED, "--locus", "k_v", "--workers", "1", "--out", "out"): {
        "nc", "toml",
    },
    ("verify", "v1-corrected", "--vehicle", "sur400", "--out", "out"): {"json"},
    ("vehicle", "thrusters", "bluerov2-heavy", "--out", "out"): set(),
}  # fmt: skip


@pytest.mark.parametrize("words", DRAWING, ids=lambda words: " ".join(words[:2]))
def test_a_picture_that_cannot_be_drawn_loses_nothing_else(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise MemoryError("no canvas")

    monkeypatch.setattr(FigureCanvasAgg, "__init__", broken)
    (tmp_path / "loop.py").write_text(LOOP)
    done = surctl_here(*words, cwd=tmp_path)
    complaints = [line for line in done.err.splitlines() if not line.startswith("  ")]
    assert done.status == 3 and done.out, done
    assert complaints and all("not saved: MemoryError: no canvas" in line for line in complaints)
    assert {path.suffix[1:] for path in tmp_path.glob("out/*") if path.is_file()} == DRAWING[words]


WRITING = {  # command: what its results on stdout contain
    ("simulate", "loop.py:build", "--seconds", "1", "--out", "out"): "final",
    ("sweep", "loop.py:build", "k=1,2", "--seconds", "1", "--out", "out"): "",  # stops: no run could be kept
    ("verify", "v1-corrected", "m-norm-corrected", "--vehicle", "sur400", "--out", "out"): "ok   m-norm-corrected",
    ("verify", "braking-rule-20", "--vehicle", "sur400", "--out", "out"): "ok   braking-rule-20",
    ("verify", "loop.py:build", "within.x=-1..1", "--out", "out"): "proved",
    ("study", "loop.py:build", "--seconds", "1", "k=1..2:2", "--out", "out"): "study cart under hold: accepted",
    ("gains", "derive", "bluerov2-vonbenzon", "--cruise", "0.2", "--out", "gains.toml"): "",
    ("new", "vehicle", "mine"): "",
}  # fmt: skip


@pytest.mark.parametrize("words", WRITING, ids=lambda words: " ".join(words[:2]))
def test_a_full_disk_leaves_the_results_on_stdout(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    (tmp_path / "loop.py").write_text(LOOP)
    monkeypatch.setattr("surctl.files.os.fsync", full)
    done = surctl_here(*words, cwd=tmp_path)
    complaints = [line for line in done.err.splitlines() if not line.startswith("  ")]
    assert done.status == 3 and WRITING[words] in done.out, done
    assert complaints and all(line.count(os.strerror(errno.ENOSPC)) == 1 for line in complaints)


def test_a_disk_that_is_full_when_a_sweep_ends_keeps_the_finished_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise RuntimeError("NetCDF: HDF error")

    (tmp_path / "loop.py").write_text(LOOP)
    words = ("sweep", "loop.py:build", "k=1,2", "--seconds", "1", "--out", "out")
    with monkeypatch.context() as patch:
        patch.setattr("netCDF4.Dataset", full)
        patch.setattr("surctl.recorded_write.disk_usage", lambda _: SimpleNamespace(free=0))
        done = surctl_here(*words, cwd=tmp_path)
    assert done.status == 3 and os.strerror(errno.ENOSPC) in done.err, done
    assert "finished chunks are kept" in done.err and list(tmp_path.glob("out/sweep.chunks/*/*.chunk"))
    again = surctl_here(*words, cwd=tmp_path)
    assert again.status == 0 and (tmp_path / "out" / "sweep.nc").exists(), again


PLOTTING = ("save_", "plot_", "render_", "write_")


def unguarded(tree: ast.AST) -> list[str]:
    """The calls of functions of the report that draw, outside of `with saving(...)`."""
    drawn = {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        and (node.module or "").startswith(("surctl.report", "surctl.marine.reproduction"))
        for alias in node.names
        if alias.name.startswith(PLOTTING)
    }

    def calls(node: ast.AST) -> list[str]:
        if isinstance(node, ast.With) and any("saving(" in ast.unparse(item) for item in node.items):
            return []
        if isinstance(node, ast.FunctionDef) and node.name.endswith("_plot"):
            return []  # a picture of a summary, which the sweep draws with `saving`
        here = [ast.unparse(node)] if isinstance(node, ast.Call) and ast.unparse(node.func) in drawn else []
        return here + [call for child in ast.iter_child_nodes(node) for call in calls(child)]

    return calls(tree)


def test_every_command_draws_where_a_failure_loses_nothing() -> None:
    files = [
        *(LIBRARY / "cli").glob("*.py"),
        *(LIBRARY / "marine" / "cli").glob("*.py"),
        LIBRARY / "study.py",
    ]
    assert unguarded(ast.parse("from surctl.report import save_x\nsave_x()")) == ["save_x()"]
    assert {path.name: calls for path in files if (calls := unguarded(ast.parse(path.read_text())))} == {}


def process(words: str, folder: Path, *, out: int = subprocess.PIPE, **environment: str) -> Outcome:
    """The command by a shell, which can close a stream."""
    done = subprocess.run(
        f"exec {sys.executable} -m surctl {words}", shell=True, cwd=folder, text=True, check=False,
        stdout=out, stderr=subprocess.PIPE, env={**os.environ, **environment},
    )  # fmt: skip
    return Outcome(done.returncode, done.stdout or "", done.stderr)


@pytest.mark.parametrize(
    ("words", "status"),
    [
        ("list --show sur400 >&-", 0),
        ("--help >&- 2>&-", 0),
        ("lint no-such >&- 2>&-", 2),
        ("check no-such 2>&-", 2),
        ("new vehicle mine <&- >&- 2>&-", 0),
        ("simulate pool-behind --out out --save csv >&- 2>&-", 0),
        ("list --show sur400 > /dev/full", 3),
        ("list --show sur400 > /dev/full 2> /dev/full", 3),
        ("list no-such > /dev/null 2> /dev/full", 2),
    ],
)
def test_a_stream_that_is_closed_or_full(words: str, status: int, tmp_path: Path) -> None:
    done = process(words, tmp_path)
    assert done.status == status and "Traceback" not in done.err, done
    if "--out" in words:
        assert {path.suffix for path in (tmp_path / "out").iterdir()} == {".csv", ".png"}


def test_a_reader_that_ends_first_is_no_finding(tmp_path: Path) -> None:
    read, written = os.pipe()
    os.close(read)
    done = process("list", tmp_path, out=written)
    os.close(written)
    assert (done.status, done.said) == (3, "")


@pytest.mark.parametrize("backend", ["nonsense", "module://no_such.backend"])
def test_the_backend_of_the_environment_has_no_influence(backend: str, tmp_path: Path) -> None:
    done = process("vehicle thrusters bluerov2-heavy --out out", tmp_path, MPLBACKEND=backend)
    assert done.status == 0 and list(tmp_path.glob("out/*.png")), done
    assert done.said == "", done


def test_a_full_disk_is_told_once_and_the_runs_are_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    runs = ("simulate", "pool-static", "--sensing", "truth", "--out", "out", "--runs")
    with monkeypatch.context() as patch:
        patch.setattr("surctl.files.os.fsync", full)
        done = surctl_here(*runs, "3", cwd=tmp_path, SURCTL_VERBOSE="")
    told = [line for line in done.err.splitlines() if not line.startswith("  ")]
    assert done.status == 3 and "3 of 3 runs arrive" in done.out and "files out" not in done.out, done
    assert len(told) == 2 and told[1] == "surctl: 2 more not saved, for the same reason"
    monkeypatch.setattr("surctl.marine.simulation.campaign.campaign.CampaignFolder.write", full)
    done = surctl_here(*runs, "8", "--monte-carlo", cwd=tmp_path, SURCTL_VERBOSE="")
    assert done.status == 3 and "8 reached" in done.out and "table of pool-static not saved" in done.err, done
