"""Range, stale samples, jumps: the guard of the C and of Python refuse the same, and then nothing thrusts."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.export import REALS, TARGETS, Envelope, build_controller, check_builds, compare_runs, write_bundle
from surctl.export.envelope import ITER, RANGE, Rate, anywhere
from surctl.export.precision import Guarded, evaluated, in_precision, replayed
from surctl.export.process import compile_controller
from surctl.export.sil import fault_cases
from surctl.ir import Real
from surctl.marine.control import build_law
from surctl.marine.export import operating_envelope
from surctl.marine.simulation import load_scenario
from surctl.marine.vehicle import load_vehicle
from tests.export.altered import altered
from tests.export.closed_form import exported, vehicle
from tests.export.standin import stand_in
from tests.tools import need, need_compiler


@pytest.mark.parametrize("real", ["float32", "float64"])
def test_every_bad_input_is_refused_alike_in_c_and_in_python(tmp_path: Path, real: Real) -> None:
    need_compiler()
    law, bundle, flight = exported(real)
    (report,) = compare_runs(build_controller(law, bundle, tmp_path / "b"), [flight])
    assert report.conclusive, report.summary()
    within = bundle.envelope
    assert within is not None
    labels = [fault.label for fault in fault_cases(law, within, real=real)]
    numbers = law.state.size + law.inputs.size
    assert sum("nan" in label for label in labels) == sum("= -inf" in label for label in labels) == numbers
    assert sum("out of its range" in label for label in labels) == 2 * numbers  # every one has a range
    assert report.fault_cases > len(labels) + len(within.rates)  # the jumps


def test_a_row_that_jumps_is_refused_and_the_next_one_too_until_time_allows(tmp_path: Path) -> None:
    need_compiler()
    law, bundle, flight = exported("float32")
    assert bundle.envelope is not None
    controller = build_controller(law, bundle, tmp_path / "b")
    run = replace(flight, U=flight.U.copy(), X=flight.X[:40], P=flight.P[:40])
    run = replace(run, U=run.U[:40])
    run.U[10:, 1] += 0.45  # [m]: with 0.1 m of noise and 0.063 m a sample, six samples of standing aside
    load = np.zeros(40, dtype=bool)
    load[0] = True
    c = controller.run(run, load=load)
    states = np.vstack([run.X[:1], c.state[:-1]])
    python = replayed(controller.law, replace(run, X=states), load)
    assert np.array_equal(c.status, python.status)
    refused = np.flatnonzero(c.status == RANGE)
    assert refused.size >= 3 and list(refused) == list(range(10, 10 + refused.size))
    assert not c.tau[refused].any() and (c.status[10 + refused.size :] >= 0).all()
    assert np.array_equal(c.state[refused], states[refused].astype(np.float32))
    # each row by itself is fine: nothing but the jump was wrong
    assert (evaluated(controller.law, states, run.U, run.P).status >= 0).all()


def test_a_heading_that_goes_round_is_no_jump_in_c_either(tmp_path: Path) -> None:
    need_compiler()
    law, bundle, flight = exported("float32")
    run = replace(flight, U=flight.U[:40].copy(), X=flight.X[:40], P=flight.P[:40])
    run.U[:, law.inputs.slice("eta").stop - 1] = np.where(np.arange(40) % 2, 3.13, -3.14)
    load = np.arange(40) == 0
    assert (build_controller(law, bundle, tmp_path / "b").run(run, load=load).status >= 0).all()


def test_whole_turns_are_no_jump() -> None:
    box = np.tile([-np.inf, np.inf], (1, 1))
    for turn, refused in ((True, False), (False, True)):
        envelope = Envelope(np.zeros((0, 2)), box, np.zeros((0, 2)), (Rate(0, 1.0, 0.1, turn=turn),))
        now, before = np.array([2 * np.pi - 0.01]), np.array([0.01])
        assert envelope.jumped(now, before, 1, dt=0.05, real="float64") is refused
        assert envelope.jumped(np.array([1.0]), before, 1, dt=0.05, real="float64")
        assert not envelope.jumped(np.array([1.0]), before, 20, dt=0.05, real="float64")


def test_ranges_are_told_in_header_readme_and_manifest() -> None:
    _, bundle, _ = exported("float32")
    header, readme = bundle.files["surctl_closed_form.h"], bundle.files["README.md"]
    assert "x, y, z and heading" in header and "-1 to 4; -1 to 3; -2 to 1; -1000 to 1000 */" in header
    assert "uint32_t sample;" in header and "within 0.1 + " in header
    assert "## Constants" in readme and "| `k1` | 0.3 | 1/s |" in readme
    assert '"contacts": ' in bundle.files["manifest.json"] and "| -4; -1" not in readme


def test_what_the_guard_bounds_comes_from_site_and_vehicle() -> None:
    law, mission = build_law("closed_form"), load_scenario("pool-ahead")
    small = operating_envelope(law, mission, vehicle(), law.gains)
    wide = operating_envelope(law, replace(mission, site=(30.0, 20.0, 5.0)), vehicle(), law.gains)
    assert (wide.inputs[:3, 1] >= small.inputs[:3, 1]).all() and wide.inputs[0, 1] == 31.0
    strong = vehicle().with_values({"Fu_max": 4 * vehicle()["Fu_max"]})
    assert operating_envelope(law, mission, strong, law.gains).inputs[4, 1] > small.inputs[4, 1]
    assert {rate.entry for rate in small.rates} == set(range(8)) and np.isfinite(small.gains).all()


@pytest.mark.parametrize("name", ["otter", "remus100", "eca-a9", "cybership2", "rexrov"])
def test_the_guard_accepts_the_drift_of_a_coupled_craft_in_a_turn(name: str) -> None:
    law, craft = build_law("closed_form"), load_vehicle(name)
    box = operating_envelope(law, load_scenario("pool-behind"), craft, law.gains)
    assert np.isfinite(box.inputs[:7]).all() and np.isfinite(box.state).all()
    surge, sway, _, yaw = box.inputs[law.inputs.slice("nu"), 1]
    assert sway == surge > 0 and yaw > (surge - 1) / (2 * craft["radius"])


def test_the_guard_accepts_the_numbers_of_another_vehicle_of_its_size() -> None:
    law = build_law("steered")
    box = operating_envelope(law, load_scenario("pool-behind"), load_vehicle("otter"), law.gains).gains
    ahead, munk, fins = (box[law.gains.slice(name)][0].tolist() for name in ("ahead_limit", "munk", "fin_share"))
    assert ahead == [0.0, pytest.approx(239.364)] and fins == [0.0, 1.0]
    assert munk == [0.0, pytest.approx(2 * load_vehicle("otter").munk(load_scenario("pool-behind").cruise))]
    assert munk[1] > 100.0


def test_mistakes_are_named() -> None:
    law = stand_in()
    with pytest.raises(InputError, match="smallest and largest"):
        Envelope(np.array([[1.0, 0.0]]), np.zeros((0, 2)), np.zeros((0, 2)))
    with pytest.raises(InputError, match="of an input that does not exist"):
        Envelope(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2)), (Rate(0, 1.0, 1.0),))
    with pytest.raises(InputError, match="is not a valid rate"):
        Rate(0, -1.0, 0.0)
    with pytest.raises(InputError, match="entries, but the law has"):
        replace(anywhere(law), state=np.zeros((1, 2))).fitted(law, "float64")


def test_a_refusal_by_range_in_python_keeps_the_state() -> None:
    law, bundle, flight = exported("float32")
    guarded = in_precision(law, "float32", bundle.envelope)
    assert isinstance(guarded, Guarded)
    u = flight.U[0].copy()
    u[0] = 5.0
    step = guarded.step(flight.X[0], u, flight.P[0])
    assert step.status == RANGE and not step.tau.any() and np.array_equal(step.x_next, flight.X[0].astype(np.float32))
    assert guarded.step(flight.X[0], flight.U[0], flight.P[0]).status >= 0


def test_a_step_fits_a_small_processor(tmp_path: Path) -> None:
    for tool in ("arm-none-eabi-gcc", "qemu-system-arm"):
        need(tool)
    law, bundle, flight = exported("float32")
    controller = build_controller(law, bundle, tmp_path / "b")
    report = check_builds(controller, [flight], [TARGETS["cortex-m4f-Os"]], steps=300)
    (build,) = report.builds
    assert report.passed and build.instructions is not None and build.runtime_bytes is not None
    assert build.instructions.most <= 1200 and build.instructions.most <= 1.10 * build.instructions.least
    assert build.runtime_bytes <= 4500


STRICT = ("-Wdouble-promotion", "-Wshadow", "-Wmissing-prototypes", "-Wstrict-prototypes")
LOOK_FOR = "--enable=warning,performance,portability"


def test_no_warnings_of_compilers_and_cppcheck(tmp_path: Path) -> None:
    """What the MISRA addon of cppcheck says is a check of `analysis/40_long_checks`."""
    need_compiler()
    cppcheck = need("cppcheck")
    for real in REALS:
        _, bundle, _ = exported(real)
        write_bundle(bundle, tmp_path / real)
        compile_controller(bundle, tmp_path / real, flags=STRICT)
    command = [cppcheck, LOOK_FOR, "--error-exitcode=1", "--quiet", *bundle.sources, bundle.selftest]
    done = subprocess.run(command, cwd=tmp_path / real, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_law_may_say_that_an_iteration_did_not_end(tmp_path: Path) -> None:
    need_compiler()
    law, bundle, flight = exported("float32")
    mutant = altered(bundle, r"\*status = (.*?);", r"*status = (\1) - 100.0f;")
    load = np.ones(len(flight), dtype=bool)
    told = build_controller(law, mutant, tmp_path / "b").run(flight, load=load)
    assert set(told.status) == {ITER} and not told.tau.any()
