"""Laws of the user's own, FILE.py:FUNCTION: they fly, sweep and export like built-in ones, and say what is wrong."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from surctl.cli.app import app
from surctl.errors import InputError
from surctl.ir import replay
from surctl.marine.control import GainSpec, build_law, law_ref, law_source, load_gains, write_gains
from surctl.marine.export import build_bundle
from surctl.marine.report import save_run
from surctl.marine.report.evidence_sections import simulate_command
from surctl.marine.simulation import Case, law_numbers, load_scenario, simulate, simulate_batch
from surctl.marine.simulation.batch.case import case_parameters
from surctl.marine.testing import check_law
from surctl.marine.tuning import build_cases, gain_ranges
from surctl.marine.tuning.request import default_tuned
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification.cruise_loop import has_cruise_loop
from surctl.own_code import own_file

STUDY = Path(__file__).parents[2] / "analysis" / "27_own_law"

LAW = """
import casadi as ca
from surctl.marine.control import Decision, GainSpec, LawSource
from surctl.ir import Port
from surctl.tasks import Task, depth_task, heading_task

def decide(s):
    off, gain = s.p["stand_off"], s.p["k_wall"]
    wall = Task(name="wall", eta=s.eta, sigma=s.eta[1], target=off, gain=gain, unit="m", kinematics="vehicle")
    ahead = ca.fmin(s.p["cruise"], s.p["k1"] * (s.p["waypoints"][-1, 0] - s.eta[0]))
    along = Task(name="along", eta=s.eta, sigma=s.eta[0], target=s.eta[0], rate=ahead, unit="m", kinematics="vehicle")
    tasks = [wall, along, heading_task(s.eta, 0.3, gain=s.p["k_psi"]), depth_task(s.eta, s.p["depth"], gain=s.p["k2"])]
    return Decision(tasks, state={"way": s.x["way"] + s.dt * ahead})

def push(reference, nu, integral, p, dt):
    return p["k_push"] * (reference - nu) + p["linear_drag"] * reference, integral

GAINS = {
    "k_wall": GainSpec("1/s", "gain of the distance", default=0.4, range=(0.1, 1.0)),
    "stand_off": GainSpec("m", "distance from the wall", default=0.8, range=(0.6, 1.2)),
}
PUSH = {"k_push": GainSpec("N s/m", "gain of the velocity", default=120.0)}
WAY = (Port("way", (1,), "m", "distance commanded so far"), Port("kept", (1,), "m", "never changed", 0.7))

