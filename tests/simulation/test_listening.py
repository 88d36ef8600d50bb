"""What the sensors of a run say is the same in the reference loop and in the compiled one."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np

from surctl.control import load_gains
from surctl.sensing import BaseStation, Delivery, Equipment, Fault, FaultChances, OwnState, SonarArray
from surctl.simulation import Case, Sensors, load_scenario, simulate, simulate_batch
from surctl.vehicle import load_vehicle
from tests.tools import need_compiler

MOUNTED = SonarArray(
    azimuths=tuple(np.arange(3) * 2 * pi / 3),
    order=(1, 0, 2),
    firing_period=0.025,
    mounts=((0.3, 0.0), (-0.1, 0.3), (-0.1, -0.3)),
    incidence_limit=0.6,
    temperature=8.0,
    calibrated_for=1480.0,
)
LATE = Equipment(
    station=BaseStation(messages=Delivery(loss=0.3)),
    own=OwnState(fixes=Delivery(loss=0.2, gaps=((1.5, 2.5),))),
)
KINDS = ("dead", "stuck", "zero", "maximum", "second_echo", "crosstalk", "dropout", "spike")
# a loop is compiled for the sensors, so all features are in one set
SENSORS = Sensors(
    replace(LATE, array=SonarArray()),
    faults=(
        Fault(sensor=2, kind="delay", start_s=0.2, delay_s=0.3),
        *(Fault(sensor=k % 3, kind=kind, start_s=0.5 + 0.3 * k) for k, kind in enumerate(KINDS)),
    ),
    chances=FaultChances(dropout=0.1, spike=0.05, zero=0.02, maximum=0.05, second_echo=0.05, crosstalk=0.05),
)


MOUNTED_SENSORS = replace(SENSORS, equipment=replace(LATE, array=MOUNTED))


def test_the_compiled_loop_hears_what_the_reference_hears(law: str = "paper", sensors: Sensors = SENSORS) -> None:
    """Two sonars in a step, late and lost messages, faults and chances; mounted beside the hull: study 40."""
    need_compiler()
    scenario = replace(load_scenario("tank-moving"), sensors=sensors, time_limit=10.0)
    case = Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"), law, sensing="sonar")
    run = simulate(scenario, case.vehicle, gains=case.gains, law=case.build(), sensing="sonar", seed=5)
    table = simulate_batch(case, seeds=[5, 6]).table
    np.testing.assert_allclose(table[0], run.metrics.row(), rtol=0, atol=1e-9)
    assert not np.allclose(table[0], table[1], atol=1e-6, equal_nan=True)


def test_chances_are_knobs() -> None:
    need_compiler()
    scenario = replace(load_scenario("pool-static"), time_limit=2.0)
    case = Case(scenario, load_vehicle("sur400"), load_gains("default"), sensing="sonar", law="paper")
    by_knob = simulate_batch(case, {"sonar.dropout": 0.4}, seeds=3).table
    by_file = replace(case, scenario=replace(scenario, sensors=Sensors(chances=FaultChances(dropout=0.4))))
    np.testing.assert_array_equal(by_knob, simulate_batch(by_file, seeds=3).table)
    assert not np.array_equal(by_knob, simulate_batch(case, {"sonar.dropout": 1e-9}, seeds=3).table)
