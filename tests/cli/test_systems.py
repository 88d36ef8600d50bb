"""A closed loop of the user's own, FILE.py:FUNCTION, in simulate, verify, sweep and export."""

from __future__ import annotations

import csv
import json
import re
import shlex
from dataclasses import replace
from pathlib import Path
from textwrap import dedent
from types import ModuleType
from zipfile import ZipFile

import numpy as np
import pytest
import xarray
from click.testing import CliRunner, Result

from surctl.cli.app import app
from surctl.cli.subject import region_words
from surctl.errors import InputError
from surctl.ir import Layout, Port
from surctl.lyapunov import sampled_dynamics
from surctl.own_code import object_of, pinned
from surctl.system import Controller, Plant, System, find_equilibrium, linearise, run_system, simulate_system
from surctl.verification import system_disk_margin, system_margins
from tests.certcheck.altering import sealed
from tests.pictures import blank_pictures
from tests.tools import need_compiler

# without control, x is about 1/(1 + t); with `blow` = 1 the root is not a number below x = 0.5, from about t = 1 s on
FILE = """
import casadi as ca
from surctl.ir import Layout, Port
from surctl.system import Action, Controller, Cost, Plant, System

def loop(blow, costs):
    x, f = Port("x", (1,), "m", "", 1.0), Port("f", (1,), "m/s", "")
    pose, turn = Port("pose", (2,), "m, rad", ""), Port("turn", (2,), "1", "")
    late = Port("blow", (1,), "1", "", blow)

    def ode(s, u, d, p):
        root = ca.sqrt(s["x"] + 1 - 1.5 * p["blow"])
        return {"x": u["f"] - s["x"] ** 2 - 0.001 * root, "pose": u["turn"] - s["pose"]}

    def law(z, u, p):
        return {"f": -p["k"] * (u["x"] - u["goal"]), "turn": [0.1 * u["goal"], 0]}

    plant = Plant("pool", Layout((x, pose)), Layout((f, turn)), ode, parameters=Layout((late,)))
    control = Controller(
        "pump", 0.01, Layout((x, Port("goal", (1,), "m", "reference"))), Layout((f, turn)), law,
        gains=Layout((Port("k", (1,), "1/s", "", 1.0),)),
    )
    return System(plant, control, costs=costs, stops={"high": lambda s: s.x["x"] > 5})

def build():
    return loop(0.0, {
        "final": Cost(lambda s: s.x["x"], "final", "m", "at the end"),
        "work": Cost(lambda s: s.f["f"] ** 2, "rms", "m/s"),
    })

def bare():
    return loop(0.0, {})

FILE = "text"

def number():
    return 1.0

def fails():
    return 1 / 0

def leaves():
    raise SystemExit(0)
"""


def run(*words: str) -> Result:
    return CliRunner().invoke(app, list(words))


def data(*words: str, status: int = 0) -> dict:
    done = run(*words, "--json")
    assert done.exit_code == status, (done.output, done.exception)
    return json.loads(done.stdout)


def complaint(*words: str) -> str:
    done = run(*words)
    if isinstance(done.exception, InputError):
        assert done.stdout == ""
        return str(done.exception)
    assert done.exit_code == 2, (done.output, done.exception)
    return done.output.strip().splitlines()[-1]


@pytest.fixture(autouse=True)
def _blank(monkeypatch: pytest.MonkeyPatch) -> None:
    blank_pictures(monkeypatch)


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(FILE)
    return "mine.py:build"


def own(word: str) -> System:
    return object_of(pinned(word, key="system"), System, key="system")


def test_the_commands_that_new_prints_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need_compiler()
    monkeypatch.chdir(tmp_path)
    written = data("new", "system", "my-loop")
    space = ModuleType("my_loop")
    exec(Path("my-loop.py").read_text(), vars(space))
    assert len(Path("my-loop.py").read_text().splitlines()) <= 60
    assert run_system(space.build(), 2.0).stopped == "time"
    names = [shlex.split(line)[1] for line in written["next"]]
    assert names == ["study", "simulate", "verify", "sweep", "tune", "export"]
    for line in written["next"]:
        done = run(*shlex.split(line)[1:])
        assert done.exit_code == 0, (line, done.output, done.exception)
    assert {path.name for path in Path("plots").iterdir()} == {"my_loop-balance.png", "my_loop-balance.csv"}
    page = Path("surctl-out/report.html").read_text()
    assert page.count("<img") == 5  # run, loop, region, and the map of each cost
    assert "where the Lyapunov function V &lt; " in page and "Nyquist" in page
    checked = run("check", "proofs/my_loop.json", "--bundle", "firmware")
    assert checked.exit_code == 0 and "belongs to the controller" in checked.output
    manifest = json.loads(Path("firmware/manifest.json").read_text())
    assert manifest["commands"] == {"torque": "N m"} and manifest["evidence"]["run"]["reference"] == [0.0]
    assert "double torque; /* [N m] at the pivot */" in Path("firmware/balance.h").read_text()