def wall(): return LawSource("wall", decide, gains=GAINS, state=WAY)
def pushed(): return LawSource("pushed", decide, gains=GAINS | PUSH, state=WAY, thrust=push)
"""


@pytest.fixture
def law(tmp_path: Path) -> str:
    (tmp_path / "my_law.py").write_text(LAW)
    return law_ref("my_law.py:wall", folder=tmp_path)


@pytest.fixture
def mission(tmp_path: Path) -> Path:
    water = replace(load_scenario("tank-static"), obstacles=(), path=load_scenario("tank-static").path)
    from surctl.marine.simulation.scenario import scenario_table
    from surctl.marine.simulation.toml_text import toml_text

    file = tmp_path / "water.toml"
    table = scenario_table(replace(water, name="water"))
    table |= {"path_m": [[1.0, 0.8], [2.5, 0.8]], "time_limit_s": 30.0}
    file.write_text(toml_text(table))
    return file


def surctl(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments], standalone_mode=False)


@pytest.mark.parametrize(("name", "mode"), [("pushed", "nsb")])  # with its own thrust: all parts of a law
def test_both_loops_fly_an_own_law_alike(law: str, mission: Path, name: str, mode: str) -> None:
    law = law_ref(f"{mission.parent}/my_law.py:{name}")
    scenario, vehicle = load_scenario(str(mission)), load_vehicle("sur540-flooded")
    built = build_law(law, mode=mode)
    run = simulate(scenario, vehicle, gains=load_gains("default"), law=built)
    assert run.metrics.reached
    case = Case(scenario, vehicle, load_gains("default"), law, mode=mode)  # type: ignore[arg-type]
    batch = simulate_batch(case, {"stand_off": np.array([0.8, 0.9])}, seeds=np.zeros(2, dtype=np.int64))
    np.testing.assert_allclose(batch.table[0], run.metrics.row(), rtol=0, atol=1e-9)
    assert batch.column("deviation_m")[1] > batch.column("deviation_m")[0] + 0.05  # the path is at 0.8 m
    way, kept = (run.record.law_state[-1, built.state.slice(port)] for port in ("way", "kept"))
    assert way > 1.0
    assert kept == 0.7


def test_what_is_exported_is_what_flew(law: str, mission: Path) -> None:
    scenario, vehicle = load_scenario(str(mission)), load_vehicle("sur540-flooded")
    built, gains = build_law(law), load_gains("default").with_own(law_source(law).gains)
    run = simulate(scenario, vehicle, gains=gains, law=built)
    p = law_numbers(scenario, gains, vehicle)
    tau, *_ = replay(
        built.block, run.record.law_state, run.record.law_input, np.tile(p, (len(run.record.law_state), 1))
    )
    assert np.abs(tau - run.record.tau).max() < 1e-12
    bundle = build_bundle(built, built.gains.unpack(p))
    assert bundle.name == "wall"
    assert "stand_off" in bundle.files["wall.h"]
    assert "distance from the wall" in bundle.files["README.md"] + bundle.files["wall.h"]


def test_own_gains_are_gains(law: str, tmp_path: Path, mission: Path) -> None:
    own = law_source(law).gains
    gains = load_gains("default").with_own(own)
    assert gains["stand_off"] == 0.8
    file = tmp_path / "mine.toml"
    file.write_text(write_gains(gains.with_values({"stand_off": 1.0})))
    assert load_gains(str(file), own=own)["stand_off"] == 1.0
    with pytest.raises(InputError, match="no such gain"):
        load_gains(str(file))
    with pytest.raises(InputError, match=r"stand_off.*greater than 0"):
        gains.with_values({"stand_off": -1.0})
    (case,) = build_cases([load_scenario(str(mission))], gains=load_gains("default"), law=law)
    assert case_parameters(case)["k_wall"].unit == "1/s"
    found = {g.name: (g.low, g.high) for g in gain_ranges(case.gains, default_tuned(case.gains))}
    assert found["k_wall"] == (0.1, 1.0)
    assert set(found) == {"k_wall", "stand_off", "k_v", "k_r"}


def test_a_law_without_a_linear_model_has_no_margins(law: str) -> None:
    """Commands leave their margins out: study 40."""
    assert not has_cruise_loop(law, "los")
    assert has_cruise_loop("guarded", "los")


def test_the_command_line_runs_an_own_law(law: str, mission: Path, tmp_path: Path) -> None:
    named = ["--law", own_file(law)]
    ran = surctl("simulate", mission, *named, "--monte-carlo", "--runs", 3, "--out", tmp_path / "mc")
    assert "reached          3 of 3" in ran.output
    worst = tmp_path / "mc/worst/water-worst-1.toml"
    refused = surctl("simulate", "--from", worst)
    assert "my_law.py:wall" in str(refused.exception)
    assert "--trust" in str(refused.exception)
    assert "as in the campaign" in surctl("simulate", "--from", worst, "--trust").output
    (tmp_path / "my_law.py").write_text(LAW.replace("0.3, gain", "0.31, gain"))
    changed = surctl("simulate", "--from", worst, "--trust")
    assert "has changed since this program first read it" in str(changed.exception)


def test_a_study_file_may_name_an_own_law(law: str, mission: Path, tmp_path: Path) -> None:
    study = tmp_path / "study.toml"
    study.write_text(
        'kind = "study"\nname = "mine"\nvehicle = "sur540-flooded"\nlaw = "my_law.py:wall"\n[[runs]]\n'
        'scenario = "water.toml"\n[sweep]\n[[sweep.axes]]\ngain = "k_wall"\nvalues = [0.3, 0.4]\n'
    )
    from surctl.marine.study import load_plan

    with pytest.raises(InputError, match=r"study.toml: law = 'my_law.py:wall': names Python code"):
        load_plan(str(study))
    assert load_plan(str(study), trust=True).law == law


BAD = {
    "return 3": "returns int, not LawSource",
    "1 / 0": r"line 10: made: fails with ZeroDivisionError",
    'return LawSource("guarded", hold)': "is the name of a built-in law",
    'return LawSource("surctl_guarded", hold)': "is the name of a built-in law",
    "return LawSource('a\"b', hold)": "is not a C identifier",
    'return LawSource("a", lambda s: 4)': "returned int, not Decision",
    'return LawSource("a", lambda s: Decision([]))': "has no task",
    'return LawSource("a", lambda s: Decision([3]))': "contains int",
    'return LawSource("a", hold, gains={"g": GainSpec("", "x", default=1.0)})': "has no unit",
    'return LawSource("a", hold, gains={"g": GainSpec("m", "x")})': "has no default",
    'return LawSource("a", hold, gains={"g": GainSpec("m", "x", default=-1.0)})': "must be greater than 0",
    'return LawSource("a", hold, gains={"k_v": GainSpec("m", "x", default=1.0)})': "or input of every law",
    'return LawSource("a", hold, state=(Port("side", (1,), "m", "x"),))': "or input of every law",
    'return LawSource("a", hold, state=(Port("z", (1,), "", "x"),))': "has no unit",
    'return LawSource("a", lambda s: hold(s, ca.SX.sym("z")))': r"my_law.py:made: .*not its arguments: z;",
    'return LawSource("a", lambda s: hold(s, math.sin(s.eta[0])))': r"line \d+: made: .*use casadi.sin instead",
    'return LawSource("a", None)': r"a\.decide: is of type NoneType; give a function",
    'return LawSource("a", hold, gains=[])': r"a\.gains: is of type list",
    'return LawSource("a", hold, gains={"g": GainSpec("m", "x", default="1")})': r"a\.gains\.g = '1': is not a number",
    'return LawSource("a", hold, gains={"g": GainSpec("m", "x", default=1.0, range=(1,))})': r"range = \(1,\): is not",
    'return LawSource("a", hold, gains={"g": GainSpec("m", "x", default=9.0, range=(1, 2))})': "is outside its range",
    'return LawSource("a", hold, sensing="truth")': r"a\.sensing = 'truth': is not a tuple of texts",
    'return LawSource("a", hold, sensing=("radar",))': r"a\.sensing = 'radar': is not known; known: sonar, truth",
    'return LawSource("a", hold, modes=("fast",))': r"a\.modes = 'fast': is not known",
    'return LawSource("a", hold, state=Port("z", (1,), "m", "x"))': r"a\.state: is one port; write \(port,\)",
    'return LawSource("a", lambda s: Decision(hold(s).levels[0]))': "a.levels: is one task",
    'return LawSource("a", lambda s: hold(s, ca.erf(s.eta[0])))': "my_law.py:made: .*operation 'erf' is not supported",
    'return LawSource("a", lambda s: hold(s, 1 if s.eta[0] > 0 else 0))': "use casadi.if_else",
    'return LawSource("a", lambda s: hold(s, s.p["dept"]))': "dept: no such name here; did you mean 'depth'",
    'return LawSource("a", lambda s: Decision(hold(s).levels, velocity=ca.SX.zeros(3)))': "has shape",
    'return LawSource("a", lambda s: Decision(hold(s).levels, state={"z": 1}))': "is not a state port of this law",
    'return LawSource("a", lambda s: Decision(hold(s).levels, state={"side": ca.MX.sym("q")}))': "is of type MX",
    'return LawSource("a", hold, state=(Port("z", (-1,), "m", "x"),))': "is not a shape",
    'return LawSource("a", hold, thrust=lambda w, nu, z, p, dt: w)': "returned AxisVector; return",
    'return LawSource("a", hold, thrust=lambda w, nu, z, p, dt: (nu["uu"], z))': "uu: no such name here.*'u'",
}


def test_a_velocity_controller_may_name_the_entries_of_its_vectors(tmp_path: Path) -> None:
    named = LAW.replace(
        'return p["k_push"] * (reference - nu) + p["linear_drag"] * reference, integral',
        'at = lambda v: ca.vertcat(v["u"], v["v"], v["w"], v["r"])\n'
        '    return p["k_push"] * (at(reference) - at(nu)) + p["linear_drag"] * at(reference), at(integral)',
    )
    assert named != LAW
    digests = []
    for name, text in (("one", LAW), ("other", named)):
        (tmp_path / f"{name}.py").write_text(text)
        digests.append(build_law(law_ref(f"{name}.py:pushed", folder=tmp_path)).block.digest())
    assert digests[0] == digests[1]


@pytest.mark.parametrize("body", BAD)
def test_each_mistake_is_one_line_with_the_file(tmp_path: Path, body: str) -> None:
    (tmp_path / "my_law.py").write_text(
        "import math\nimport casadi as ca\n"
        "from surctl.marine.control import Decision, GainSpec, LawSource\nfrom surctl.ir import Port\n"
        "from surctl.tasks import depth_task\n\ndef hold(s, depth=0):\n"
        '    return Decision([depth_task(s.eta, s.p["depth"] + depth, gain=0.4)])\n'
        f"def made():\n    {body}\n"
    )
    with pytest.raises(InputError, match=BAD[body]) as caught:
        build_law(law_ref("my_law.py:made", folder=tmp_path))
    assert "my_law.py" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_two_laws_of_a_file_have_two_names(tmp_path: Path, law: str) -> None:
    (tmp_path / "two.py").write_text(LAW + "\n\ndef copied():\n    return wall()\n")
    first = law_ref("two.py:wall", folder=tmp_path)
    assert law_ref("two.py:wall", folder=tmp_path) == first != law  # another file may have a law with this name
    with pytest.raises(InputError, match=r"two\.py:copied: name = '\w+': is the name of two laws, those of wall and"):
        law_ref("two.py:copied", folder=tmp_path)


def test_what_is_not_there_is_said(tmp_path: Path, law: str) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        law_ref("none.py:wall", folder=tmp_path)
    with pytest.raises(InputError, match=r"no such function; did you mean 'wall'"):
        law_ref("my_law.py:walls", folder=tmp_path)
    with pytest.raises(InputError, match=r"FILE\.py:FUNCTION for a law of your own"):
        law_ref("gaurded")
    with pytest.raises(InputError, match="supports only truth"):
        build_law("closed_form", sonar=True)


def test_a_changed_file_is_not_run_under_the_old_name(law: str, tmp_path: Path) -> None:
    (tmp_path / "my_law.py").write_text(LAW + "\n")
    with pytest.raises(InputError, match="has changed since this program first read it"):
        law_ref(law)
    assert law_ref("my_law.py:wall", folder=tmp_path) != law


def test_a_gain_spec_is_checked() -> None:
    with pytest.raises(InputError, match=r"^g\.range = \(0\.8, 0\.3\): is a reversed range; write \(low, high\)"):
        GainSpec("m", "a distance", default=0.5, range=(0.8, 0.3)).check_default("g")
    with pytest.raises(InputError, match="is outside its range"):
        GainSpec("m", "x", default=1.0, range=(2.0, 3.0)).check_default("a.gains.g")


@pytest.mark.parametrize("name", ["wall.py:wall", "station.py:station"])
def test_the_laws_of_the_study_pass_the_public_check(name: str) -> None:
    report = check_law(law_source(law_ref(name, folder=STUDY)))
    assert report.samples == 200
    assert report.name in name.replace("wall.py:wall", "wall_follower")


def test_a_report_and_its_files_name_an_own_law(law: str, mission: Path) -> None:
    run = simulate(
        load_scenario(str(mission)), load_vehicle("sur540-flooded"), gains=load_gains("default"), law=build_law(law)
    )
    assert run.to_dict()["law"] == "my_law.py:wall"
    assert f"--law {own_file(law)}" in str(simulate_command(run, "default"))
    assert "-wall-" in save_run(run, mission.parent).name


def test_a_case_is_pinned_to_the_text_of_the_file(law: str, mission: Path) -> None:
    scenario, vehicle = load_scenario(str(mission)), load_vehicle("sur540-flooded")
    assert Case(scenario, vehicle, load_gains("default"), own_file(law)).law == law


def test_the_text_that_runs_is_the_text_that_was_compared(tmp_path: Path) -> None:
    file = tmp_path / "my_law.py"
    for gain in ("0.4", "0.5"):  # of one length, in one second: Python's cached bytecode would be that of the first
        file.write_text(LAW.replace("default=0.4", f"default={gain}"))
        os.utime(file, (1, 1))
        assert law_source(law_ref("my_law.py:wall", folder=tmp_path)).gains["k_wall"].default == float(gain)
    assert [entry.name for entry in tmp_path.iterdir()] == ["my_law.py"]


def test_a_function_of_the_file_can_import_its_neighbour(tmp_path: Path) -> None:
    (tmp_path / "neighbour_of_law.py").write_text("SPEED = 0.1\n")
    late = "def decide(s):\n    from neighbour_of_law import SPEED\n"
    (tmp_path / "late.py").write_text(LAW.replace("def decide(s):\n", late))
    before = list(sys.path)
    assert build_law(law_ref("late.py:wall", folder=tmp_path)).name == "wall"
    assert sys.path == before


def test_a_number_that_is_not_finite_is_named(mission: Path, tmp_path: Path) -> None:
    text = LAW.replace('s.p["depth"], gain', 's.p["depth"] * ca.sqrt(-s.eta[0]), gain')
    (tmp_path / "lost.py").write_text(text)
    said = surctl("simulate", mission, "--law", tmp_path / "lost.py:wall").output
    assert "  fault: command tau[2] is not finite at 0.00 s" in said


def test_what_a_file_prints_or_does_to_the_path_stays_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = list(sys.path)
    for name, line in {"clears": "sys.path.clear()", "replaces": "sys.path = []"}.items():
        (tmp_path / f"{name}.py").write_text(f"import sys\n{line}\nprint('HELLO')\n{LAW}")
        assert law_source(law_ref(f"{name}.py:wall", folder=tmp_path)).name == "wall"
        assert sys.path == before
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "HELLO" in printed.err
