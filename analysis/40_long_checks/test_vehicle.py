"""Vehicles: fits from a start that is far too light, of more logs, and the C code of a vehicle with fins."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surctl.export import Records, software_in_the_loop
from surctl.marine.control import build_law, load_gains
from surctl.marine.simulation import Case, load_scenario, simulate, simulate_batch
from surctl.marine.vehicle import identify
from surctl.marine.vehicle.identification.identify import held_out_windows
from tests.cli.process import surctl
from tests.tools import need_compiler
from tests.vehicle import test_identify, test_identify_tilt, test_plant, test_terms
from tests.vehicle.test_fins import GAINS, REMUS, turning
from tests.vehicle.test_identify import START, TRUE, made_log
from tests.vehicle.test_identify_robust import MASSES, made
from tests.vehicle.test_identify_tilt import TILT, boat
from tests.vehicle.test_real_logs import depths, diver
from tests.vehicle.test_terms import COUPLED


@pytest.mark.parametrize("factor", [5.0, 0.2])
def test_a_start_vehicle_that_is_off_by_a_factor_of_five(factor: float) -> None:
    free = replace(START, parameters={k: replace(p, range=None) for k, p in START.parameters.items()})
    far = free.with_values({k: factor * TRUE[k] for k in (*MASSES, "Xuu", "Yvv", "Zww", "Nrr", "thrust_lag")})
    near, found = identify(made(), START, name="near"), identify(made(), far, name="far")
    for name in (*MASSES, "thrust_lag"):
        assert found.estimates[name][0] == pytest.approx(near.estimates[name][0], abs=0.2 * near.estimates[name][1])


def test_what_was_not_moved_is_not_told() -> None:
    for seed in (1, 9):
        test_identify.test_what_was_not_moved_is_not_told(seed)


def test_the_exported_c_of_a_vehicle_with_fins_gives_the_same_bytes(tmp_path: Path) -> None:
    need_compiler()
    record = simulate(turning(20.0), REMUS, gains=GAINS).record
    law = build_law("steered", actuators=REMUS.actuators)
    records = Records(record.law_state, record.law_input, record.law_parameters)
    report = software_in_the_loop(law, records, workdir=tmp_path / "sil")
    assert report.passed and report.tau.mixed == report.state.mixed == 0.0


def test_a_drift_that_predicts_nothing_is_not_fitted() -> None:
    """A beat, as of a tail, makes residuals slow too. A drifting force explains a part of it, and nothing unseen."""
    beat = np.sin(2.0 * np.pi * 0.1 * np.arange(400) / 6.0)[:, None] * np.array([0.8, 0.8, 0.0, 0.05])
    found = identify(made_log(TRUE, seed=1, rows=400, drift=beat), START, name="fitted")
    assert found.sections == 1 and not any("the constant force drifts" in note for note in found.notes)
    assert any("a constant force that drifts was tried and not used" in note for note in found.notes)


def test_a_free_oscillation_shows_only_ratios() -> None:
    """Without thrust, moments of inertia, drag and distance of the centres have a common factor that nothing shows."""
    values = {k: v for k, v in TILT.items() if k in ("mpp", "mqq", "weight", "buoyancy", "zg", "Kp", "Mq")}
    log = test_identify_tilt.made_log(
        boat(values | {"buoyancy": TILT["weight"]}), seed=2, rows=100, push=0.0, tilt=(0.4, -0.3)
    )
    found = identify(log, boat(values | {"mpp": 0.4, "zg": -0.05}), name="fitted")
    assert not {"mpp", "mqq", "zg", "Kp"} & set(found.identified)
    said = " ".join(found.directions)
    assert "surge: no motion above the noise" in said
    assert any({"+mpp", "+mqq", "+zg", "+Kp", "+Mq"} <= set(text.split()) for text in found.directions), said


def test_an_axis_at_rest_by_its_depth_alone_is_still_at_rest() -> None:
    log = depths(0)
    motion = np.full((240, 8), np.nan)
    motion[:, 2] = np.random.default_rng(3).normal(0, 0.05, 240)
    found = identify(replace(log, motion=motion), diver(), name="fitted")
    assert "m33" not in found.identified and any("heave: no motion above" in text for text in found.directions)


@pytest.mark.parametrize("name", test_plant.ALL)
def test_steady_speeds(name: str) -> None:
    for axis in range(4):
        test_plant.test_steady_speeds(name, axis)


def test_several_logs_and_windows_by_the_command_line(tmp_path: Path) -> None:
    names = []
    for seed in (0, 1):
        log = depths(seed)
        names.append(f"dive{seed}.csv")
        rows = [f"{t},{z},0,0,{f},0" for t, z, f in zip(log.time, log.motion[:, 2], log.thrust[:, 2], strict=True)]
        (tmp_path / names[-1]).write_text("\n".join(["t_s,z_m,Fu_N,Fv_N,Fw_N,Fr_N_m", *rows[:120]]))
    words = ["vehicle", "from-log", *names, "--start", "sur540-flooded", "--window", "5", "--window", "20", "--json"]
    done = surctl(*words, cwd=tmp_path)
    result = json.loads(done.out)
    assert [one["window_s"] for one in result["held_out_windows"]] == [5.0, 20.0] and result["sections"] == 4
    assert result["held_out"] == result["held_out_windows"][0]
    done = surctl("vehicle", "from-log", *names, "--topics", cwd=tmp_path)
    assert done.status == 2 and "--topics takes one log" in done.err


def test_roll_is_predicted_in_a_part_that_was_held_out() -> None:
    log = test_identify_tilt.made_log(test_identify_tilt.TRUE, seed=2)
    [later] = held_out_windows(log, test_identify_tilt.START, [5.0])
    assert later.model["roll_rad"] < 0.3 * later.hold["roll_rad"]


def test_the_compiled_loop_flies_a_coupled_vehicle_like_the_reference_loop() -> None:
    vehicle = test_terms.boat({**COUPLED, "Y0": 0.05, "Z0": -0.05, "Fu_reverse": 20.0})
    scenario = replace(load_scenario("tank-speed-015"), time_limit=6.0)
    case = Case(scenario, vehicle, load_gains("default"), law="closed_form")
    run = simulate(scenario, vehicle, gains=case.gains, law=case.build(), seed=0)
    table = simulate_batch(case, {"plant.m24": np.array([1.0, 0.0])}, seeds=[0, 0])
    assert table.column("min_clearance_m")[0] == pytest.approx(run.metrics.min_clearance_m, abs=1e-9)
    assert table.column("deviation_m")[0] == pytest.approx(run.metrics.deviation_m, abs=1e-9)
    assert abs(table.column("deviation_m")[1] - table.column("deviation_m")[0]) > 1e-6
