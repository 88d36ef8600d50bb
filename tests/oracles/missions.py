"""Missions of every kind, and the largest difference of one run of them between the product and the NumPy loop."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from surctl.marine.control import load_gains
from surctl.marine.sensing import Fault, FaultChances
from surctl.marine.simulation import Run, Scenario, ThrusterFault, load_scenario, simulate
from surctl.marine.vehicle import Vehicle, load_vehicle
from tests.oracles.mission_loop import simulate as reference

__all__ = ["KINDS", "difference", "mission"]

KINDS = ("truth", "sonar", "faults", "smooth", "depths", "thrusters")
_THRUSTED = {"pool": "bluerov2-heavy", "tank": "bluerov2-thrusters"}


def mission(name: str, kind: str, *, seconds: float) -> tuple[Scenario, Vehicle, dict[str, Any]]:
    """Return a library scenario as a mission of a kind that ends after some seconds, its vehicle, and the options."""
    scenario = replace(load_scenario(name), time_limit=seconds)
    vehicle, options = load_vehicle(scenario.vehicle), dict[str, Any]()
    if kind in ("sonar", "faults", "smooth"):
        options["sensing"] = "sonar"
    if kind == "faults":
        listed = [Fault(sensor=0, kind="delay", start_s=1.0, delay_s=0.3), Fault(sensor=2, kind="stuck", start_s=0.5)]
        chances = FaultChances(dropout=0.05, zero=0.02, spike=0.05, second_echo=0.05, crosstalk=0.05)
        scenario = replace(scenario, sensors=replace(scenario.sensors, faults=tuple(listed), chances=chances))
    if kind == "smooth":
        scenario = replace(scenario, sensors=scenario.sensors.hearing("specular"))
    if kind == "depths":
        scenario = replace(scenario, depths=(-scenario.site[2], 0.0))
    if kind == "thrusters":
        vehicle = load_vehicle(_THRUSTED[name.split("-")[0]])
        failed = ThrusterFault(vehicle.actuators.thrusters[1].name, start=1.0, duration=2.0)  # type: ignore[union-attr]
        options["thruster_faults"] = [failed]
    return scenario, vehicle, options


_RECORDED = ("time", "eta", "nu", "tau", "clearance", "law_state", "telemetry", "status")


def difference(scenario: Scenario, vehicle: Vehicle, *, seed: int = 0, **options: Any) -> float:
    """Return the largest difference of a run's record and metrics between the two loops, relative above 1."""
    options = {"gains": load_gains("default"), "seed": seed, **options}
    here, there = (f(scenario, vehicle, **options) for f in (simulate, reference))
    assert here.metrics.stopped_because == there.metrics.stopped_because
    pairs = [(getattr(here.record, name), getattr(there.record, name)) for name in _RECORDED]
    pairs += [
        (np.array(here.metrics.row()), np.array(there.metrics.row())),
        (_told(here), _told(there)),
        (here.record.step_parameters, there.record.step_parameters),
    ]
    worst = 0.0
    for one, other in pairs:
        np.testing.assert_array_equal(np.isfinite(one), np.isfinite(other))
        some = np.isfinite(one)
        apart = np.abs(one[some] - other[some]) / np.maximum(1.0, np.abs(other[some]))
        worst = max(worst, float(apart.max(initial=0.0)))
    return worst


def _told(run: Run) -> np.ndarray:
    # with the contacts sorted: one that has left the water leaves its slot empty in one of the loops only
    told, inputs = run.record.law_input.copy(), run.law.inputs
    if "contacts" in inputs:
        rows = told[:, inputs.slice("contacts")].reshape(len(told), -1, 6)
        order = np.argsort(rows[:, :, 5] < 0.5, axis=1, kind="stable")
        told[:, inputs.slice("contacts")] = np.take_along_axis(rows, order[:, :, None], axis=1).reshape(len(told), -1)
    return told
