"""Engine: runs in processes of their own."""

from __future__ import annotations

from dataclasses import replace

from surctl.marine.control import load_gains
from surctl.marine.engine import BatchCase, mujoco_physics
from surctl.marine.engine.physics import simulate_seeds, simulate_with_steppers
from surctl.marine.export import CompiledLaw
from surctl.marine.simulation import Case, load_scenario
from tests.engine import test_closed_forms
from tests.engine.tools import load_vehicle
from tests.tools import need_compiler


def test_runs_in_other_processes_by_the_law_as_c_have_the_same_bytes() -> None:
    need_compiler()
    short = replace(load_scenario("pool-static"), time_limit=2.0)
    case = Case(short, load_vehicle("sur400-tilting"), load_gains("default"), "closed_form")
    by_c = simulate_with_steppers(BatchCase(case, mujoco_physics(), stepper=CompiledLaw), [3, 4], processes=2)
    apart, reports = zip(*by_c, strict=True)
    assert [(run.replaced, report.answered, report.differing) for run, report in zip(apart, reports, strict=True)] == [
        (True, 40, 0),
        (True, 40, 0),
    ]
    here = list(simulate_seeds(BatchCase(case, mujoco_physics()), [3, 4]))
    for one, other in zip(apart, here, strict=True):
        assert one.record.eta.tobytes() == other.record.eta.tobytes()
        assert one.record.law_input.tobytes() == other.record.law_input.tobytes()


def test_terminal_speeds() -> None:
    for dof in (4, 6):
        for axis in range(3):
            test_closed_forms.test_terminal_speed(dof, axis)
