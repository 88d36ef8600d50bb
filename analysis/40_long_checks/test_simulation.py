"""Simulation: the compiled loop is the reference loop, with sensors of other kinds than the suite's."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np

from surctl.control import load_gains
from surctl.sensing import Equipment, SonarArray
from surctl.simulation import Case, Sensors, load_scenario, simulate, simulate_batch
from surctl.vehicle import load_vehicle
from tests.tools import need_compiler

SLOW = SonarArray(azimuths=(0.0, pi), order=(1, 0), firing_period=0.05, beam_angle=1.0)


def test_two_sonars_that_fire_at_every_other_instant_and_true_positions() -> None:
    need_compiler()
    scenario = replace(load_scenario("tank-moving"), sensors=Sensors(Equipment(array=SLOW, own=None)), time_limit=7.0)
    case = Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"), sensing="sonar")
    run = simulate(scenario, case.vehicle, gains=case.gains, sensing="sonar", seed=5)
    np.testing.assert_allclose(simulate_batch(case, seeds=[5]).table[0], run.metrics.row(), rtol=0, atol=1e-9)
