"""A package registers a robot of its own; commands take it by name, and other processes too."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from surctl.cli.app import app
from surctl.errors import InputError
from surctl.system import System
from surctl.system.subjects import _registered, load_subject, registered_subjects
from surctl.tuning import LocalExecutor, SystemSweep, grid, parse_axis, sweep
from tests.tools import PATIENCE, need_compiler

LOOPS = """
from surctl.ir import Layout, Port
from surctl.system import Controller, Cost, Plant, System
from .parts import X

U = Port("u", (1,), "m/s", "")
print("loading")

def build():
    print("building")
    plant = Plant("heron", Layout((X,)), Layout((U,)), lambda x, f, d, p: {"x": f["u"]})
    gains = Layout((Port("k", (1,), "1/s", "", 2.0),))
    law = Controller("hold", 0.1, Layout((X,)), Layout((U,)), lambda x, u, p: -p["k"] * u["x"], gains=gains)
    return System(plant, law, costs={"final": Cost(lambda s: s.x["x"], "final", "m")})

def fails():
    return 1 / 0

def number():
    return 1.0
"""
ENTRIES = """[surctl.subjects]
heron = heron_robot.loops:build
broken = heron_robot.loops:fails
number = heron_robot.loops:number
nowhere = heron_robot.nothing:build
twice = heron_robot.loops:build
"""


@pytest.fixture
def heron(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    package = tmp_path / "site" / "heron_robot"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "parts.py").write_text('from surctl.ir import Port\n\nX = Port("x", (1,), "m", "", 1.0)\n')
    (package / "loops.py").write_text(LOOPS)
    for name, entries in (("heron_robot", ENTRIES), ("other", "[surctl.subjects]\ntwice = other:build\n")):
        about = tmp_path / "site" / f"{name}-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text(entries)
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.chdir(tmp_path)
    _registered.cache_clear()
    return package


def data(*words: str) -> dict:
    done = CliRunner().invoke(app, [*words, "--json"])
    assert done.exit_code == 0, (done.output, done.exception)
    return json.loads(done.stdout)


def test_commands_take_the_system_of_a_package_by_its_name(heron: Path) -> None:
    need_compiler()
    assert registered_subjects()["heron"] == "heron_robot.loops:build"
    assert "subject:heron" in data("list")["subjects"]
    run = data("simulate", "subject:heron", "k=1", "--seconds", "1")
    assert (run["system"], run["plant"], run["costs"]["final"]["unit"]) == ("subject:heron", "heron", "m")
    swept = data("sweep", "subject:heron", "k=1,2", "--seconds", "1", "--out", "swept")
    assert swept["best"]["final"]["at"] == {"k": 2.0} and "subject:heron k=2.0" in swept["next"][0]
    assert data("verify", "subject:heron")["stable"]
    assert data("export", "subject:heron", "--seconds", "1", "--out", "c")["sil"]["passed"]


APP = """
import click
from surctl.cli.application import Application

@click.command
@click.option("--wide", is_flag=True, help="Spread the wings.")
def feed(wide):
    "Feed a heron."
    click.echo(f"fed {wide}")

@click.command
@click.argument("words", nargs=-1, metavar="PLACE@")
@click.option("--wind", default=0.0, help="Wind [m/s].")
def simulate(words, wind, out, save, as_json):
    "Herons fly."
    click.echo(f"{words} {wind} {out} {as_json}")

APPLICATION = Application(
    takes=lambda words: words[:1] != () and words[0].endswith("@"),
    commands={feed: "Feed a heron."}, branches={"simulate": simulate}, reserved=lambda: ("hold",),
)
"""


SAID = """
import sys
sys.path.insert(0, "site")
from click.testing import CliRunner
from surctl.cli.app import app
for line in (
    "--help", "feed --wide", "simulate --help", "simulate lake@ --wind 3 --json", "simulate lake",
    "simulate subject:heron --wind 3", "export subject:heron --seconds 1", "lint lake@",
):
    done = CliRunner().invoke(app, line.split())
    print(">", line, " ".join(done.output.split()), done.exception)
