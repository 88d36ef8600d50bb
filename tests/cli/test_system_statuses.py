"""One rule of the exit status: 1 if a line says FAIL, or if a claim that is asked for is not proved."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from surctl.cli.app import app
from tests.tools import need_compiler

# the disk margin is that of the gain k, and the speed has decayed to 0.2 m/s after ln(5)/k
FILE = """
import casadi as ca
from surctl.ir import Layout, Port
from surctl.system import Controller, Cost, Plant, System

SPEED, FORCE = Port("speed", (1,), "m/s", "", 1.0), Port("force", (1,), "m/s^2", "")

def loop(k, at_most, within):
    plant = Plant("cart", Layout((SPEED,)), Layout((FORCE,)), lambda x, f, d, p: {"speed": f["force"]})
    law = Controller(
        "hold", 0.1, Layout((SPEED,)), Layout((FORCE,)), lambda x, u, p: -p["k"] * u["speed"],
        gains=Layout((Port("k", (1,), "1/s", "", k),)),
    )
    slow = Cost(lambda s: ca.fabs(s.x["speed"]) - 0.2, "last_time", "s", at_most=at_most)
    return System(plant, law, costs={"slow": slow}, duration=2.0, within=within)

BOX = {"speed": (-1.0, 1.0)}
def good():
    return loop(2.0, 1.0, BOX)
def slow():
    return loop(1.0, 1.0, BOX)
def wild():
    return loop(18.5, 1.9, {})
"""
# k over which it is swept; whether a bound, and a margin, is not met
SYSTEMS = {"good": ("2,3", 0, 0), "slow": ("0.5,1", 1, 0), "wild": ("18,18.5", 0, 1)}
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
