"""The C that feeds an exported law with a mission gives the windows, states and commands of the Python loop."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.export import Records, build_controller, compare_runs, connect, write_bundle
from surctl.export.contract import transfers
from surctl.ir.cache import compile_program
from surctl.marine.control import build_law, load_gains
from surctl.marine.export import LinkedLaw, LinkFaults, build_bundle
from surctl.marine.guidance import Path
from surctl.marine.simulation import Scenario, law_numbers, load_scenario, simulate
from surctl.marine.vehicle import load_vehicle
from tests.export.standin import stand_in
from tests.export.test_link import serving

VEHICLE, GAINS = load_vehicle("sur400"), load_gains("default")

MAIN = r"""
#include "mission_data.h"
#include <stdio.h>
static NAME_state_t state;
static NAME_gains_t gains;
static NAME_input_t input;
static NAME_output_t output;
static double numbers[INPUTS];
int main(void)
{
    NAME_mission_t mission;
    uint32_t sample = 0;
    NAME_initialize(&state, &gains);
    if (NAME_mission_start(&mission, NULL, 9, &gains) != -1
        || NAME_mission_start(&mission, NAME_waypoints, 1, &gains) != -1
        || NAME_mission_start(&mission, NAME_waypoints, COUNT, &gains) != 0) { return 3; }
    while (fread(numbers, sizeof numbers, 1, stdin) == 1) {
        LOAD
        input.sample = ++sample;
        NAME_mission_feed(&mission, &state, &gains);
        const double fed[3] = { gains.depth, gains.cruise, gains.visit };
        fwrite(gains.waypoints, sizeof gains.waypoints, 1, stdout);
        fwrite(fed, sizeof fed, 1, stdout);
        fwrite(state.x, sizeof state.x, 1, stdout);
        if (NAME_step(&state, &gains, &input, &output) < 0) { return 4; }
        fwrite(output.tau, sizeof output.tau, 1, stdout);
    }
    return 0;
}
"""


def mission(count: int, *, seconds: float) -> Scenario:
    t = np.linspace(0, 2 * np.pi, count)
    points = np.stack([5 + 4 * np.sin(t), 2.5 + 1.5 * np.sin(2 * t)], axis=1)
    kinds = np.where(np.arange(count) % 10 == 3, 1.0, 0.0)
    path = Path(points, -0.5 * np.sin(t / 2), np.where(np.arange(count) % 4, 0.0, 0.18), kinds)
    site = load_scenario("tank-static")
    return replace(site, path=path, obstacles=(), time_limit=seconds, cruise=0.2, depth=-1.0)


@pytest.mark.parametrize(("law_name", "count", "seconds"), [("guarded", 200, 25.0), ("closed_form", 6, 70.0)])
def test_the_same_windows_states_and_commands_as_in_python(
    tmp_path: FilePath, law_name: str, count: int, seconds: float
) -> None:
    scenario, law = mission(count, seconds=seconds), build_law(law_name)
    run = simulate(scenario, VEHICLE, gains=GAINS, law=law)
    p = law_numbers(scenario, GAINS, VEHICLE)
    bundle = build_bundle(law, law.gains.unpack(p), mission=scenario.path.table())
    write_bundle(bundle, tmp_path)
    load = "\n".join(
        f"{each}input.{member} = numbers[{at}];{' }' if each else ''}" for each, member, at in transfers(law.inputs)
    )
    text = MAIN.replace("NAME", bundle.name).replace("INPUTS", str(law.inputs.size)).replace("COUNT", str(count))
    (tmp_path / "main.c").write_text(text.replace("LOAD", load))
    code = [tmp_path / file for file in ("main.c", "mission.c", *bundle.sources)]
    program = compile_program(code, tmp_path / "fed", flags=("-Wall", "-Wextra", "-Wconversion", "-Werror"))
    done = subprocess.run([program], input=run.record.law_input.tobytes(), capture_output=True, check=True)
    fed = run.record.fed
    assert fed is not None
    columns = [fed[:, law.gains.slice(name)] for name in ("waypoints", "depth", "cruise", "visit")]
    expected = np.hstack([*columns, run.record.law_state, run.record.tau])
    found = np.frombuffer(done.stdout).reshape(len(fed), -1)
    assert found.tobytes() == expected.tobytes()
    windows = len(np.unique(columns[0], axis=0))
    assert windows > 20 if count > 8 else windows == 1
    assert len(np.unique(columns[2])) == len(np.unique(columns[3])) == 2 and len(np.unique(columns[1])) > 100


def test_a_moved_window_is_no_reset_in_the_loop_with_the_software(tmp_path: FilePath) -> None:
    scenario, law = mission(150, seconds=12.0), build_law("closed_form")
    record = simulate(scenario, VEHICLE, gains=GAINS, law=law).record
    bundle = build_bundle(law, law.gains.unpack(law_numbers(scenario, GAINS, VEHICLE)))
    (report,) = compare_runs(
        build_controller(law, bundle, tmp_path), [Records(record.law_state, record.law_input, record.step_parameters)]
    )
    assert report.conclusive and report.tau.mixed == 0.0


def test_a_law_without_a_path_has_no_mission() -> None:
    assert "mission.c" not in build_bundle(stand_in(), {"k_p": np.array([1.0, 2.0, 0.1, 0.8])}).files
    law = build_law("closed_form")
    p = law_numbers(load_scenario("pool-behind"), GAINS, VEHICLE)
    single = build_bundle(law, law.gains.unpack(p), real="float32", mission=mission(12, seconds=1.0).path.table())
    assert "sqrtf(" in single.files["mission.c"] and "5.0f" in single.files["mission_data.h"]
    with pytest.raises(InputError, match="takes no waypoints"):
        build_bundle(stand_in(), {"k_p": np.array([1.0, 2.0, 0.1, 0.8])}, mission=np.zeros((9, 5)))
    with pytest.raises(InputError, match=r"has shape \(9, 2\)"):
        build_bundle(law, law.gains.unpack(p), mission=np.zeros((9, 2)))


def test_a_controller_process_and_the_loop_of_the_examples_feed_themselves(tmp_path: FilePath) -> None:
    scenario, law = mission(150, seconds=8.0), build_law("closed_form")
    p = law_numbers(scenario, GAINS, VEHICLE)
    bundle = build_bundle(law, law.gains.unpack(p), mission=scenario.path.table())
    write_bundle(bundle, tmp_path)
    code = [tmp_path / file for file in ("controller.c", "link.c", "loop.c", "mission.c", *bundle.sources)]
    built = compile_program([*code, tmp_path / bundle.selftest], tmp_path / "controller", flags=("-O0",))
    direct = simulate(scenario, VEHICLE, gains=GAINS, law=law).record
    for compact in (False, True):
        with serving(built) as (_, where), connect(where) as line:
            linked = LinkedLaw(law, p, line, compact=compact, fed=True)
            record = simulate(scenario, VEHICLE, gains=GAINS, law=law, stepper=linked).record
        assert (linked.report().differing, linked.report().answered) == (0, 160)
        assert record.tau.tobytes() == direct.tau.tobytes() and record.law_state.tobytes() == direct.law_state.tobytes()
    assert record.fed is not None and len(np.unique(record.fed[:, law.gains.slice("waypoints")], axis=0)) > 2
    assert all("_mission_feed(" in bundle.files[file] for file in ("loop.c", "link.c"))
    for file in ("Makefile", "CMakeLists.txt", "ros2/CMakeLists.txt", "zephyr/CMakeLists.txt"):
        assert "mission.c" in bundle.files[file]
    with serving(built) as (_, where), connect(where) as line, pytest.raises(InputError, match="drop --link-loss"):
        LinkedLaw(law, p, line, LinkFaults(loss=0.1), fed=True)