"""


@pytest.mark.parametrize("module", ["app", "gone"])
def test_a_package_brings_commands_options_and_subjects_of_its_own(heron: Path, module: str) -> None:
    (heron / "app.py").write_text(APP)
    entries = f"\n[surctl.applications]\nheron = heron_robot.{module}:APPLICATION\n"
    (heron.parent / "heron_robot-1.0.dist-info" / "entry_points.txt").write_text(ENTRIES + entries)
    done = _script(heron, SAID)
    said = [line for line in done.stdout.splitlines() if line.startswith("> ")]
    if module == "gone":
        error = "application = 'heron': heron_robot.gone:APPLICATION fails with ModuleNotFoundError"
        assert sum(error in line and "uninstall" in line for line in said) == len(said) == 8, said
        return
    parts = ["Feed a heron.", "fed True", "--wind", "('lake@',) 3.0 None True", "lake", "--wind: ", "hold", "lake@"]
    assert len(said) == 8 and all(part in line for part, line in zip(parts, said, strict=True)), said
    assert all(text in said[2] for text in ("--wind", "--sensing", "SCENARIO... | PLACE@ |", "Herons fly."))
    assert "unknown scenario" in said[4] and "does not apply to a system" in said[5] and "unknown" in said[7]
    assert "is the name of a built-in law" in said[6]


def test_other_processes_load_the_package(heron: Path) -> None:
    need_compiler()
    subject, design = load_subject("subject:heron"), grid([parse_axis("k=0.5..4:100")])
    assert isinstance(subject.system, System) and load_subject("subject:heron").system is subject.system
    spread = LocalExecutor(2, alone_s=0.0)
    swept = sweep(SystemSweep(subject.system, 1.0, source="subject:heron"), design, executor=spread)
    np.testing.assert_array_equal(swept.worst("final"), sweep(SystemSweep(subject.system, 1.0), design).worst("final"))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("heorn", "system = 'heorn': no installed package registers it; did you mean 'heron'"),
        ("broken", "heron_robot.loops:fails fails with ZeroDivisionError: division by zero; correct the package"),
        ("number", "heron_robot.loops:number returns float, not System; return a surctl System"),
        ("nowhere", "heron_robot.nothing:build fails with ModuleNotFoundError"),
        ("twice", "is registered twice, as heron_robot.loops:build and other:build; uninstall one"),
    ],
)
def test_a_wrong_name_or_package_is_one_line(heron: Path, name: str, text: str) -> None:
    done = CliRunner().invoke(app, ["simulate", f"subject:{name}", "--seconds", "1"])
    assert isinstance(done.exception, InputError) and done.stdout == ""
    assert text in str(done.exception) and "\n" not in str(done.exception)


COMMANDS = """
import sys
sys.path.insert(0, "site")
from click.testing import CliRunner
from surctl.cli.app import app
for line in (
    "lint subject:heron", "simulate subject:heron --seconds 1", "verify subject:heron",
    "sweep subject:heron k=1,2 --seconds 1", "tune subject:heron --seconds 1 --gain k=1..2 --trials 5 --rounds 1",
):
    done = CliRunner().invoke(app, line.split())
    assert done.exit_code == 0, (line, done.output, done.exception)
print([name for name in sys.modules if name.startswith("surctl.marine")])
"""


def _script(heron: Path, text: str) -> subprocess.CompletedProcess[str]:
    script = heron.parents[1] / "commands.py"
    script.write_text(text)
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    return subprocess.run(
        [sys.executable, str(script)], cwd=heron.parents[1], env=environment, capture_output=True, text=True,
        check=False, timeout=PATIENCE,
    )  # fmt: skip


def test_commands_about_a_robot_of_a_package_load_no_other_application(heron: Path) -> None:
    need_compiler()
    done = _script(heron, COMMANDS)
    assert done.returncode == 0 and done.stdout.splitlines()[-1] == "[]", (done.stdout, done.stderr)
