"""What the sensors of a run say is the same in the loop in NumPy and in the compiled one."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np

from surctl.marine.control import load_gains
from surctl.marine.sensing import BaseStation, Delivery, Equipment, Fault, FaultChances, OwnState, SonarArray
from surctl.marine.simulation import Case, Sensors, load_scenario, simulate_batch
from surctl.marine.simulation.batch.engines import Packed, compiled_loop, structure_of
from surctl.marine.simulation.batch.loop import build_loop
from surctl.marine.vehicle import load_vehicle
from tests.oracles.mission_loop import simulate as in_numpy
from tests.tools import need_compiler

MOUNTED = SonarArray(
    azimuths=tuple(np.arange(3) * 2 * pi / 3),
    order=(1, 0, 2),
    firing_period=0.025,
    mounts=((0.3, 0.0), (-0.1, 0.3), (-0.1, -0.3)),
    incidence_limit=0.4,
    temperature=8.0,
    calibrated_for=1480.0,
)
LATE = Equipment(
    station=BaseStation(messages=Delivery(loss=0.3)),
    own=OwnState(fixes=Delivery(loss=0.2, gaps=((1.5, 2.5),))),
)
BRIEF = ("stuck", "zero", "maximum", "second_echo", "crosstalk", "dropout")
# a loop is compiled for the sensors, so all features are in one set
SENSORS = Sensors(
    replace(LATE, array=MOUNTED),
    faults=(
        Fault(sensor=2, kind="delay", start_s=0.1, duration_s=0.7, delay_s=0.2),
        *(Fault(sensor=k % 3, kind=kind, start_s=0.3 + 0.3 * k, duration_s=0.4) for k, kind in enumerate(BRIEF)),
        Fault(sensor=1, kind="spike", start_s=2.6),
        Fault(sensor=0, kind="dead", start_s=2.7),
    ),
    chances=FaultChances(dropout=0.1, spike=0.05, zero=0.05, maximum=0.05, second_echo=0.05, crosstalk=0.05),
)
SCENARIO = replace(load_scenario("pool-behind"), sensors=SENSORS, time_limit=3.0)  # the obstacle approaches at once
CASE = Case(SCENARIO, load_vehicle(SCENARIO.vehicle), load_gains("default"), sensing="sonar")


def test_the_compiled_loop_hears_what_the_reference_hears() -> None:
    """Three sonars, two in a step, mounted beside the hull, late and lost messages, faults and chances.

    The state of the law depends on all that it has ever measured; the metrics hardly do within such a time.
    """
    need_compiler()
    run = in_numpy(SCENARIO, CASE.vehicle, gains=CASE.gains, law=CASE.build(), sensing="sonar", seed=5)
    loop = build_loop(structure_of(CASE, {}))
    packed = Packed(CASE, loop, {}, np.array([5, 6]))
    final = compiled_loop(loop.structure).run(packed.state, packed.parameters, steps=packed.steps - 1)
    states = final[:, loop.state.slice("law")]
    for port in loop.law.state:
        state = states[:, loop.law.state.slice(port.name)]
        reference = run.record.law_state[-1, run.law.state.slice(port.name)][: state.shape[1]]
        np.testing.assert_allclose(state[0], reference, rtol=0, atol=1e-9, err_msg=port.name)
    assert not np.allclose(states[0], states[1], atol=1e-6)


def test_chances_are_knobs() -> None:
    need_compiler()
    case = replace(CASE, scenario=replace(SCENARIO, sensors=replace(SENSORS, chances=FaultChances())))
    by_knob = simulate_batch(case, {"sonar.dropout": 0.4}, seeds=3).table
    sensors = replace(SENSORS, chances=FaultChances(dropout=0.4))
    by_file = replace(case, scenario=replace(SCENARIO, sensors=sensors))
    np.testing.assert_array_equal(by_knob, simulate_batch(by_file, seeds=3).table)
    assert not np.array_equal(by_knob, simulate_batch(case, {"sonar.dropout": 1e-9}, seeds=3).table)
