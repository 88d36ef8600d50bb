"""The exported C of a law with allocation: its ports, and the same bytes as in Python, with failed thrusters too."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from surctl.export import Records, software_in_the_loop
from surctl.marine.control import build_law, load_gains
from surctl.marine.export import build_bundle, operating_envelope
from surctl.marine.simulation import ThrusterFault, law_numbers, load_scenario, simulate
from surctl.marine.vehicle import load_vehicle
from tests.tools import need_compiler


def test_the_c_allocates_as_python_does(tmp_path: Path) -> None:
    need_compiler()
    vehicle, gains = load_vehicle("bluerov2-thrusters"), load_gains("default")
    mission = replace(load_scenario("pool-behind"), time_limit=1.5)
    law = build_law("closed_form", actuators=vehicle.actuators)
    faults = [ThrusterFault("T1", start=0.5), ThrusterFault("T2", start=1.0)]
    record = simulate(mission, vehicle, gains=gains, law=law, thruster_faults=faults).record
    missed = np.abs(record.telemetry[:, law.telemetry_slice("tau_desired")] - record.tau).max(axis=1) > 1e-6
    assert missed.any() and not missed.all()
    report = software_in_the_loop(
        law, Records(record.law_state, record.law_input, record.law_parameters), workdir=tmp_path / "sil"
    )
    assert report.passed, report.summary()
    assert report.tau.mixed == report.state.mixed == 0.0


def test_the_header_names_the_thrusters() -> None:
    vehicle = load_vehicle("bluerov2-heavy")
    law, mission = build_law("closed_form", actuators=vehicle.actuators), load_scenario("pool-behind")
    p = law_numbers(mission, load_gains("default"), vehicle)
    within = operating_envelope(law, mission, vehicle, law.gains)
    assert within.inputs[law.inputs.slice("working")].tolist() == [[0.0, 1.0]] * 8
    header = build_bundle(law, law.gains.unpack(p), envelope=within).files["surctl_closed_form.h"]
    for line in ("working[8]", "tau_desired[4]", "thruster_force[8]", "thruster_command[8]", "T1, T2, T3"):
        assert line in header, line