def test_a_run_gives_the_figures_and_signals_of_the_system(file: str) -> None:
    words = ("simulate", file, "k=2", "reference.goal=0.5", "start.pose=0.2,-0.1", "--seconds", "0.5")
    values = {"k": 2.0, "reference.goal": 0.5, "start.pose": np.array([[0.2, -0.1]])}
    record, done = run_system(own(file), 0.5, values), data(*words, "--out", "out")
    assert {name: cost["value"] for name, cost in done["costs"].items()} == dict(record.figures)
    assert (done["stopped"], done["duration_s"], done["costs"]["work"]["unit"]) == ("time", 0.5, "m/s")
    with Path("out/pool-pump.csv").open(newline="") as text:
        head, *rows = csv.reader(text)
    assert head == [
        "time [s]", "x [m]", "pose[0] [m]", "pose[1] [rad]", "f [m/s]", "turn[0] [1]", "turn[1] [1]", "goal [m]",
        "status [1]",
    ]  # fmt: skip
    np.testing.assert_array_equal(np.array(rows, dtype=float)[:, 2:4], record["pose"])
    assert Path("out/pool-pump.png").exists()
    assert data(*words, "--out", "out", "--save", "nc")["files"][1] == "out/pool-pump.nc"
    with xarray.open_dataset("out/pool-pump.nc") as read:
        np.testing.assert_array_equal(read["pose[1]"].values, np.asarray(record["pose"])[:, 1])
        assert (read["pose[1]"].units, read["f"].units, read.time.units) == ("rad", "m/s", "s")
        assert read.attrs["system_sha256"] == own(file).digest() and read.attrs["system"] == "mine.py:build"
        assert json.loads(read.attrs["values"])["reference.goal"] == 0.5
    assert "final  0.5" in run(*words).stdout and "m (final)  at the end" in run(*words).stdout
    high = data("simulate", file, "start.x=6", "--seconds", "0.5", status=1)  # a stop is a failure
    assert "FAIL the run stops after 0 s (high)" in run("simulate", file, "start.x=6", "--seconds", "1").stdout
    assert (high["stopped"], high["duration_s"], high["costs"]["work"]["value"]) == ("high", 0.0, None)
    assert "  no costs: a run that ends at its start" in run("simulate", file, "start.x=6", "--seconds", "1").stdout


def test_files_of_another_command_are_named_when_they_are_replaced(file: str, tmp_path: Path) -> None:
    def ran(*words: str) -> str:
        return CliRunner().invoke(app, [*words, "--out", str(tmp_path)]).stderr

    first = ("simulate", file, "--seconds", "0.1", "--save", "csv")
    assert "replaced" not in ran(*first) + ran(*first)  # the same files
    (tmp_path / "notes.txt").write_text("kept")
    says = ran(*first, "k=2")
    assert "contained results of another command, which this command replaced: pool-pump.csv\n" in says


