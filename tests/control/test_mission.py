"""A law that is fed a window of its mission commands what a law commands whose array holds the whole mission."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from surctl.ir import Layout
from surctl.marine.control import ARC_LENGTHS, FED, LAWS, Law, build_law, load_gains, ports
from surctl.marine.control.build import build_law_of
from surctl.marine.control.ports import PARAMETERS, law_parameters
from surctl.marine.guidance import BEND, PASS, VISIT, Path
from surctl.marine.simulation import Obstacle, Scenario, load_scenario, simulate
from surctl.marine.vehicle import load_vehicle
from surctl.system import ControllerStep
from tests.oracles.mission_loop import feeder_of

VEHICLE, GAINS = load_vehicle("sur400"), load_gains("default")
TURNS = np.linspace(0, 5 * np.pi, 40)
# a figure that crosses itself and ends near its start
POINTS = np.stack([3 + 2 * np.sin(TURNS), 2.5 + 1.2 * np.sin(2 * TURNS + 0.3)], axis=1)
KINDS = np.where(np.arange(40) % 9 == 4, VISIT, np.where(np.arange(40) % 2, PASS, BEND))
POST = Obstacle(name="post", shape="cylinder", centre_m=(4.6, 3.4), radius_m=0.1)


def _mission(path: Path, *, seconds: float) -> Scenario:
    site = load_scenario("tank-static")
    return replace(site, path=path, obstacles=(POST,), time_limit=seconds, cruise=0.2)


def _longer(monkeypatch: pytest.MonkeyPatch, name: str, rows: int) -> Law:
    """The same law with an array of `rows` waypoints."""
    longer = tuple(replace(p, shape=(rows, 2)) if p.name == "waypoints" else p for p in PARAMETERS)
    with monkeypatch.context() as patch:
        patch.setattr(ports, "PARAMETERS", Layout(longer))
        return build_law_of(LAWS[name])


@pytest.mark.parametrize("name", ["guarded"])
def test_its_commands_are_those_of_a_law_that_holds_the_whole_mission(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    speeds = np.where(np.arange(40) % 3, 0.0, 0.15)
    path = Path(POINTS, np.linspace(0, -0.4, 40), speeds, KINDS)
    scenario = _mission(path, seconds=36.0)
    law, whole = build_law(name), _longer(monkeypatch, name, len(POINTS))
    held: dict[str, Any] = {"x": whole.initial_state(), "steps": 0, "moves": 0, "window": None}

    def both(x: np.ndarray, u: np.ndarray, p: np.ndarray) -> ControllerStep:
        step = law.step(x, u, p)
        numbers = law.gains.unpack(p) | {"waypoints": POINTS}
        wanted = whole.step(held["x"], u, whole.gains.pack(numbers))
        assert np.allclose(step.tau, wanted.tau, rtol=0, atol=1e-9), held["steps"]
        assert step.status == wanted.status and np.allclose(step.telemetry, wanted.telemetry, atol=1e-9)
        for port in law.state:
            if port.name not in ARC_LENGTHS:
                here = law.state.slice(port.name)
                assert np.allclose(step.x_next[here], wanted.x_next[here], atol=1e-9), port.name
        held.update(x=wanted.x_next, steps=held["steps"] + 1)
        window = p[law.gains.slice("waypoints")].tobytes()
        held.update(window=window, moves=held["moves"] + (window != held["window"]))
        return step

    run = simulate(scenario, VEHICLE, gains=GAINS, law=law, stepper=both)
    assert held["steps"] == len(run.record.time) > 600 and held["moves"] > 4
    furthest = float(held["x"][whole.state.slice("progress")][0])
    assert furthest > 4.5 and run.telemetry("avoiding").any()


def test_a_mission_of_eight_points_is_not_fed() -> None:
    path = Path(POINTS[:8])
    scenario = _mission(path, seconds=10.0)
    law = build_law("closed_form")
    p = law_parameters(GAINS, VEHICLE, path=path, depth=-0.5, cruise=0.2, cap=0.22, walls=(0, 10, 0, 5))
    assert feeder_of(scenario, law, p) is None
    fed = replace(scenario, path=Path(POINTS[:8], speeds=np.zeros(8)))
    runs = [simulate(each, VEHICLE, gains=GAINS, law=law) for each in (scenario, fed)]
    assert runs[1].record.fed is not None and runs[0].record.fed is None
    for signal in ("eta", "nu", "tau", "law_state"):
        one, other = (getattr(run.record, signal) for run in runs)
        assert one.tobytes() == other.tobytes()
    assert all(np.array_equal(row, runs[0].record.law_parameters) for row in runs[1].record.fed)


def test_only_what_is_fed_changes() -> None:
    law = build_law("closed_form")
    scenario = _mission(Path(POINTS, kinds=np.zeros(40)), seconds=10.0)
    p = law.gains.pack({"waypoints": scenario.path.slots, "depth": -0.5, "cruise": 0.2, "visit": 0.05})
    feeder = feeder_of(scenario, law, p)
    assert feeder is not None
    x = law.state.pack({"progress": 2.5})
    for _ in range(5):
        before = x
        x, fed = feeder.feed(x)
    changed = {
        port.name
        for port in law.gains
        if not np.array_equal(fed[law.gains.slice(port.name)], p[law.gains.slice(port.name)])
    }
    assert changed == {"waypoints", "visit"} <= set(FED) and np.array_equal(x, before)
