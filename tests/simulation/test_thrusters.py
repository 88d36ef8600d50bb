"""Runs of vehicles with thrusters: the compiled loop, failed thrusters, and laws without allocation."""

from __future__ import annotations

from dataclasses import replace

import pytest

from surctl.errors import InputError
from surctl.marine.control import build_law, load_gains
from surctl.marine.simulation import Run, ThrusterFault, load_scenario, simulate
from surctl.marine.simulation.thruster_faults import thruster_use
from surctl.marine.vehicle import load_vehicle

HEAVY = load_vehicle("bluerov2-heavy")


def _run(*faults: ThrusterFault, allocated: bool = True, seconds: float | None = None) -> Run:
    scenario = load_scenario("pool-behind")
    if seconds is not None:
        scenario = replace(scenario, time_limit=seconds)
    law = None if allocated else build_law()
    return simulate(scenario, HEAVY, gains=load_gains("default"), law=law, thruster_faults=faults)


def test_the_mission_is_reached_with_any_thruster_failed() -> None:
    assert thruster_use(_run(allocated=False, seconds=0.5)) is None
    for name in ("T1", "T6"):
        run = _run(ThrusterFault(name, start=1.0))
        assert run.metrics.reached, name
        use = thruster_use(run)
        assert use is not None and use.missed == 0.0 and "every command reached" in use.line()
        forces = run.telemetry("thruster_force")[:, int(name[1]) - 1]
        early = run.record.time < 1.0 - 1e-6
        assert (forces[~early] == 0.0).all()
        assert (forces[early] != 0.0).any() or name == "T6"


def test_a_repaired_thruster_pushes_again() -> None:
    run = _run(ThrusterFault("T1", start=0.0, duration=1.0), seconds=2.0)
    forces = run.telemetry("thruster_force")[:, 0]
    assert (forces[:20] == 0.0).all() and (forces[20:] != 0.0).any()


def test_the_plant_allocates_the_command_of_a_law_that_does_not() -> None:
    run = _run(ThrusterFault("T2"), seconds=1.0)
    other = _run(ThrusterFault("T2"), allocated=False, seconds=1.0)
    assert other.record.eta[-1] == pytest.approx(run.record.eta[-1], abs=1e-9)


def test_unknown_thrusters_and_those_of_another_vehicle_are_refused() -> None:
    with pytest.raises(InputError, match="no such thruster"):
        _run(ThrusterFault("T9"))
    scenario, gains = load_scenario("pool-behind"), load_gains("default")
    with pytest.raises(InputError, match="describes no thrusters"):
        simulate(scenario, load_vehicle("sur400"), gains=gains, thruster_faults=[ThrusterFault("T1")])
    with pytest.raises(InputError, match="has other thrusters than the law"):
        simulate(scenario, load_vehicle("sur400"), gains=gains, law=build_law(actuators=HEAVY.actuators))
