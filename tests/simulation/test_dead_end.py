"""Dead ends: the law says so by itself, stands, and the run ends with the reason; both loops alike."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from surctl.ir import Layout
from surctl.marine.control import TRAPPED, build_law, load_gains
from surctl.marine.control.dead_end import SEARCH_PORT
from surctl.marine.control.ports import law_parameters
from surctl.marine.guidance import Path
from surctl.marine.simulation import Case, Obstacle, Run, load_scenario, simulate
from surctl.marine.simulation.explanation import stop_reason
from surctl.marine.simulation.metrics import STANDSTILL
from surctl.marine.vehicle import load_vehicle


def _box(name: str, centre: tuple[float, float], size: tuple[float, float]) -> Obstacle:
    return Obstacle(name=name, shape="box", centre_m=centre, size_m=size)


SCENES = {
    "a U across the tank": (
        "tank-static",
        (
            _box("back", (5.0, 2.5), (0.3, 5.0)),
            _box("right", (3.9, 0.9), (1.8, 0.3)),
            _box("left", (3.9, 4.1), (1.8, 0.3)),
        ),
    ),
    "a gap narrower than the hull": (
        "tank-static",
        (_box("right", (5.0, 1.125), (0.3, 2.25)), _box("left", (5.0, 3.875), (0.3, 2.25))),
    ),
    "a box as wide as the pool": ("pool-static", (_box("wall", (1.6, 1.0), (0.3, 2.0)),)),
}


def _case(scene: str, **gains: float) -> Case:
    name, boxes = SCENES[scene]
    scenario = replace(load_scenario(name), obstacles=boxes, time_limit=240.0)
    return Case(scenario, load_vehicle(scenario.vehicle), load_gains("default").with_values({"patience": 5.0, **gains}))


@cache
def _run(scene: str) -> Run:
    case = _case(scene)
    return simulate(case.scenario, case.vehicle, gains=case.gains, law=case.build(), seed=1)


@pytest.mark.parametrize("scene", ["a U across the tank", "a box as wide as the pool"])
def test_a_dead_end_is_found_and_said_in_safety(scene: str) -> None:
    """By sonar, and in the other scene: study 40."""
    run = _run(scene)
    assert run.metrics.stopped_because == "dead end"
    assert run.metrics.min_clearance_m > 0
    trapped = run.telemetry("trapped").ravel() > 0.5
    assert np.all(np.diff(trapped.astype(int)) >= 0)  # for good
    assert np.array_equal(trapped, (run.record.status & TRAPPED) > 0)
    assert np.count_nonzero(trapped) == round(STANDSTILL / run.law.dt)
    assert np.hypot(*run.record.nu[-1, :2]) < 0.05
    assert np.linalg.norm(run.record.eta[-1, :2] - run.record.eta[trapped][0, :2]) < 0.15
    assert f"no progress for {run.gains['patience']:.0f} s, search ended at (" in stop_reason(run)


def test_a_search_that_reached_its_limit_is_the_reason() -> None:
    """As if the law had a search limit; the run itself, by sonar: study 40."""
    run = _run("a box as wide as the pool")
    law = replace(run.law, state=Layout((*run.law.state, SEARCH_PORT)))
    for searching, said in (
        (19.95, "no progress along the path for 20 s, search"),
        (3.0, "no progress for 5 s, search"),
    ):
        states = np.column_stack([run.record.law_state, np.full(len(run.record.time), searching)])
        sensors = run.scenario.sensors
        limited = replace(sensors, equipment=replace(sensors.equipment, search_limit=20.0))
        scenario = replace(run.scenario, sensors=limited)
        seen = replace(run, law=law, scenario=scenario, record=replace(run.record, law_state=states))
        assert stop_reason(seen).startswith(said)


def test_patience_0_never_gives_up() -> None:
    case = _case("a box as wide as the pool", patience=0.0)
    longer = replace(case.scenario, time_limit=_run("a box as wide as the pool").metrics.time_s + 10.0)
    run = simulate(longer, case.vehicle, gains=case.gains, law=case.build(), seed=1)
    assert run.metrics.stopped_because == "time limit"
    assert not np.any(run.telemetry("trapped"))


@pytest.mark.parametrize(("speed", "across"), [(0.04, 0.0), (0.15, 0.2)])
def test_it_gives_way_to_what_moves_while_it_stands(speed: float, across: float) -> None:
    """Given up in free water, it is met by a sphere: kinematic robot, 40 s, and back at its place in the end."""
    law, vehicle = build_law(), load_vehicle("sur400")
    p = law_parameters(
        load_gains("default"),
        vehicle,
        path=Path(np.array([[0.0, 0.0], [9.0, 0.0]])),
        depth=-0.15,
        cruise=0.2,
        cap=0.22,
        walls=(-9.0, 9.0, -9.0, 9.0),
    )
    x = law.state.pack({"progress": 2.0, "trapped": 1.0, "searched": (2.0, 2.0, 0.0, 0.0), "furthest": 2.0})
    place, least, most = np.array([2.0, 0.0]), np.inf, 0.0
    for k in range(round(40 / law.dt / min(1.0, speed / 0.1))):
        sphere = np.array([2.0 + 1.5 - speed * k * law.dt, across])
        contacts = np.zeros((8, 6))
        contacts[0] = [*sphere, 0.2, -speed, 0.0, 1.0]
        u = law.inputs.pack({"eta": [*place, -0.15, 0.0], "nu": np.zeros(4), "contacts": contacts})
        step = law.step(x, u, p)
        x, wanted = step.x_next, step.telemetry[law.telemetry_slice("nu_reference")][:2]
        place = place + law.dt * wanted
        least = min(least, float(np.linalg.norm(place - sphere)) - 0.2 - vehicle["radius"])
        most = max(most, float(np.linalg.norm(place - [2.0, 0.0])))
        assert step.status & TRAPPED
    assert least > 0
    assert most > 0.1
    assert np.linalg.norm(place - [2.0, 0.0]) < 0.1