def test_a_repeated_command_replaces_its_own_results_however_it_is_spelled(
    file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def says(*words: str) -> str:
        monkeypatch.setattr("sys.argv", ["surctl", *words])
        return CliRunner().invoke(app, [*words]).stderr

    first = ("simulate", file, "--seconds", "0.1", "--out")
    spellings = [(str(tmp_path),), (str(tmp_path),), (f"{tmp_path}/.",), (str(tmp_path), "--verbose")]
    assert "replaced" not in "".join(says(*first, *more) for more in spellings)
    assert "replaced: pool-pump.csv" in says(*first, str(tmp_path), "k=2")


def test_a_run_that_is_not_finite_fails(file: str) -> None:
    words = ("simulate", file, "plant.blow=1", "k=0", "--seconds", "3")
    lost = data(*words, status=1)
    exact = run_system(own(file), 3.0, {"plant.blow": 1.0, "k": 0.0})
    assert lost["stopped"] == "not finite" and lost["duration_s"] == exact.duration and 0.9 < exact.duration < 1.1
    assert lost["costs"]["final"]["value"] is None and "next" not in lost
    where = f"state x at {exact.duration + 0.01:.6g} s, because of sqrt(-0.000"
    assert lost["not_finite"] == exact.lost and exact.lost.startswith(where) and exact.lost.endswith(") of the plant")
    text = " ".join(run(*words, "--out", "out").stdout.split())
    assert f"(not finite: {exact.lost})" in text and "nan" not in text and Path("out/pool-pump.png").exists()


def test_the_linear_loop_is_that_of_the_system(file: str) -> None:
    done = data("verify", file, "reference.goal=0.5")
    at = find_equilibrium(own(file), {"reference.goal": 0.5})
    linear = linearise(own(file), {"reference.goal": 0.5}, at=at)
    assert done["equilibrium"]["state"] == dict(zip(("x", "pose[0]", "pose[1]"), at.x, strict=True))
    assert [pole[0] for pole in done["poles"]] == linear.poles().real.tolist() and done["stable"]
    assert [m["name"] for m in done["margins"]] == ["f", "turn[0]", "turn[1]", "x"]  # the law does not use the pose
    assert done["margins"][0]["delay_margin_s"] == system_margins(linear, "f")[0].delay_margin_s
    assert done["disk_margins"][-1]["guaranteed"] == system_disk_margin(linear, "x").guaranteed
    assert done["slowest_mode"]["time_constant_s"] == pytest.approx(1.0)  # of the pose
    text = run("verify", file, "reference.goal=0.5").stdout
    assert "stable, 3 poles" in text and "f: gain factor below" in text and "m/s" in text and "surge" not in text
    unstable = data("verify", file, "k=-0.5", status=1)
    assert not unstable["stable"] and unstable["slowest_mode"]["time_constant_s"] < 0 and "next" not in unstable


def test_a_sweep_gives_the_costs_of_each_run(file: str) -> None:
    need_compiler()
    words = ("sweep", file, "k=0..2:3", "plant.blow=0,1", "--seconds", "3", "--out", "swept")
    done = data(*words)
    runs = simulate_system(own(file), 3.0, {"k": [0, 0, 1, 1, 2, 2], "plant.blow": [0, 1, 0, 1, 0, 1]})
    finite = np.isfinite(runs["final"])
    assert 0 < np.count_nonzero(~finite) < 6
    assert [row["costs"]["final"] is None for row in done["results"]] == (~finite).tolist()
    assert len(done["not_finite"]) == np.count_nonzero(~finite) and done["not_finite"][0] == {
        "k": 0.0,
        "plant.blow": 1.0,
    }
    best = done["best"]["final"]
    assert best["least"] == np.nanmin(runs["final"]) and best["largest"] == np.nanmax(runs["final"])
    assert best["at"] == done["results"][int(np.nanargmin(runs["final"]))]["at"]
    with Path("swept/sweep.csv").open(newline="") as text:
        head, *rows = csv.reader(text)
    assert head == ["k", "plant.blow", "final [m]", "work [m/s]", "stopped", "duration [s]"] and len(rows) == 6
    with xarray.open_dataset(done["netcdf"]) as read:
        np.testing.assert_array_equal(read["final"].values, runs["final"].reshape(3, 2))
        assert read["final"].dims == ("k", "plant.blow") and read["k"].values.tolist() == [0, 1, 2]
        assert (read["k"].units, read["final"].units, read["final"].long_name) == ("1/s", "m", "at the end")
        assert read["run.stopped"].values.ravel().tolist() == runs.stopped.tolist()
        assert read.attrs["controller_sha256"] == own(file).controller.block.digest()
    assert [Path(name).name for name in done["pictures"]] == [
        "sweep-parallel.png", *(f"sweep-k-plant.blow-{cost}.png" for cost in ("final", "work")),
    ]  # fmt: skip
    assert all(Path(name).is_file() for name in done["pictures"])
    text = run(*words).stdout
    assert (
        f"{np.count_nonzero(~finite)} of 6 runs are not finite: k=0, plant.blow=1" in text and "least final: " in text
    )
    assert "  k=0, plant.blow=1: no costs  (not finite at " in text and "  in the first of them: state x at " in text
    assert data("sweep", file, "plant.blow=1", "k=0", "--seconds", "3", "--out", "swept", status=1)["best"] == {}


def test_two_sweeps_in_one_folder_keep_their_files(file: str) -> None:
    need_compiler()
    first, second = (
        ("sweep", file, "k=0.5,1", f"plant.blow={b}", "--seconds", "3", "--out", "both") for b in ("0", "0.1")
    )
    files = []
    for words in (first, second, first):
        done = data(*words)
        files.append((done["table"], done["netcdf"], *done["pictures"]))
        if len(files) == 1:
            before = Path(done["table"]).read_text()
    assert len({*files[1], *files[2]}) == len(files[1]) + len(files[2]), "no file of one is a file of the other"
    assert Path(files[2][0]).read_text() == before and all(Path(name).is_file() for name in (*files[1], *files[2]))
    assert len([*Path("both").iterdir()]) == len(files[1]) + len(files[2])


def test_a_sweep_with_random_numbers_judges_a_point_by_its_worst_run(file: str) -> None:
    need_compiler()
    words = ("sweep", file, "k=0.5,2", "start.x=0.5..3", "--seconds", "1", "--out", "swept")
    done = data(*words, "--seeds", "7")
    assert done["random"] == ["start.x"] and done["axes"] == {"k": [0.5, 2.0]} and len(done["results"]) == 14
    starts = [row["at"]["start.x"] for row in done["results"]]
    assert starts[:7] == starts[7:] and len(set(starts)) == 7 and all(0.5 <= start <= 3 for start in starts)
    runs = simulate_system(own(file), 1.0, {"k": np.repeat([0.5, 2.0], 7), "start.x": starts})
    final = runs["final"].reshape(2, 7)
    best = done["best"]["final"]
    assert best["at"] == {"k": 2.0} and best["least"] == final.max(axis=1)[1] == best["costs"]["final"]
    assert best["mean"]["final"] == final.mean(axis=1)[1] and best["random"] == {"start.x": max(starts)}
    with xarray.open_dataset(done["netcdf"]) as read:
        np.testing.assert_array_equal(read["final"].sel(k=2.0).values, final[1])
        assert read["start.x"].dims == ("draw",) and read["start.x"].values.tolist() == starts[:7]
    text = run(*words, "--seeds", "7").stdout
    assert "least final in the worst of 7 runs: " in text and "0 ended early; at most 34.8 % at 95 %" in text
    alone = run(*words[:2], "start.x=0.5..3", "--seeds", "7", *words[4:])
    assert "worst final of 7 runs: " in alone.stdout and Path("swept/sweep-runs.png").is_file()
    more = data(*words[:2], "start.x=0.5..3", "--seeds", "9", *words[4:])["results"]
    assert [row["at"]["start.x"] for row in more][:7] == starts[:7]


def test_indices_of_a_system_are_those_of_its_cost(file: str) -> None:
    need_compiler()
    done = data(
        "sweep", file, "k=1..2", "start.x=0.9..1.1", "--sensitivity", "final", "--points", "16", "--seconds", "1"
    )
    assert done["sensitivity"]["axes"] == ["k", "start.x"] and len(done["results"]) == 64
    k, start = done["sensitivity"]["total"]
    assert k > 0.8 > 0.2 > start > 0


def test_the_exported_controller_gives_the_numbers_of_the_run(file: str) -> None:
    need_compiler()
    done = data("export", file, "k=3", "reference.goal=0.5", "--seconds", "1", "--name", "mine", "--out", "c")
    assert done["largest_difference"] == 0.0 and done["sil"]["passed"] and done["sil"]["steps"] == 100
    assert done["commands"] == {"f": "m/s", "turn": "1"} and "double turn[2];" in Path("c/mine.h").read_text()
    assert {
        row["name"]: row["values"] for row in json.loads(Path("c/manifest.json").read_text())["gains"]["values"]
    } == {"k": [3.0]}


def test_a_system_is_exported_in_float_as_a_unit_with_its_evidence(file: str) -> None:
    need_compiler()
    words = ("--seconds", "1", "--real", "float32", "--target", "fmu3")
    done = data("export", file, *words, "--out", "c")
    assert done["largest_difference"] == 0.0 and done["real"] == "float32"
    assert b'fmiVersion="3.0"' in ZipFile("c/pump.fmu").read("modelDescription.xml")
    evidence = json.loads(Path("c/manifest.json").read_text())["evidence"]
    assert evidence["run"]["text"].startswith("pool under pump: ended after 1 s") and evidence["sil"]["steps"] == 100
    assert "arrived" not in Path("c/README.md").read_text().split("## Evidence")[1]


def test_c_for_a_target_is_checked_on_it(file: str) -> None:
    need_compiler()
    done = run("export", file, "--seconds", "1", "--target", "gcc-O0", "--steps", "60")
    assert done.exit_code == 0, done.output
    [figures] = [line for line in map(" ".join, map(str.split, done.stdout.splitlines())) if line.startswith("gcc-O0 ")]
    assert figures.startswith("gcc-O0 160 steps, same bytes; ") and " B code and constants" in figures
    assert "| gcc-O0 | same | " in Path("surctl-out/export/README.md").read_text()
    wrong = complaint("export", file, "--seconds", "1", "--target", "cortex-m8")
    assert wrong == "--target = 'cortex-m8': is not available for a system of your own; did you mean 'cortex-m7'?"


def test_a_study_puts_run_margins_sweep_and_export_on_one_page(file: str) -> None:
    need_compiler()
    words = ("study", file, "reference.goal=0.5", "plant.blow=0..0", "k=0.5..2:3", "--seconds", "0.5", "--out", "s")
    done = data(*words)
    (then,) = done["next"]  # about the same parameters
    assert shlex.split(then)[1:5] == ["verify", file, "reference.goal=0.5", "plant.blow=0..0"] and " k=" in then
    runs = simulate_system(own(file), 0.5, {"k": [0.5, 1.25, 2.0], "reference.goal": 0.5})
    assert done["best"]["final"]["least"] == runs["final"].min() and done["passed"]
    assert done["linear"]["equilibrium"] == data("verify", file, "reference.goal=0.5")["equilibrium"]
    assert Path("s/export/pump.c").exists()
    page = Path("s/report.html").read_text()
    assert "https://" not in page and page.count("<img") == 4  # the run, the loop, and each cost over k
    for text in ("Costs of the run", "Margins", "at the end", "turn[1]", "surctl sweep mine.py:build k=0.5..2:3"):
        assert text in page
    assert {"study", "passed", "assessment", "sweep", "export", "report", "seconds"} <= set(done)
    [sil] = done["export"]["sil"]
    assert (
        sil["system"] == "mine.py:build"
        and sil["passed"]
        and done["sweep"]["axes"]["k"]
        == [
            0.5,
            1.25,
            2,
        ]
    )
    written = Path("s/sweep.nc").stat().st_mtime_ns
    assert data(*words)["best"] == done["best"] and Path("s/sweep.nc").stat().st_mtime_ns == written, "not swept again"
    lost = data("study", file, "plant.blow=1", "k=0", "--seconds", "2", "--out", "s", status=1)
    lines = lost["assessment"]["lines"]
    assert [line["passed"] for line in lines].count(False) == 1 and "state x at" in lines[0]["text"]


MISTAKES = {
    "no such file": (("simulate", "yours.py:build", "--seconds", "1"), "yours.py: system: cannot be read"),
    "a file without a function": (("verify", "one.py:build"), "write a function build that returns a System"),
    "no such function": (("verify", "mine.py:bild"), "no such function; did you mean 'build'"),
    "another type": (("verify", "mine.py:number"), "returns float, not System"),
    "a function that fails": (("simulate", "mine.py:fails", "--seconds", "1"), "fails with ZeroDivisionError"),
    "a function that exits": (("verify", "mine.py:leaves"), "fails with SystemExit: 0; correct the file"),
    "a file that fails": (("verify", "broken.py:build"), "line 1"),
    "no function": (("simulate", "mine.py", "--seconds", "1"), "write mine.py:build"),
    "two systems": (("verify", "mine.py:build", "mine.py:bare"), "one system, first"),
    "a system behind a scenario": (("simulate", "tank-static", "mine.py:build"), "one system, first"),
    "an unknown number": (("simulate", "mine.py:build", "kk=1", "--seconds", "1"), "did you mean 'k'"),
    "an unknown axis": (("sweep", "mine.py:build", "kk=1", "--seconds", "1"), "did you mean 'k'"),
    "no number": (("simulate", "mine.py:build", "k=one", "--seconds", "1"), "k = 'one': is not a number"),
    "no assignment": (("verify", "mine.py:build", "v1-printed"), "is not NAME=VALUE"),
    "a number twice": (("verify", "mine.py:build", "k=1", "k=2"), "k: is given twice"),
    "an infinite number": (("verify", "mine.py:build", "k=inf"), "k: is not finite"),
    "too many entries": (("verify", "mine.py:build", "start.pose=1,2,3"), "start.pose: has shape"),
    "a log of the robot": (("simulate", "mine.py:build", "--save", "mcap", "--out", "o"), "did you mean 'mat'?"),
    "no folder": (("simulate", "mine.py:build", "--save", "nc", "--seconds", "1"), "--save: needs an output folder"),
    "no duration": (("simulate", "mine.py:build"), "--seconds: is missing"),
    "duration 0": (("simulate", "mine.py:build", "--seconds", "0"), "--seconds = 0.0: is not a duration"),
    "duration nan": (("sweep", "mine.py:build", "k=1", "--seconds", "nan"), "--seconds = nan: is not a duration"),
    "a century": (("export", "mine.py:build", "--seconds", "3e9"), "give at most 100000 s"),
    "a vector as axis": (
        ("sweep", "mine.py:build", "start.pose=1,2", "--seconds", "1"), "has 2 entries; name one: start.pose[0],",
    ),
    "a vector in cases": (
        ("tune", "mine.py:build", "start.pose=1,2", "--seconds", "1"), "has 2 entries; name one: start.pose[0],",
    ),
    "a case twice": (("tune", "mine.py:build", "start.x=1", "start.x=2", "--seconds", "1"), "start.x: is given twice"),
    "a grid without count": (("sweep", "mine.py:build", "k=1..2", "--seconds", "1"), "write k=1..2:COUNT"),
    "no axis": (("sweep", "mine.py:build", "--seconds", "1"), "nothing to sweep"),
    "no costs": (("sweep", "mine.py:bare", "k=1", "--seconds", "1"), "has no costs"),
    "an option of the robot": (("simulate", "mine.py:build", "--vehicle", "x"), "--vehicle: does not apply"),
    "its export": (("export", "mine.py:build", "--sensing", "truth", "--seconds", "1"), "--sensing: does not apply"),
    "a name of a law": (
        ("export", "mine.py:build", "--name", "guarded", "--seconds", "1"), "is the name of a built-in law",
    ),
    "a name of a module": (
        ("export", "mine.py:build", "--name", "queue", "--seconds", "1"), "--name = 'queue': is the name of a Python",
    ),
    "a study's name of a law": (
        ("study", "named.py:build", "--seconds", "1"), "named.py:build: controller = 'guarded': is the name of a b",
    ),
    "a study's name of a module": (
        ("study", "module.py:build", "--seconds", "1"), "module.py:build: controller = 'queue': is the name of a Pyt",
    ),
    "a variable": (("verify", "mine.py:FILE"), "system = 'FILE': is of type str, not a function"),
    "a study's value and axis": (("study", "mine.py:build", "k=1", "k=1..2:3", "--seconds", "1"), "k: is given twice"),
    "a study without costs": (("study", "mine.py:bare", "k=1..2:3", "--seconds", "1"), "has no costs"),
    "a study's duration": (("study", "mine.py:build"), "--seconds: is missing"),
    "a study of the robot": (("study", "mine.py:build", "--vehicle", "sur400"), "--vehicle: does not apply"),
    "its target": (("export", "mine.py:build", "--target", "mjcf", "--seconds", "1"), "'mjcf': is not avail"),
    "its steps": (("export", "mine.py:build", "--steps", "9", "--seconds", "1"), "--steps: needs --check; add --check"),
    "its sweep": (("sweep", "mine.py:build", "k=1", "--locus", "k", "--seconds", "1"), "--locus: does not apply"),
    "seeds without noise": (("sweep", "mine.py:build", "k=1", "--seeds", "2", "--seconds", "1"), "2: has no noise;"),
    "a range of seeds": (("sweep", "mine.py:build", "seed=0..9", "--seconds", "1"), "no such number of the system"),
    "a random gain": (
        ("sweep", "mine.py:build", "k=1..2", "start.x=1..2", "--seeds", "9", "--seconds", "1"), "write k=1..2:COUNT"
    ),
    "indices of no cost": (
        ("sweep", "mine.py:build", "k=1..2", "--sensitivity", "wrok", "--seconds", "1"), "did you mean 'work'"
    ),
    "its claims": (("verify", "mine.py:build", "--cruise", "0.1"), "--cruise: does not apply"),
    "seconds of a scenario": (("simulate", "tank-static", "--seconds", "1"), "--seconds: applies only to a system"),
    "seconds of a sweep": (("sweep", "k_v=1,2", "--seconds", "1"), "--seconds: applies only to a system"),
    "seconds of an export": (("export", "--seconds", "1"), "--seconds: applies only to a system"),
    "a file without functions": (("verify", "broken.py"), "names no function; write broken.py:FUNCTION"),
    "another word": (("export", "pool-static"), "unexpected extra argument (pool-static)"),
}  # fmt: skip


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_is_one_line(file: str, case: str) -> None:
    Path("broken.py").write_text("import no_such_module\n")
    Path("one.py").write_text("x = 1\n")
    for other, name in (("named", "guarded"), ("module", "queue")):
        Path(f"{other}.py").write_text(
            "from dataclasses import replace\nfrom mine import build as made\n\ndef build():\n    system = made()\n"
            f"    return replace(system, controller=replace(system.controller, name={name!r}))\n"
        )
    words, fragment = MISTAKES[case]
    said = complaint(*words)
    assert fragment in said and "\n" not in said


@pytest.mark.parametrize(
    ("words", "fragment"),
    [
        ("duration=-1.0", "duration = -1.0"),
        ("duration=1e9", "duration = 1000000000.0: is "),
        ("limits={'torq': (0, 1)}", "limits.torq: is no signal of a run"),
        ("limits={'f': (1, 0)}", "limits.f = (1, 0): is not a range"),
    ],
)
def test_a_mistake_in_what_a_system_carries_is_one_line(file: str, words: str, fragment: str) -> None:
    head = "from dataclasses import replace\nfrom mine import build as b\n\ndef build():\n    return replace"
    Path("carries.py").write_text(f"{head}(b(), {words})\n")
    said = complaint("simulate", "carries.py:build")
    assert "carries.py" in said and fragment in said and "\n" not in said


def test_tune_finds_gains_and_says_what_is_not_kept(file: str, tmp_path: Path) -> None:
    need_compiler()
    words = ("tune", file, "start.x=1,0.5", "--gain", "k=0.5..8", "--seconds", "3", "--trials", "40")
    found = data(*words, "--out", str(tmp_path / "t"))
    assert found["goals"][-1]["name"] == "least final"
    assert 0.5 <= found["best"]["gains"]["k"] <= 8.0
    assert found["costs"]["after"]["final"]["value"] < found["costs"]["before"]["final"]["value"]
    after, k = found["assessment"]["after"], found["best"]["gains"]["k"]
    assert after["figures"]["disk_margin"]["value"] > found["finals"]["goals"][0]["limit"] == 0.3
    worst = data("export", file, "start.x=1", f"k={k!r}", "--seconds", "3", "--out", "c")["assessment"]["figures"]
    assert {name: one["value"] for name, one in after["figures"].items()} == {n: f["value"] for n, f in worst.items()}
    assert after["figures"]["cost.final"]["where"] == "case 1 (start.x = 1)", "the worst of both cases"
    assert "k" in (tmp_path / "t" / "gains.csv").read_text()
    table = tmp_path / "t" / "gains.csv"
    assert found["next"][0] == f"surctl verify {file} --gains {table}"
    for command in ("simulate", "export"):
        same = [data(command, file, *words, "--seconds", "3")["costs"] for words in (("--gains", table), (f"k={k!r}",))]
        assert same[0] == same[1] != data(command, file, "--seconds", "3")["costs"]
        typed = data(command, file, "--gains", table, "k=0.5", "--seconds", "3")["costs"]
        assert typed == data(command, file, "k=0.5", "--seconds", "3")["costs"], "a typed gain wins"
    table.write_text("q\n1.0\n")
    assert (
        complaint("verify", file, "--gains", str(table))
        == f"{table}: column = 'q': is not a gain of the system; known: k"
    )
    table.write_text("k\n1.0\n2.0\n")
    assert complaint("verify", file, "--gains", str(table)).startswith(f"{table}: has 2 rows of gains; ")
    table.write_text("k\nnan\n")
    assert complaint("verify", file, "--gains", str(table)) == f"{table}: k = nan: is not finite; give a finite number"
    assert complaint("simulate", file, "--monte-carlo").endswith(
        " give surctl sweep the word FILE.py:FUNCTION and --seeds N"
    )


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (("--gain", "q=1..2", "--seconds", "3"), "is no gain of the system; did you mean 'k'|known: k"),
        (("--gain", "k=2..1", "--seconds", "3"), "is not a range"),
        ((), "--seconds: is missing"),
        (
            ("--goals", "default", "--seconds", "3"),
            "goals.arrive.metric = 'reached': is not a cost of the system; known: final, work",
        ),
        (("start.x=a", "--seconds", "3"), "start.x = 'a': is not a number"),
    ],
)
def test_mistakes_in_tune_are_one_line(file: str, words: tuple[str, ...], problem: str, tmp_path: Path) -> None:
    done = run("tune", file, *words, "--out", str(tmp_path))
    assert isinstance(done.exception, InputError)
    assert re.search(problem, str(done.exception))


