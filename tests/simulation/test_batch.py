"""The compiled loop against the loop in NumPy, and what a batch must not depend on."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from surctl.errors import InputError, ToolMissing
from surctl.ir.native import SlowerEngine
from surctl.marine.control import Gains, load_gains
from surctl.marine.simulation import METRICS, STOPS, Case, Scenario, load_scenario, simulate_batch
from surctl.marine.simulation.batch import engines
from surctl.marine.simulation.batch.case import case_parameters
from surctl.marine.vehicle import load_vehicle
from tests.oracles.mission_loop import simulate as reference


def _case(name: str, *, seconds: float | None = None, **more: Any) -> Case:
    scenario = load_scenario(name)
    if seconds is not None:
        scenario = replace(scenario, time_limit=seconds)
    return Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"), **more)


def _reference(case: Case, seed: int = 0) -> np.ndarray[Any, Any]:
    run = reference(
        case.scenario,
        case.vehicle,
        gains=case.gains,
        law=case.build(),
        sensing=case.sensing,
        seed=seed,
        model=case.model,
    )
    return np.array(run.metrics.row())


def _same(found: np.ndarray[Any, Any], wanted: np.ndarray[Any, Any]) -> None:
    for name, a, b in zip(METRICS, found, wanted, strict=True):
        assert a == b or abs(a - b) <= 1e-9 or (np.isnan(a) and np.isnan(b)), (name, a, b)


@pytest.mark.parametrize(
    ("case", "seed"),
    [  # by sonar: test_listening; with legs: test_missions; law paper: campaign/test_replay; alone: study 40
        (_case("pool-static", seconds=15.0), 3),  # drift and waves
        (_case("pool-static", seconds=4.0, law="closed_form"), 0),  # of several obstacles the nearest one
        (_case("tank-speed-025", seconds=4.0), 0),
    ],
    ids=lambda x: x.name if isinstance(x, Case) else str(x),
)
def test_a_run_of_the_batch_is_the_reference_run(case: Case, seed: int) -> None:
    _same(simulate_batch(case, seeds=seed).table[0], _reference(case, seed))


def test_a_strong_error_of_the_thrust_is_the_same_in_both_loops() -> None:
    base = _case("pool-static", seconds=4.0)
    strong = {"thrust_error": 0.6, "thrust_bias": 0.2, "drift_force_n": 1.0, "drift_period_s": 5.0}
    case = _with_waves(base, **strong)
    found = simulate_batch(case, seeds=[3]).table[0]
    _same(found, _reference(case, 3))
    assert not np.allclose(found, simulate_batch(base, seeds=[3]).table[0], atol=1e-3, equal_nan=True)


def test_an_obstacle_left_out_is_as_one_that_never_was() -> None:
    """By sonar: `campaign/test_worlds`."""
    case = _case("tank-moving", seconds=40.0, law="closed_form")
    names = [o.name for o in case.scenario.obstacles]
    there = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 1.0]])
    values = {f"obstacle.{name}.there": there[:, k] for k, name in enumerate(names)}
    found = simulate_batch(case, values, seeds=5).table
    assert len({row.tobytes() for row in found}) > 1
    for row, flags in zip(found, there, strict=True):
        left = tuple(o for o, flag in zip(case.scenario.obstacles, flags, strict=True) if flag)
        wanted = _reference(replace(case, scenario=replace(case.scenario, obstacles=left)), 5)
        assert np.allclose(row, wanted, rtol=1e-9, atol=1e-9, equal_nan=True)


def test_casadis_machine_gives_the_same_runs() -> None:
    case = _case("pool-static", seconds=3.0)
    values = {"k_v": [1.0, 2.0, 3.0]}
    compiled = simulate_batch(case, values, seeds=[0, 1, 2], engine="c")
    machine = simulate_batch(case, values, seeds=[0, 1, 2], engine="vm")
    assert (compiled.engine, machine.engine) == ("c", "vm")
    assert np.allclose(compiled.table, machine.table, rtol=0, atol=1e-9, equal_nan=True)


def test_without_a_compiler_the_machine_flies_and_says_how_slow(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(_: object) -> None:
        raise ToolMissing("no C compiler found")

    monkeypatch.setattr(engines, "compiled_loop", none)
    case = _case("pool-static", seconds=1.0)
    with pytest.warns(SlowerEngine, match=r"no C compiler found; until then"):
        assert simulate_batch(case).engine == "vm"
    with pytest.raises(ToolMissing):
        simulate_batch(case, engine="c")


def test_a_run_depends_on_nothing_but_its_own_numbers() -> None:
    case, n = _case("pool-static", seconds=5.0), 24
    rng = np.random.default_rng(0)
    values = {"k_v": rng.uniform(0.5, 3, n), "lookahead": rng.uniform(0.2, 1.5, n)}
    seeds = rng.integers(0, 50, n)
    whole = simulate_batch(case, values, seeds=seeds).table.tobytes()
    assert simulate_batch(case, values, seeds=seeds, threads=3).table.tobytes() == whole
    order = rng.permutation(n)
    shuffled = simulate_batch(case, {k: v[order] for k, v in values.items()}, seeds=seeds[order], threads=2).table
    assert shuffled[np.argsort(order)].tobytes() == whole
    parts = [
        simulate_batch(case, {k: v[a : a + 7] for k, v in values.items()}, seeds=seeds[a : a + 7]).table
        for a in range(0, n, 7)
    ]
    assert np.vstack(parts).tobytes() == whole


@cache
def _pool() -> Case:
    return _case("pool-static", seconds=5.0)


def _edited(scenario: Scenario, name: str, **changes: Any) -> Scenario:
    obstacles = tuple(o.model_copy(update=changes) if o.name == name else o for o in scenario.obstacles)
    return replace(scenario, obstacles=obstacles)


def _with_gain(case: Case, name: str, value: float) -> Case:
    return replace(case, gains=case.gains.with_values({name: value}))


def _with_waves(case: Case, **changes: Any) -> Case:
    disturbance = case.scenario.disturbance.model_copy(update=changes)
    return replace(case, scenario=replace(case.scenario, disturbance=disturbance))


_POOL, _TANK = _pool(), _case("tank-speed-015", seconds=25.0)


@pytest.mark.parametrize(
    ("case", "name", "value", "changed"),
    [
        (_POOL, "k_v", 2.7, _with_gain(_POOL, "k_v", 2.7)),
        (_POOL, "vehicle.m11", 70.0, replace(_POOL, vehicle=_POOL.vehicle.with_values({"m11": 70.0}))),
        (
            _POOL,
            "plant.Xuu",
            90.0,
            replace(_POOL, vehicle=_POOL.vehicle.with_values({"Xuu": 90.0}), model=_POOL.vehicle),
        ),
        (_POOL, "plant.thrust_lag", 0.1, replace(_POOL, vehicle=_POOL.vehicle.with_values({"thrust_lag": 0.1}))),
        (_POOL, "vehicle.radius", 0.15, replace(_POOL, vehicle=_POOL.vehicle.with_values({"radius": 0.15}))),
        (_POOL, "scenario.cruise", 0.1, replace(_POOL, scenario=replace(_POOL.scenario, cruise=0.1))),
        (_POOL, "scenario.time_limit", 3.0, replace(_POOL, scenario=replace(_POOL.scenario, time_limit=3.0))),
        (_POOL, "scenario.wave_force", 0.6, _with_waves(_POOL, wave_force_n=0.6)),
        (_POOL, "scenario.wave_period", 2.0, _with_waves(_POOL, wave_period_s=2.0)),
        (_POOL, "scenario.drift_force", 0.4, _with_waves(_POOL, drift_force_n=0.4)),
        (_POOL, "scenario.drift_period", 9.0, _with_waves(_POOL, drift_period_s=9.0)),
        (_POOL, "scenario.thrust_error", 0.2, _with_waves(_POOL, thrust_error=0.2)),
        (_POOL, "scenario.thrust_bias", 0.1, _with_waves(_POOL, thrust_bias=0.1)),
        (_POOL, "scenario.current_y", 0.02, _with_waves(_POOL, current_m_per_s=(0.0, 0.02))),
        (
            _POOL,
            "obstacle.Obstacle1.drift",
            0.02,
            replace(_POOL, scenario=_edited(_POOL.scenario, "Obstacle1", drift_m=0.02)),
        ),
        (
            _POOL,
            "obstacle.Obstacle1.radius",
            0.08,
            replace(_POOL, scenario=_edited(_POOL.scenario, "Obstacle1", radius_m=0.08)),
        ),
        (_TANK, "obstacle.OM1.speed", 0.2, replace(_TANK, scenario=_edited(_TANK.scenario, "OM1", speed_m_per_s=0.2))),
        (_TANK, "obstacle.OM1.to_y", 1.0, replace(_TANK, scenario=_edited(_TANK.scenario, "OM1", to_m=(0.5, 1.0)))),
        (_TANK, "obstacle.OM1.radius", 0.4, replace(_TANK, scenario=_edited(_TANK.scenario, "OM1", radius_m=0.4))),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_a_knob_does_what_the_edited_case_does(case: Case, name: str, value: float, changed: Case) -> None:
    turned, plain = simulate_batch(case, {name: [value, case_parameters(case)[name].value]}, seeds=6).table
    assert turned.tobytes() == simulate_batch(changed, seeds=6).table[0].tobytes()
    assert plain.tobytes() == simulate_batch(case, seeds=6).table[0].tobytes()
    assert not np.array_equal(turned, plain, equal_nan=True)


def test_every_knob_is_admissible_as_it_stands() -> None:
    case = _case("tank-moving", seconds=0.1, law="closed_form")
    result = simulate_batch(case, {k: [v.value] for k, v in case_parameters(case).items()})
    assert np.array_equal(result.table, simulate_batch(case).table, equal_nan=True)


def test_a_start_inside_an_obstacle_is_a_collision_at_once() -> None:
    result = simulate_batch(_pool(), {"obstacle.Obstacle1.x": [0.25], "obstacle.Obstacle1.y": [0.25]})
    assert result.column("collided")[0] == 1.0
    assert result.column("time_s")[0] == 0.0
    assert STOPS[int(result.column("stopped")[0])] == "collision"


@pytest.mark.parametrize(
    ("values", "seeds", "said"),
    [
        ({"k_w": 1.0}, 0, r"k_w.*k_v|k_v"),
        ({"k_v": np.nan}, 0, "k_v"),
        ({"k_v": 0.0}, 0, "greater than 0"),
        ({"plant.m11": -1.0}, 0, "plant.m11"),
        ({"scenario.cruise": 0.5}, 0, "above scenario.cap"),
        ({"scenario.depth": 0.5}, 0, "scenario.depth"),
        ({"k_v": "fast"}, 0, "numbers"),
        ({"k_v": [1.0, 2.0], "k_r": [1.0, 2.0, 3.0]}, 0, "do not match"),
        ({"k_v": [[1.0, 2.0]]}, 0, "do not match"),
        ({}, -1, "seeds"),
        ({}, 0.5, "seeds"),
        ({"obstacle.Obstacle9.x": 1.0}, 0, "Obstacle"),
    ],
)
def test_a_mistake_is_named(values: dict[str, Any], seeds: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        simulate_batch(_pool(), values, seeds=seeds)


def test_a_batch_of_none_is_empty() -> None:
    assert simulate_batch(_pool(), {"k_v": []}).table.shape == (0, len(METRICS))


def test_gains_of_the_case_are_flown() -> None:
    other: Gains = load_gains("default").with_values({"lookahead": 1.4})
    turned = simulate_batch(_pool(), {"lookahead": 1.4}, seeds=1).table
    assert np.array_equal(turned, simulate_batch(replace(_pool(), gains=other), seeds=1).table, equal_nan=True)
