"""Study 5, quick form: everybody takes part, agrees and is timed."""

import subprocess
from pathlib import Path
from typing import get_args

import pytest

from surctl.priority import Mode
from tests.test_priority_benchmark import run
from tests.tools import need_compiler


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> tuple[subprocess.CompletedProcess[str], Path]:
    need_compiler()
    out = tmp_path_factory.mktemp("benchmark") / "new"
    return run("--quick", "--out", str(out)), out / "benchmark.png"


def rows(printed: str, width: int) -> dict[str, list[str]]:
    """Table rows of that width by their first cell, without the heads."""
    split = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in printed.splitlines() if "| " in line]
    return {row[0].strip(): row[1:] for row in split if len(row) == width}


def test_every_answer_of_ours_is_right(quick: tuple[subprocess.CompletedProcess[str], Path]) -> None:
    done, _ = quick
    assert done.returncode == 0, done.stdout + done.stderr
    python = {name: row for name, row in rows(done.stdout, 11).items() if name.startswith("surctl")}
    assert {f"surctl solve: {mode}" for mode in get_args(Mode)} < python.keys()
    in_c = {name: row for name, row in rows(done.stdout, 12).items() if name.startswith("surctl")}
    assert len(python) >= 10 and len(in_c) == 3
    for row in (*python.values(), *in_c.values()):
        assert float(row[-4]) <= 1e-6 and row[-3].startswith("0 of ") and row[-2] == "0"


def test_everybody_takes_part_or_is_listed(quick: tuple[subprocess.CompletedProcess[str], Path]) -> None:
    printed = quick[0].stdout
    timed = rows(printed, 11) | rows(printed, 12)
    missing = rows(printed, 2)
    wanted = [f"qpsolvers cascade: {name}" for name in ("daqp", "piqp", "proxqp", "quadprog", "clarabel", "osqp")]
    wanted += [
        "DAQP hierarchy: one call",
        "DAQP hierarchy: Model kept",
        "pink (pinocchio), daqp",
        "mink (mujoco), daqp",
    ]
    wanted += ["CasADi qrqp, generated C", "OSQP, generated C, tolerance 1e-6", "CasADi closed form, generated C"]
    for name in wanted:
        assert (name in timed) != (name in missing), name
    assert {"qpsolvers cascade: daqp", "qpsolvers cascade: osqp", "CasADi closed form, generated C"} < timed.keys()


def test_two_independent_strict_hierarchies_agree(quick: tuple[subprocess.CompletedProcess[str], Path]) -> None:
    cascade = rows(quick[0].stdout, 11)["qpsolvers cascade: daqp"]
    assert float(cascade[-4]) <= 1e-4  # what its regularisation leaves


def test_bars_are_judged(quick: tuple[subprocess.CompletedProcess[str], Path]) -> None:
    bars = {name: row for name, row in rows(quick[0].stdout, 4).items() if row[-1].rstrip("| ") != ""}
    assert len(bars) == 12
    assert {row[-1].rstrip("| ") for row in bars.values()} <= {"holds", "**missed**", "not measured"}


def test_the_picture(quick: tuple[subprocess.CompletedProcess[str], Path]) -> None:
    assert quick[1].read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
