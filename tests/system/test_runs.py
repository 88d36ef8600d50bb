"""The compiled batch, the recorded run and an independent integration give the same runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from surctl.errors import InputError
from surctl.ir import Layout, Port
from surctl.system import Controller, Plant, System, every_combination, run_system, simulate_system
from tests.system.examples import COSTS, LIMIT, level, pendulum
from tests.tools import need_compiler

VALUES = ({"start.angle": 0.4}, {"start.angle": 0.2, "disturbance.gust": 0.3}, {"start.angle": 1.3}, {"k_rate": 1.0})


def test_the_batch_gives_the_figures_of_the_recorded_runs() -> None:
    need_compiler()
    system = pendulum()
    names = sorted({name for values in VALUES for name in values})
    defaults = {"start.angle": 0.4, "disturbance.gust": 0.0, "k_rate": 6.2}
    columns = {name: [values.get(name, defaults[name]) for values in VALUES] for name in names}
    runs, machine = (simulate_system(system, 4.0, columns, threads=2, engine=engine) for engine in ("auto", "vm"))
    assert runs.stopped.tolist()[:3] == ["time", "time", "fallen"] and np.array_equal(machine.stopped, runs.stopped)
    assert np.allclose(machine.state, runs.state, rtol=1e-12, atol=1e-12)
    for k, values in enumerate(VALUES):
        record = run_system(system, 4.0, values)
        assert record.stopped == runs.stopped[k]
        for name in COSTS:
            assert runs[name][k] == pytest.approx(record.figures[name], rel=1e-9, abs=1e-12), (k, name)


def test_an_independent_integration_goes_the_same_way() -> None:
    record = run_system(replace(pendulum(), substeps=10), 3.0, {"disturbance.gust": 0.2})
    x = np.array([0.4, 0.0])
    for angle, rate in zip(record["angle"][:, 0], record["rate"][:, 0], strict=True):
        assert np.abs(x - [angle, rate]).max() < 1e-9
        torque = float(np.clip(-19.7 * x[0] - 6.2 * x[1], -LIMIT, LIMIT))

        def pendulum_rate(_: float, y: np.ndarray, torque: float = torque) -> list[float]:
            return [y[1], 9.81 * np.sin(y[0]) - 0.1 * y[1] + torque + 0.2]

        x = solve_ivp(pendulum_rate, (0.0, 0.01), x, rtol=1e-12, atol=1e-13).y[:, -1]


def test_references_and_disturbances_may_depend_on_time() -> None:
    need_compiler()
    system = replace(
        level(),
        reference=lambda t, r: {"target": ca.if_else(t < 5, 0, r["target"])},
        disturbance=lambda t, d: {"rain": d["rain"] * ca.sin(t)},
    )
    values = {"reference.target": 2.0, "disturbance.rain": 0.1}
    record, runs = run_system(system, 40.0, values), simulate_system(system, 40.0, values)
    assert np.all(record["target"][:50] == 0) and np.all(record["target"][51:] == 2)
    assert runs["error"][0] == pytest.approx(record.figures["error"], abs=1e-12) and abs(runs["error"][0]) < 0.2
    still = run_system(level(), 60.0, {"disturbance.rain": 0.1})
    assert abs(still["height"][-1, 0] - 1.0) < 1e-6  # the integral carries the rain


def test_what_is_no_longer_finite_ends_the_run_where_it_happens() -> None:
    need_compiler()
    position, force = Port("x", (1,), "m", "", 1.0), Port("force", (1,), "m/s", "")
    root = Plant("root", Layout((position,)), Layout((force,)), lambda x, f, d, p: -ca.sqrt(x["x"] - 0.5) - 0.1)
    idle = Controller("idle", 0.1, Layout((position,)), Layout((force,)), lambda x, u, p: 0 * u["x"])
    system = System(root, idle, costs={"low": replace(COSTS["least"], of=lambda s: s.x["x"])})
    record, runs = run_system(system, 10.0), simulate_system(system, 10.0)
    assert record.stopped == runs.stopped[0] == "not finite"
    assert 0.3 < runs.time[0] < 2.0 and runs.time[0] == pytest.approx(record.time[-1])
    assert np.isnan(runs["low"][0]) and np.isnan(record.figures["low"]) and np.isfinite(runs.state).all()
    where, cause = record.lost.split(", because of ")
    assert where == f"state x at {record.time[-1] + 0.1:.6g} s" and run_system(system, 0.1).lost == ""
    assert cause.startswith("sqrt(-0.000") and cause.endswith(") of the plant")


@pytest.mark.parametrize(
    ("law", "at", "lost"),
    [
        (
            lambda u: [u["q"][0], ca.sqrt(0.35 - u["t"])],
            lambda t: t,
            "command u[1] at 0.4 s, because of sqrt(-0.05) of the law",
        ),
        (lambda u: [0, 0], lambda t: ca.sqrt(0.35 - t), "input t at 0.4 s"),
        (lambda u: [1e200, 1e200], lambda t: 1.0, "cost square at 0.1 s"),
        (lambda u: [0, 1e300], lambda t: 1.0, "command u[1] at 0 s"),
    ],
)
def test_the_number_that_is_not_finite_is_named(law: Any, at: Any, lost: str) -> None:
    pair, push, clock = Port("q", (2,), "m", ""), Port("u", (2,), "m/s", ""), Port("t", (1,), "s", "")
    plant = Plant("pair", Layout((pair,)), Layout((push,)), lambda x, f, d, p: {"q": f["u"]})
    control = Controller("push", 0.1, Layout((pair, clock)), Layout((push,)), lambda x, u, p: ca.vertcat(*law(u)))
    cost = replace(COSTS["end"], of=lambda s: s.x["q"][1] ** 2)
    system = System(plant, control, costs={"square": cost}, reference=lambda t, r: {"t": at(t)})
    assert run_system(system, 1.0).lost == lost


def test_a_run_that_is_stopped_counts_no_period_after_the_stop() -> None:
    need_compiler()
    system = replace(pendulum(), stops={"late": lambda s: s.t > 0.025, "tilted": lambda s: s.x["angle"] > 1})
    angles = {"start.angle": [0.4, 1.1]}
    runs = simulate_system(system, 4.0, angles)
    records = [run_system(system, 4.0, {"start.angle": angle}) for angle in angles["start.angle"]]
    assert runs.stopped.tolist() == ["late", "tilted"] and runs.time.tolist() == [0.03, 0.0]
    torque = np.asarray(records[0]["torque"])
    assert records[0].figures["energy"] == pytest.approx(0.01 * np.sum(torque[:3] ** 2), rel=1e-12)
    assert runs["energy"][0] == pytest.approx(records[0].figures["energy"], rel=1e-12)
    for name in COSTS:
        assert np.isnan(runs[name][1]) and np.isnan(records[1].figures[name]) and not np.isnan(runs[name][0])


def test_a_recorded_run_ends_at_a_stop_that_holds_at_one_instant_only() -> None:
    for instants in (3, 700):  # CasADi computes at most 500 periods at once
        system = replace(pendulum(), stops={"here": lambda s, t=instants * 0.01: ca.fabs(s.t - t) < 1e-6})
        record = run_system(system, 20.0)
        assert record.stopped == "here" and len(record.time) == instants + 1
        whole = run_system(pendulum(), 20.0)
        for name in ("angle", "rate", "torque"):
            np.testing.assert_array_equal(record[name], whole[name][: instants + 1])
        z, u, gains = whole.controller
        steps = [whole.system.controller.step(z[k], u[k], gains) for k in range(instants)]
        np.testing.assert_array_equal(whole["torque"][:instants, 0], [step.tau[0] for step in steps])


def test_every_combination_is_one_run() -> None:
    runs = every_combination({"k": [1, 2], "q": [[5, 6]]}, {"start.x": [0.1, 0.2, 0.3], "plant.m": 3.0})
    assert runs["k"].tolist() == [1, 1, 1, 2, 2, 2] and runs["start.x"].tolist() == [0.1, 0.2, 0.3] * 2
    assert runs["q"].tolist() == [[5, 6]] * 6 and runs["plant.m"].shape == ()
    with pytest.raises(InputError, match="q: is in two groups"):
        every_combination({"q": 1}, {"q": 2})
    with pytest.raises(InputError, match="q: has 2 rows, others 3"):
        every_combination({"q": [1, 2], "k": [1, 2, 3]})


def test_twelve_states_with_twelve_inputs() -> None:
    need_compiler()
    state, push = Port("q", (4, 3), "m", "", 1.0), Port("u", (4, 3), "m/s", "")
    plant = Plant("grid", Layout((state,)), Layout((push,)), lambda x, f, d, p: {"q": f["u"] - x["q"] ** 3})
    law = Controller("back", 0.05, Layout((state,)), Layout((push,)), lambda x, u, p: -u["q"])
    system = System(plant, law)
    start = np.random.default_rng(0).normal(size=(3, 12))
    runs = simulate_system(system, 1.0, {"start.q": start})
    for k in range(3):
        record = run_system(system, 1.05, {"start.q": start[[k]]})
        assert np.abs(record["q"][-1] - runs.state[k]).max() < 1e-12


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({"k_angel": 1.0}, r"k_angel: no such number of the system; did you mean 'k_angle'"),
        ({"plant.mass": 1.0}, r"plant\.mass: no such number"),
        ({"k_angle[1]": 1.0}, r"k_angle\[1\]: has 1 entries; count from 0 to 0"),
        ({"k_angle": np.nan}, r"k_angle: is not finite"),
        ({"k_angle": [1.0, 2.0], "k_rate": [1.0, 2.0, 3.0]}, r"k_rate: is for 3 runs, others for 2"),
        ({"k_angle": []}, r"k_angle: is empty"),
        ({"start.angle": np.ones((2, 3))}, r"start\.angle: has shape \(2, 3\)"),
    ],
)
def test_mistakes_in_values_are_named(values: dict[str, object], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        simulate_system(pendulum(), 1.0, values)  # type: ignore[arg-type]


def test_a_flat_vector_for_a_port_of_several_entries_is_refused() -> None:
    pair = Port("q", (2,), "m", "place", 1.0)
    still = Plant(
        "still", Layout((pair,)), Layout((Port("f", (1,), "m/s", "moves both"),)), lambda x, f, d, p: 0 * x["q"]
    )
    loop = System(
        still, Controller("none", 0.1, Layout((pair,)), Layout((Port("f", (1,), "m/s", ""),)), lambda x, u, p: 0)
    )
    with pytest.raises(
        InputError,
        match=r"start\.q: has 2 numbers, which are either one run or one number for each run; give shape \(1, 2\)",
    ):
        simulate_system(loop, 0.2, {"start.q": [1.0, 2.0]})
    assert simulate_system(loop, 0.2, {"start.q": [[1.0, 2.0]]}).state.tolist() == [[1.0, 2.0]]


def test_no_time_and_unknown_figures_are_named() -> None:
    with pytest.raises(InputError, match=r"seconds = 0: is not a duration"):
        run_system(pendulum(), 0)
    with pytest.raises(InputError, match=r"no such signal or figure; did you mean 'torque'"):
        run_system(pendulum(), 0.1)["torqe"]


def test_a_gain_whose_default_is_an_integer_takes_other_numbers() -> None:
    assert Layout((Port("gain", (1,), "1/s", "", 6),)).pack({"gain": 6.7}).tolist() == [6.7]
