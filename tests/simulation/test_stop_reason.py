"""A run that the law itself stands still in: both loops end it alike, and it is told why."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from surctl.marine.control import load_gains
from surctl.marine.sensing import Fault, FaultChances
from surctl.marine.simulation import METRICS, STOPS, Case, Run, load_scenario, simulate, simulate_batch
from surctl.marine.simulation.batch.loop import build_loop
from surctl.marine.simulation.batch.structure import Structure
from surctl.marine.simulation.explanation import stop_reason
from surctl.marine.simulation.metrics import STOPPED_LIMIT
from surctl.marine.simulation.sensors import Sensors
from surctl.marine.vehicle import load_vehicle
from surctl.marine.world import Prism
from tests.craft import mission
from tests.oracles import mission_loop

_SENSORS = range(4)
DEAF_TWICE = Sensors(
    faults=(
        *(Fault(sensor=i, kind="dropout", start_s=2.0, duration_s=STOPPED_LIMIT - 10) for i in _SENSORS),
        *(Fault(sensor=i, kind="dead", start_s=STOPPED_LIMIT - 5) for i in _SENSORS),
    ),
    chances=FaultChances(dropout=1e-9),  # the compiled loop of `test_closed_loop`
)
DEAF_AHEAD = Sensors(faults=(Fault(sensor=0, kind="dead"),))


def _case(sensors: Sensors, **gains: float) -> Case:
    scenario = replace(load_scenario("tank-static"), sensors=sensors)
    chosen = load_gains("default").with_values(gains)
    return Case(scenario, load_vehicle(scenario.vehicle), chosen, sensing="sonar")


@cache
def _flown(sensors: Sensors) -> Run:
    case = _case(sensors)
    return simulate(case.scenario, case.vehicle, gains=case.gains, law=case.build(), sensing="sonar", seed=1)


def _stopped(why: str) -> Run:
    run = _flown(DEAF_TWICE)
    return replace(run, metrics=replace(run.metrics, stopped_because=why))


def test_a_run_to_the_time_limit_says_where_the_craft_stays_and_what_lint_says() -> None:
    run = _stopped("time limit")
    x, y = run.record.eta[-1, :2]
    where = f"the hull has stayed within 0.05 m of ({x:.2f}, {y:.2f}) m since "
    assert stop_reason(run).startswith(where) and "fins" not in stop_reason(run) and "ilos" not in stop_reason(run)
    tide = run.scenario.disturbance.model_copy(update={"current_m_per_s": (0.0, 0.05)})
    drifting = replace(run, scenario=replace(run.scenario, disturbance=tide))
    assert stop_reason(drifting).endswith("give --guidance ilos, also to surctl export")
    # at the end of the path, no guidance law brings the hull nearer, but the integral gain does
    state = run.record.law_state.copy()
    state[-1, run.law.state.slice("progress")] = run.scenario.path.length
    there = replace(drifting, record=replace(run.record, law_state=state))
    assert stop_reason(there).endswith("beside the end of the path, unless the gain k_i is positive")
    assert "ilos" not in stop_reason(there)
    held = replace(there, gains=run.gains.with_values({"k_i": 0.3}))
    assert stop_reason(held).endswith("m from the end of the path")
    still = replace(run.record, eta=np.zeros_like(run.record.eta))
    assert stop_reason(replace(run, record=still)) == "the craft did not move"
    torpedo = load_vehicle("remus100")
    fast = mission([[30.0, 30.0], [60.0, 30.0]], "remus", size=(90, 90), time=200, cap_m_per_s=6.0, cruise_m_per_s=5.0)
    said = stop_reason(replace(run, vehicle=torpedo, scenario=fast)).split("; ")
    assert "at the cruise speed of 5 m/s remus100 moves at" in said[-1]
    short = replace(run.record, time=run.record.time[:100], eta=run.record.eta[:100])
    assert stop_reason(replace(run, record=short)) == ""


@pytest.mark.parametrize(
    ("furthest", "said"),
    [(0.5, "no progress along the path since 10 s, at 0.5 m of 9.0 m; until the end"), (-100.0, ""), (np.nan, "")],
)
def test_a_run_that_searches_until_the_time_limit_says_since_when_it_makes_no_progress(furthest, said):
    run = _stopped("time limit")
    record = replace(run.record, law_state=run.record.law_state.copy(), eta=run.record.eta.copy())
    record.law_state[200:, run.law.state.slice("furthest")] = furthest
    record.eta[:, 0] = np.linspace(0, 9, record.time.size)
    found = stop_reason(replace(run, record=record))
    assert found.startswith(said) and bool(said) == bool(found)


def test_a_halt_without_a_break_ends_the_run_and_a_shorter_one_does_not() -> None:
    run = _flown(DEAF_TWICE)
    assert run.metrics.stopped_because == "standstill" and not run.metrics.reached
    assert STOPPED_LIMIT - 5 + STOPPED_LIMIT < run.metrics.time_s < STOPPED_LIMIT - 5 + STOPPED_LIMIT + 1
    halted, ticks = run.telemetry("stopped")[:, 0], round(STOPPED_LIMIT / run.law.dt)
    assert np.all(halted[-ticks:] == 1) and halted[-ticks - 1] == 0
    assert np.all(halted[60:440] == 1), "the first spell"


def test_the_compiled_loop_halts_as_the_reference_does() -> None:
    found = simulate_batch(_case(DEAF_TWICE), seeds=[1])
    assert np.all(found.column("stopped") == STOPS.index("standstill"))
    wanted = _flown(DEAF_TWICE).metrics.row()
    for name, a, b in zip(METRICS, found.table[0], wanted, strict=True):
        assert a == b or abs(a - b) <= 1e-9 or (np.isnan(a) and np.isnan(b)), (name, a, b)


def test_only_a_law_with_senses_counts() -> None:
    truth = build_loop(Structure("guarded", "corrected", "nsb", "truth", ("disc",)))
    assert "stopped" not in truth.state
    assert "stopped" not in build_loop(Structure("paper", "corrected", "nsb", "sonar", ("disc",))).state
    assert "stopped" in build_loop(Structure("guarded", "corrected", "nsb", "sonar", ("disc",))).state


def test_the_reason_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    assert stop_reason(_flown(DEAF_TWICE)) == "all sonars are judged faulty (0, 1, 2, 3)"
    run = _flown(DEAF_TWICE)
    state, told = run.record.law_state.copy(), run.record.law_input.copy()
    state[-1], told[-1, run.law.inputs.slice("fix_fresh")] = run.law.initial_state(), 0.0
    lost = replace(run, record=replace(run.record, law_state=state, law_input=told))
    assert stop_reason(lost).startswith("the robot does not know its position")
    monkeypatch.setattr(mission_loop, "STOPPED_LIMIT", 1.0)  # it creeps on, and stands for moments only
    case = _case(DEAF_AHEAD, spin=0.0)
    options = {"gains": case.gains, "law": case.build(), "sensing": "sonar", "seed": 1}
    said = stop_reason(mission_loop.simulate(case.scenario, case.vehicle, **options))
    assert said.startswith("the water ahead stays unknown; sonar") and " 0 " in said and said.endswith(" judged faulty")


def test_a_run_that_ended_otherwise_has_no_such_reason() -> None:
    run = _flown(DEAF_TWICE)
    assert stop_reason(_stopped("reached")) == ""
    inputs = run.record.law_input.copy()
    inputs[-1, run.law.inputs.slice("yaw").start] = np.nan
    lost = replace(_stopped("fault"), record=replace(run.record, law_input=inputs))
    assert stop_reason(lost) == f"input yaw is not finite at {run.record.time[-1]:.2f} s"


def test_a_collision_names_what_the_hull_touches_and_since_when_it_makes_no_way() -> None:
    run, start = _stopped("collision"), np.zeros(4)
    bodies = run.record.obstacles[-1]
    start[:3] = *run.scenario.start, run.scenario.depth
    apart, nearest = min((Prism(body.shape, body.heights).distance(*start[:3]), body.name) for body in bodies)
    end = replace(run.record, eta=run.record.eta.copy())
    end.eta[-1] = start
    craft = load_vehicle("remus100")
    for radius, hit in ((apart + 0.001, nearest), (apart - 0.1, "a wall")):
        hull = replace(craft.parameters["radius"], value=radius)
        vehicle = replace(craft, parameters={**craft.parameters, "radius": hull})
        said = stop_reason(replace(run, record=end, vehicle=vehicle))
        assert said.startswith(f"the hull touches {hit} at ({start[0]:.2f}, {start[1]:.2f}) m")
    still = replace(end, eta=np.tile(start, (run.record.time.size, 1)))
    said = stop_reason(replace(run, record=still, vehicle=craft))
    assert said.endswith("since 0 s; its rudders or fins do not turn it at rest")