def test_a_refused_tuning_leaves_no_folder(file: str, tmp_path: Path) -> None:
    done = run("tune", file, "--gain", "k=5..1", "--seconds", "3", "--out", str(tmp_path / "none"))
    assert "is not a range" in str(done.exception)
    assert not (tmp_path / "none").exists()


def test_a_cost_with_the_name_of_a_gain_is_refused(file: str) -> None:
    Path("mine.py").write_text(FILE.replace('"final": Cost', '"k": Cost'))
    done = run("simulate", file, "--seconds", "1")
    assert "costs.k: is a signal or a gain of the system" in str(done.exception)


def test_a_new_file_for_a_keyword_is_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("new", "law", "class").exit_code == 0
    assert "def class_()" in Path("class.py").read_text()


def test_lint_of_a_system_lists_all_that_cannot_work(file: str) -> None:
    more = """
    from dataclasses import replace

    def wrong():
        return replace(bare(), duration=1e9, ranges={"plant.blo": (0, 1), "plant.bli": (1, 2)}, within={"y": (0, 1)})

    def no_numbers():
        return replace(bare(), duration=float("nan"), ranges={"k": (2, 1)}, within={"x": (0, float("nan"))})
    """
    Path("mine.py").write_text(FILE + dedent(more))
    done = data("lint", "mine.py:wrong", status=1)
    assert [(one["level"], one["key"]) for one in done["findings"]] == [
        ("error", "duration"), ("error", "plant.blo"), ("error", "plant.bli"), ("error", "within.y"), ("info", "costs"),
    ]  # fmt: skip
    for command in ("lint", "verify", "simulate"):
        said = complaint(command, "mine.py:no_numbers")
        assert "duration = nan: is not a duration of a run (also wrong: ranges.k, within.x); give at least" in said
    good = data("lint", file)
    assert {one["key"] for one in good["findings"]} == {"duration", "ranges", "within"}
    assert "write mine.py:build" in complaint("lint", "mine.py")


