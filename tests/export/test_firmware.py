"""What a firmware engineer takes from a bundle compiles without a warning and runs: example, CMake, Python, Arduino."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from surctl.export import Bundle, write_bundle
from surctl.export.contract import STATUS
from surctl.ir import Layout, Port
from surctl.marine.control import build_law
from surctl.marine.export import build_bundle
from surctl.marine.export.origin import origin_entries, origin_of
from surctl.marine.sensing import Equipment, SonarArray
from surctl.marine.simulation import load_scenario
from surctl.marine.vehicle import load_vehicle
from tests.export.closed_form import SCENARIO, exported
from tests.export.standin import StandIn
from tests.export.test_gains_in_c import guarded
from tests.tools import PATIENCE, need, need_compiler, need_make


def wiring_of(equipment: Equipment) -> str:
    """Return the section about the wiring of a law with these sensors."""
    law = build_law(sonar=True, equipment=equipment)
    origin = origin_of(law, load_vehicle("sur400"), equipment=equipment)
    return build_bundle(law, {}, origin=origin).files["README.md"].split("## Wiring")[1]


def test_the_wiring_states_the_pitch_of_the_sonars() -> None:
    for pitch, words in ((-0.3, "75° wide, its axis 17.2° below the horizontal."), (0.0, "75° wide. No echo")):
        assert words in wiring_of(Equipment(array=SonarArray(pitch=pitch)))


@pytest.mark.parametrize("within", [None, 0.3])
def test_the_wiring_states_the_echoes_that_the_law_assumes_and_not_those_of_a_run(within: float | None) -> None:
    array = SonarArray(incidence_limit=within)
    assert "a face answers within 22.5° of its normal" in wiring_of(Equipment(array=array))


def test_the_wiring_and_the_manifest_state_the_search_limit() -> None:
    law, vehicle = build_law("closed_form"), load_vehicle("sur400")
    for limit, entries in ((None, {}), (60.0, {"search_limit_s": 60.0})):
        equipment = Equipment(search_limit=limit)
        origin = origin_of(law, vehicle, equipment=equipment)
        assert ("Search limit: after 60 s without progress" in wiring_of(equipment)) is bool(entries)
        stated = origin_entries(law, law.gains.pack({}), origin)["sensors"]
        assert stated == entries


STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O1", "-ffp-contract=off")
C_FILES = ("main_example.c", "loop.c", "board_example.c")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    need_compiler()
    at = tmp_path_factory.mktemp("firmware") / "b"
    write_bundle(guarded()[1], at)
    return at


def build(compiler: str, folder: Path, files: list[str], out: str, *more: str) -> Path:
    command = [compiler, "-std=c99", *STRICT, *more, "-I.", "-o", out, *files, "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder / out


def code(bundle: Bundle) -> list[str]:
    return [*bundle.sources, bundle.selftest]


def test_the_example_compiles_strictly_and_its_loop_runs(folder: Path) -> None:
    """By gcc: the test below and the smallest bundle's."""
    program = build(need("clang"), folder, [*C_FILES, *code(guarded()[1])], "example-clang")
    done = subprocess.run([program], capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0 and done.stdout.startswith("sample 1: status ")


BOARD = """#include "board.h"
#include <math.h>
#include <stdio.h>
static int tick, disarmed;
uint32_t board_wait(void) { ++tick; return (tick <= 200) ? ((tick == 60) ? 5u : 1u) : 0u; }
int board_measure(surctl_closed_form_input_t *input)
{
    input->eta[0] = 1.0; input->eta[1] = 0.8; input->eta[2] = ((tick > 80) && (tick <= 110)) ? NAN : -0.15;
    input->nu[0] = 0.05;
    return !((tick > 50) && (tick < 55));
}
void board_actuate(const surctl_closed_form_output_t *output) { (void)printf("%d ", output != NULL); }
int board_armed(void) { disarmed = (tick < 2) || ((tick >= 120) && (tick < 125)); return !disarmed; }
void board_alive(void) { (void)printf("alive\\n"); }
void board_log(const surctl_closed_form_loop_t *loop)
{
    (void)printf("%d %lu ", loop->status, (unsigned long)loop->input.sample);
}
size_t board_stored(unsigned char *bytes, size_t room) { (void)room; bytes[0] = 0; return 5; }
void board_gains(int result) { (void)fprintf(stderr, "gains %d", result); }
"""


def test_the_example_reacts_to_each_status(folder: Path) -> None:
    (folder / "board_test.c").write_text(BOARD)
    program = build("gcc", folder, ["main_example.c", "loop.c", "board_test.c", *code(guarded()[1])], "scripted", "-O0")
    done = subprocess.run([program], capture_output=True, text=True, timeout=PATIENCE, check=True)
    assert done.stderr == "gains -11"  # stored bytes of another length are reported, not ignored
    first, *rest = done.stdout.split(" ", 1)
    assert first == "0"  # before anything, the actuators are off
    rows = [line.split() for line in rest[0].splitlines()]
    on, status, sample = (np.array([int(row[k]) for row in rows]) for k in range(3))
    tick = np.arange(1, 201)
    assert all(row[-1] == "alive" for row in rows)
    assert not on[tick < 20].any() and on[(tick >= 21) & (tick <= 50)].all()  # armed after one second
    assert (status[(tick > 50) & (tick < 55)] == -4).all() and not on[(tick > 50) & (tick < 55)].any()
    assert sample[54] - sample[49] == 5 and on[54] == 1  # the periods without a sample count, and it goes on
    assert sample[59] - sample[58] == 5  # so do the periods that the timer missed
    assert (status[(tick > 80) & (tick <= 110)] == -2).all() and not on[(tick > 80) & (tick <= 110)].any()
    assert not on[(tick > 110) & (tick < 120)].any()  # a second of refused steps: only the operator arms again
    assert on[tick > 150].all() and not on[(tick >= 120) & (tick < 125)].any()


def test_cmake_builds_and_tests_the_bundle(folder: Path) -> None:
    cmake, ctest = need("cmake"), need("ctest")
    build_folder = folder / "cmake-build"
    for command in (
        [cmake, "-S", ".", "-B", str(build_folder), "-DCMAKE_C_COMPILER_WORKS=1"],
        [cmake, "--build", str(build_folder)],
    ):
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    done = subprocess.run([ctest, "--test-dir", str(build_folder)], capture_output=True, text=True, check=False)
    assert "100% tests passed" in done.stdout, done.stdout


USE = """
import numpy as np, surctl_closed_form as module
c = module.Controller()
assert c.selftest() and len(c.id) == 64
status, out = c.step(eta=[1.0, 0.8, -0.15, 0.0], nu=[0.05, 0.05, 0.0, 0.1])
print(status, out["tau"].tolist(), c.gains_id)
stored = c.save_gains()
c.set_gains(k_v=1.25)
c.begin()
assert c.state[0] == 0 and c.input["eta"][0] == 1.0
try:
    c.set_gains(k_v=1.0, mass=[0, 0, 0, 0])
except ValueError as wrong:
    assert "mass" in str(wrong) and c.gains["k_v"][0] == 1.25
try:
    c.set_gains(k_v=1.0, mass=[50.0])
except ValueError:
    assert c.gains["k_v"][0] == 1.25
c.load_gains(stored)
assert c.gains["k_v"][0] == 1.5
try:
    c.load_gains(stored[:-1] + b"!")
except ValueError as wrong:
    assert "-15" in str(wrong)
assert c.step(eta=[np.nan] * 4)[0] == module.STATUS["NONFINITE"]
"""


def test_the_python_wrapper_is_built_as_pip_does_and_computes_the_same(folder: Path, tmp_path: Path) -> None:
    assert_the_wrapper_computes_the_same(folder, tmp_path, "setup.py", "-q", "build", "--build-lib", "site")


def assert_the_wrapper_computes_the_same(folder: Path, tmp_path: Path, *install: str) -> None:
    """Installed by these words of Python, in which `site` stands for the folder."""
    law, _, p = guarded()
    site = tmp_path / "site"
    words = [sys.executable, *(str(site) if word == "site" else word for word in install)]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    env = {**os.environ, "PYTHONPATH": str(site)}
    done = subprocess.run(
        [sys.executable, "-c", USE], env=env, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    u = law.inputs.pack({"eta": [1.0, 0.8, -0.15, 0.0], "nu": [0.05, 0.05, 0.0, 0.1]})
    u[law.inputs.slice("contacts")] = 0.0
    step = law.step(law.initial_state(), u, p)
    status, rest = done.stdout.split(" ", 1)
    assert int(status) == step.status and rest.startswith(str(step.tau.tolist()))


def test_make_arduino_lays_out_a_library_whose_sketch_compiles_as_cpp11(folder: Path) -> None:
    make, compiler = need_make(), need("g++")
    subprocess.run([make, "arduino"], cwd=folder, check=True, capture_output=True)
    library = folder / "arduino/surctl_closed_form"
    assert (library / "library.properties").read_text().startswith("name=surctl_closed_form\nversion=")
    assert {*guarded()[1].sources, *guarded()[1].headers, "loop.c", "loop.h"} <= {
        file.name for file in (library / "src").iterdir()
    }
    sketch = library / "examples/run/run.ino"
    (folder / "Arduino.h").write_text(
        "struct Port { void begin(long) {} void println(int) {} };\nextern Port Serial;\nunsigned long micros();\n"
    )
    command = [
        compiler,
        "-std=c++11",
        "-Wall",
        "-Wextra",
        "-Wpedantic",
        "-Werror",
        "-x",
        "c++",
        "-include",
        "Arduino.h",
    ]
    command += ["-I.", f"-I{library / 'src'}", "-c", "-o", "sketch.o", str(sketch)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


LOST = """#include "loop.h"
#include <stdio.h>
int main(void)
{
    static lost_loop_t loop;
    if (lost_loop_start(&loop) != 0) { return 1; }
    for (int k = 1; k <= 150; ++k) { /* fixes come in periods 31 to 60, and again from period 106 on */
        loop.input.fix_fresh = ((k > 30) && (k <= 60)) || (k > 105);
        const int applied = lost_loop_step(&loop, 1u, 1, (k > 1) && (k != 130));
        (void)printf("%d%d ", applied, loop.mode);
        lost_loop_end(&loop);
    }
    return 0;
}
"""


def test_lost_fixes_hold_the_robot_though_every_step_is_accepted(tmp_path: Path) -> None:
    need_compiler()
    x, u, p = ca.SX.sym("x"), ca.SX.sym("u"), ca.SX.sym("p", 0)
    age = ca.if_else(u > 0.5, 0.03, ca.fmin(x + 0.05, 60.0))
    layouts = (
        Layout((Port("own_age", (1,), "s", "age of the last fix", default=60.0, gap="age"),)),
        Layout((Port("fix_fresh", (1,), "1", "1 if it has arrived"),)),
        Layout(()),
        Layout((Port("tau", (4,), "N, N, N, N m", "thrust"),)),
    )
    function = ca.Function("law", [x, u, p], [ca.SX.ones(4), age, ca.SX(0), ca.SX(0, 1)])
    bundle = build_bundle(StandIn("lost", 0.05, *layouts, function), {})
    write_bundle(bundle, tmp_path)
    (tmp_path / "main_lost.c").write_text(LOST)
    program = build("gcc", tmp_path, ["main_lost.c", "loop.c", *code(bundle)], "run", "-O0")
    words = subprocess.run([program], capture_output=True, text=True, check=True).stdout.split()
    applied, mode = (np.array([int(word[k]) for word in words]) for k in range(2))
    steps = np.arange(1, 151)
    # armed after 20 steps with a fix; held 1 s after the last one; 1 s later only the operator arms again, in step 131
    assert (applied == (((steps >= 50) & (steps <= 79)) | (steps == 150))).all(), "".join(map(str, applied))
    assert set(mode[79:98]) == {2} and set(mode[98:129]) == {3}


STALL = """#include "loop.h"
#include <stdio.h>
int main(void)
{
    static stall_loop_t loop;
    if (stall_loop_start(&loop) != 0) { return 1; }
    loop.gains.k = 0.5; /* as if it were stored */
    for (int k = 0; k < 430; ++k) { /* armed from 2 s on, but not from 4 to 10 s, and not in one step at 17 s */
        const int armed = (k >= 40) && !((k >= 80) && (k < 200)) && (k != 340);
        const int applied = stall_loop_step(&loop, 1u, 1, armed);
        (void)printf("%d,%d,%.0f,%g ", applied, loop.status, 20.0 * loop.state.x[stall_at_progress], loop.gains.k);
        stall_loop_end(&loop);
    }
    return 0;
}
"""


def test_a_pause_is_no_dead_end_and_arming_ends_one(tmp_path: Path) -> None:
    """The law moves on for 2 s, and is trapped after 3 s without progress."""
    need_compiler()
    x, u, p = ca.SX.sym("x", 4), ca.SX.sym("u"), ca.SX.sym("p")
    progress, stalled, searching, trapped = ca.vertsplit(x)
    moved = progress < 1.99
    stalled, searching = ca.if_else(moved, 0, stalled + 0.05), ca.if_else(moved, 0, searching + 0.05)
    trapped = ca.logic_or(trapped, ca.fmax(stalled, searching) > 2.99)
    after = ca.vertcat(progress + 0.05 * moved, stalled, searching, trapped)
    layouts = (
        Layout(tuple(Port(name, (1,), "1", name) for name in ("progress", "stalled", "searching", "trapped"))),
        Layout((Port("depth", (1,), "m", "depth"),)),
        Layout((Port("k", (1,), "1", "gain", default=1.0),)),
        Layout((Port("tau", (4,), "N, N, N, N m", "thrust"),)),
    )
    function = ca.Function("law", [x, u, p], [p * ca.SX.ones(4), after, 8 * trapped, ca.SX(0, 1)])
    bundle = build_bundle(StandIn("stall", 0.05, *layouts, function), {})
    write_bundle(bundle, tmp_path)
    (tmp_path / "main_stall.c").write_text(STALL)
    program = build("gcc", tmp_path, ["main_stall.c", "loop.c", *code(bundle)], "run", "-O0")
    words = subprocess.run([program], capture_output=True, text=True, check=True).stdout.split()
    applied, status, progress, gain = np.array([word.split(",") for word in words], dtype=float).T
    steps = np.arange(430)
    # applied 1 s after the first arming, at once after a pause, 1 s after the arming that ends the dead end
    expected = (steps >= 59) & (steps < 80) | (steps >= 200) & (steps < 340) | (steps >= 360)
    assert (applied == expected).all(), applied.astype(int).tolist()
    assert (progress[[39, 40, 79, 200]] == [40, 1, 40, 40]).all()  # begun at the arming, kept in the pause
    assert (status == 8 * ((steps >= 259) & (steps <= 340))).all(), np.flatnonzero(status)[[0, -1]]
    assert progress[341] == 1 and (gain == 0.5).all()


def test_the_smallest_bundle_has_an_example_too(tmp_path: Path) -> None:
    need_compiler()
    _, bundle, _ = exported("float32")
    write_bundle(bundle, tmp_path)
    program = build("gcc", tmp_path, [*C_FILES, *code(bundle)], "example")
    assert subprocess.run([program], capture_output=True, check=False).returncode == 0
    assert not any(file.endswith(("_gains.c", "_gains.h")) for file in bundle.files)


def test_the_readme_says_where_every_input_comes_from_and_what_every_status_demands() -> None:
    mission, robot = load_scenario("tank-static"), load_vehicle("sur400")
    sensors = mission.sensors.equipment  # of another hull: the places are those of this vehicle
    law = build_law(sonar=True, equipment=sensors)
    files = build_bundle(law, {}, origin=origin_of(law, robot, equipment=sensors)).files
    readme = files["README.md"]
    wiring = readme.split("## Wiring")[1].split("## Gains")[0]
    for port in law.inputs:
        row = re.search(rf"\| `input\.{port.name}` \| (.*) \|", wiring)
        assert row and "See unit and meaning" not in row.group(1), port.name
    for name, code_, _ in STATUS:
        assert re.search(rf"\| `{name}` \({code_}\) \| (Apply|Thrusters to zero).*\. \|\n", wiring), name
    for words in (
        "A row is one echo",
        "Without an echo, every column is 4.5, not 0",
        "Origin of the ranges: the sonar's place on the hull",
        "0: (0.2, 0) m, axis 0°; 1: (0, 0.2) m, axis 90°; 2: (-0.2, 0) m, axis 180°; 3: (0, -0.2) m, axis -90°",
        "fix 10 mm on each axis, yaw 0.01 rad, yaw rate 0.005 rad/s. Larger noise is not covered",
        "position of the hull's centre",
        "A corner that points at the hull may be heard too late or not at all",
        "has not arrived: keep the old number, with flag 0",
        "the robot coasts",
        "a step whose age is above 1 s counts as\na refused one",
        "The robot has arrived when",
        "the robot turns without pause",
        "`output.healthy` of a sonar is 0",
        "The mission begins when the operator arms",
        "Moving obstacles only",
        "Place the robot at the first waypoint",
        "is refused 10 times",
        "one sonar every 0.025 s in the order 0, 1, 2, 3",
        "Fixes: every 0.1 s, 0.1 s old when they arrive",
        "Messages with moving obstacles: every 0.1 s, 0.1 s old",
        "beam 75° wide",
        "Start-up order",
        "Check list before the water",
        "What to log",
        "SAFE",
    ):
        assert words in wiring, words
    assert "memset(&input, 0, sizeof input);" in readme
    assert "for (int k0 = 0; k0 < 4; ++k0) for (int k1 = 0; k1 < 5; ++k1) { input.samples[k0][k1] = 4.5; }" in readme
    assert '"samples": 4.5' in files["surctl_guarded.py"].split("UNMEASURED = ")[1]
    assert re.search(rf"\| state \| `own_age` \| s \| .* \| {law.state.slice('own_age').start} \|\n", readme)
    assert "then `state.progress`, then `state.own_age`, then `output.healthy[4]`: 100 bytes" in readme
    cleared = files["loop.c"].split("if ((loop->status >= 0) || (loop->refused >= ")[1]
    assert all(f"loop->input.{flag} = 0.0;" in cleared for flag in ("fix_fresh", "contacts_fresh", "fresh[k]"))
    assert 'FLAGS = ["fix_fresh", "contacts_fresh", "fresh"]' in files["surctl_guarded.py"]


def test_what_the_readme_says_of_arrival_and_lost_fixes_holds() -> None:
    _, bundle, flight = exported("float64")
    mission = load_scenario(SCENARIO)
    corners = np.array(mission.path.waypoints).reshape(-1, 2)
    length = float(np.hypot(*np.diff(corners, axis=0).T).sum())
    assert flight.X[-1, 0] == pytest.approx(length, abs=1e-9)  # progress at the end of a run that arrived
    arrival = " ".join(bundle.files["README.md"].split("Arrival: ")[1].split())
    assert "at the sum of the distances between the `waypoints`" in arrival
    assert f"({mission.arrival_radius:g} m if it has none)" in arrival  # that of a mission file without the key
    law = build_law(sonar=True)
    lost = build_bundle(law, {}).files["README.md"].split("Lost fixes: ")[1]
    assert f"({law.state.port('own_age').default:g} before the first;" in lost


def test_a_module_of_whole_centimetres_with_one_number_a_firing_is_wired_as_such() -> None:
    sensors = Equipment(array=SonarArray(step=0.01, maximum=4.5, samples=1))
    told = wiring_of(sensors)
    assert "Conversion step 10 mm" in told and "1 sample a firing" in told


def test_thrusters_are_listed_with_place_direction_and_force() -> None:
    robot = load_vehicle("bluerov2-heavy")
    law = build_law("closed_form", actuators=robot.actuators)
    readme = build_bundle(law, {}, origin=origin_of(law, robot)).files["README.md"]
    assert robot.actuators is not None
    for thruster in robot.actuators.thrusters:
        assert f"| {thruster.name} | {', '.join(f'{v:.3g}' for v in thruster.at)} |" in readme