def test_a_word_about_a_state_leaves_the_others_of_the_box(file: str) -> None:
    system = replace(own(file), within={"x": (-1.0, 1.0), "pose[0]": (-2.0, 2.0)})
    _, region, _ = region_words(["within.x=-0.5..0.5"], system)
    assert region is not None and region.within == {"x": (-0.5, 0.5), "pose[0]": (-2.0, 2.0)}


def test_a_region_of_a_system_is_proved_and_its_words_are_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loop.py").write_text(
        "from surctl.ir import Layout, Port\n"
        "from surctl.system import Controller, Plant, System\n"
        "X, U = Port('x', (1,), 'm', 'place'), Port('u', (1,), 'm/s', 'speed')\n"
        "K = Layout((Port('k', (1,), '1/s', 'gain', 2.0),))\n"
        "def build():\n"
        "    plant = Plant('cart', Layout((X,)), Layout((U,)), lambda x, f, d, p: {'x': x['x'] ** 3 + f['u']})\n"
        "    law = Controller('hold', 0.01, Layout((X,)), Layout((U,)), lambda x, u, p: -p['k'] * u['x'], gains=K)\n"
        "    return System(plant, law)\n"
    )
    result = data("verify", "loop.py:build", "within.x=-2..2", "lyapunov.function=x^2", "--out", "p")
    region = result["region"]
    assert region["verdict"] == "proved"
    assert 1.8 <= region["level"] < 2.0  # V' < 0 exactly where x^2 < k = 2
    about = json.loads((tmp_path / "p" / "cart.json").read_text())["claim"]["about"]
    assert about["gains"] == {"k": [2.0]}
    assert run("export", "loop.py:build", "--seconds", "0.1", "--out", "c").exit_code == 0
    assert run("check", "p/cart.json", "--bundle", "c").exit_code == 0
    # a plant that differs in a small part of the box, with the digests of the other one
    other = (
        Path("loop.py")
        .read_text()
        .replace("+ f['u']", "+ f['u'] + 2e-4 * ca.fmax(0, 1 - ca.fabs(x['x'] - 0.3123) / 1e-6)")
    )
    Path("other.py").write_text(f"import casadi as ca\n{other}")
    assert (
        run(
            "verify", "other.py:build", "within.x=-2..2", "lyapunov.function=x^2", "lyapunov.level=1", "--out", "o"
        ).exit_code
        == 0
    )
    document = json.loads(Path("o/cart.json").read_text())
    document["claim"]["about"] = about
    Path("o/cart.json").write_text(json.dumps(sealed(document)))
    checked = run("check", "o/cart.json", "--bundle", "c")
    assert checked.exit_code == 1 and "IS NOT BOUND to the controller" in checked.output
    assert "not shown: dynamics: rate of x: it is not shown to be the expression of the instruction" in checked.output
    # without a function, the region is that of the sampled loop
    result = run("verify", "loop.py:build", "within.x=-2..2", "--out", "q")
    assert "region of attraction of the sampled loop with held commands " in result.output
    assert "  u = -2*x" in result.output and "  x' = x*x^2 + u" in result.output
    checked = run("check", "q/cart.json", "--bundle", "c")
    assert checked.exit_code == 0 and "delay: the command is assumed to act at the instant" in checked.output
    stated = ("within.x=-2..2", "lyapunov.function=x^2", "lyapunov.level=1")
    assert data("study", "loop.py:build", *stated, "--seconds", "0.1", "--out", "s")["region"]["verdict"] == "proved"
    assert "<h2>Region of attraction" in re.sub(r"<h2[^>]*>", "<h2>", Path("s/report.html").read_text())
    for words, says in (
        (["within.y=-1..1"], "within.y: is not a state of the system"),
        (["within.x=1"], "within.x = '1': is not a range; write within.x=-1..1"),
        (["lyapunov.level=2"], "lyapunov.level: asks for a region of attraction, whose box is missing"),
        (["k=2..1"], "ranges.k = (2.0, 1.0): is not a range"),
        (["within.x=-1..1", "lyapunov.level=2"], "lyapunov.level: is given without a function"),
        (["within.x=-1..1", "lyapunov.function=z^2"], "'z' at column 1 is not known"),
    ):
        assert says in complaint("verify", "loop.py:build", *words)
    beside = data("verify", "loop.py:build", "within.x=1..2", status=1)
    assert beside["region"]["verdict"] == "not applicable" and beside["stable"] is True
    assert any("not assessed, because it rests at x = 0 m" in line["text"] for line in beside["assessment"]["lines"])


def test_dynamics_that_are_not_defined_at_a_corner_are_refused_without_a_warning() -> None:
    x, u, mass = Port("x", (1,), "m", ""), Port("u", (1,), "N", ""), Layout((Port("mass", (1,), "kg", "", 1.0),))
    plant = Plant("lift", Layout((x,)), Layout((u,)), lambda x, f, d, p: f["u"] / p["mass"] - 1, parameters=mass)
    law = Controller("hold", 0.1, Layout((x,)), Layout((u,)), lambda x, u, p: -2 * u["x"])
    dynamics = sampled_dynamics(System(plant, law), {"x": (-2.0, 2.0)}, ranges={"plant.mass": (0.5, 2.0)})
    massless = replace(dynamics, parameters=(replace(dynamics.parameters[0], lower=0.0),))
    with (
        np.errstate(invalid="raise"),
        pytest.raises(InputError, match=r"lift\.dynamics: is not finite at x = -0\.\d+, plant_mass = 0"),
    ):
        massless.rests()
