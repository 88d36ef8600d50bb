"""Equilibria and the linear loop: against differences, python-control and the poles of the loop itself."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from surctl.assessment import ClosedLoop, assess
from surctl.errors import InputError
from surctl.ir import Layout, Port
from surctl.system import (
    Controller,
    Plant,
    System,
    find_equilibrium,
    from_control,
    linearise,
    linearise_plant,
    run_system,
)  # fmt: skip
from surctl.system.linear_loop import LinearLoop, LoopNames
from tests.system.examples import level, pendulum, pendulum_plant


def test_an_equilibrium_is_where_a_long_run_ends() -> None:
    values = {"disturbance.gust": 0.3, "start.angle": 0.1}
    point = find_equilibrium(pendulum(), values)
    record = run_system(pendulum(), 20.0, values)
    assert point.x == pytest.approx([record["angle"][-1, 0], 0.0], abs=1e-9)
    assert point.f == pytest.approx(record["torque"][-1], abs=1e-9)
    rain = find_equilibrium(level(), {"disturbance.rain": 0.05})
    assert rain.x == pytest.approx([1.0]) and rain.z == pytest.approx([(0.2 - 0.05) / 0.3])


def test_where_nothing_rests_the_moving_state_is_named() -> None:
    with pytest.raises(InputError, match=r"pendulum: no equilibrium was found: `(angle|rate)` still moves"):
        find_equilibrium(pendulum(), {"disturbance.gust": 40.0})


def test_the_search_leaves_a_saturated_start() -> None:
    place, speed, force = Port("x", (1,), "m", "", 10.0), Port("v", (1,), "m/s", ""), Port("f", (1,), "m/s^2", "")
    cart = Plant("cart", Layout((place, speed)), Layout((force,)), lambda x, f, d, p: {"x": x["v"], "v": f["f"]})

    def loop(goal: float) -> System:
        law = Controller(
            "pd", 0.05, Layout((place, speed)), Layout((force,)),
            lambda x, u, p: ca.fmax(-1, ca.fmin(1, 2 * (goal - u["x"]) - 3 * u["v"])),
        )  # fmt: skip
        return System(cart, law)

    assert find_equilibrium(loop(50.0)).x == pytest.approx([50.0, 0.0])
    with pytest.raises(InputError, match=r"`v` still moves, and command `f` does not depend on the state there"):
        find_equilibrium(loop(1e7))


def test_the_search_begins_in_the_box_where_zero_and_the_default_state_do_not_lead_to_an_equilibrium() -> None:
    gap, speed, pull = Port("gap", (1,), "m", "of air"), Port("speed", (1,), "m/s", ""), Port("pull", (1,), "A", "")
    magnet = Plant(
        "magnet", Layout((gap, speed)), Layout((pull,)),
        lambda x, f, d, p: {"gap": x["speed"], "speed": 9.81 - 1e-4 * (f["pull"] / x["gap"]) ** 2},
    )  # fmt: skip
    law = Controller(
        "hold", 0.001, Layout((gap, speed)), Layout((pull,)),
        lambda x, u, p: 0.01 * (9.81 / 1e-4) ** 0.5 + 800 * (u["gap"] - 0.01) + 20 * u["speed"],
    )  # fmt: skip
    with pytest.raises(InputError, match=r"begin near the equilibrium: start.gap=…"):
        find_equilibrium(System(magnet, law))
    assert find_equilibrium(System(magnet, law, within={"gap": (0.008, 0.013)})).x == pytest.approx([0.01, 0.0])


@given(exponent=st.integers(-20, 6), size=st.floats(-12, 6))
def test_slow_and_small_states_rest_at_their_equilibrium(exponent: int, size: float) -> None:
    speed, other, force = Port("v", (1,), "m/s", ""), Port("other", (1,), "K", ""), Port("f", (1,), "m/s^2", "")
    goal, rate = 3.0 * 10.0**size, 10.0**exponent
    plant = Plant(
        "boat", Layout((speed, other)), Layout((force,)),
        lambda x, f, d, p: {"v": f["f"] - x["v"], "other": rate * (goal - x["other"])},
    )  # fmt: skip
    law = Controller("hold", 0.1, Layout((speed,)), Layout((force,)), lambda x, u, p: -u["v"])
    assert find_equilibrium(System(plant, law)).x == pytest.approx([0.0, goal])


def test_a_state_that_rests_at_zero_is_zero_and_not_the_rest_of_a_search() -> None:
    turn, speed, torque = (
        Port("turn", (1,), "rad", ""),
        Port("speed", (1,), "rad/s", ""),
        Port("torque", (1,), "1/s^2", ""),
    )
    arm = Plant(
        "arm", Layout((turn, speed)), Layout((torque,)),
        lambda x, f, d, p: {"turn": x["speed"] + 0.1 * x["speed"] ** 3, "speed": ca.sin(x["turn"]) + f["torque"]},
    )  # fmt: skip
    law = Controller(
        "pd", 0.01, Layout((turn, speed)), Layout((torque,)),
        lambda x, u, p: 40 * (0.3 - u["turn"]) - 8 * u["speed"] + 5 * ca.cos(u["turn"]),
    )  # fmt: skip
    point = find_equilibrium(System(arm, law)).x
    assert point[0] == pytest.approx(0.42421053) and point[1] == 0.0


@pytest.mark.parametrize(("pole", "long"), [(0.6, False), (25.0, False), (100.0, True), (112.0, True)])
def test_a_mode_too_fast_for_the_integration_step_is_named(pole: float, long: bool) -> None:
    lag = control.tf([pole], [1.0, pole], name="lag", inputs="u", outputs="y")
    system = from_control(lag, control.tf([0.5], [1.0, 0.0], name="slow"), dt=0.1)
    done = assess(ClosedLoop(system, {"reference.ref_y": 1.0}, seconds=8.0), parts=["run"])
    named = [line for line in done.lines if "integration step is too long" in line.text]
    assert bool(named) is long
    exact, y, integral = np.exp(-pole * 0.1), 0.0, 0.0
    for _ in range(79):
        error = 1.0 - y
        y, integral = exact * y + (1 - exact) * (integral + 0.025 * error), integral + 0.05 * error
    end = float(run_system(system, 8.0, {"reference.ref_y": 1.0})["y"][-1, 0])
    assert (abs(end - y) < 1e-4) is not long
    assert done.passed is (None if long else True)
    enough = replace(system, substeps=int(named[0].text.split("substeps=")[1].split(")")[0]) if named else 10)
    assert run_system(enough, 8.0, {"reference.ref_y": 1.0})["y"][-1, 0] == pytest.approx(y, abs=2e-3)


def test_a_plant_alone_is_linearised_about_a_point() -> None:
    plant, linear = pendulum_plant(), linearise(pendulum(), {"plant.drag": 0.3})
    alone = linearise_plant(plant, linear.at.x, {"torque": linear.at.f}, p={"drag": 0.3})
    inside = linear.plant_system()
    assert alone.input_labels == inside.input_labels == ["torque", "gust"]
    assert alone.output_labels == ["measured angle", "measured rate"] and alone.state_labels == ["angle", "rate"]
    for name in "ABCD":
        np.testing.assert_array_equal(getattr(alone, name), getattr(inside, name))
    assert linearise_plant(plant).A[1, 0] == pytest.approx(9.81 * np.cos(0.4))  # at the defaults of the ports
    with pytest.raises(InputError, match="x: has 3 numbers; give 2"):
        linearise_plant(plant, [1, 2, 3])
    with pytest.raises(InputError, match="has no finite derivatives at this point"):
        linearise_plant(plant, {"angle": np.inf})


def test_the_matrices_are_those_of_differences() -> None:
    system, h = pendulum(), 1e-6
    linear = linearise(system, {"disturbance.gust": 0.3, "start.angle": 0.05})
    x, f = linear.at.x, linear.at.f
    A, B, E, C, _ = linear.plant

    def rate(x: np.ndarray, f: float, d: float = 0.3) -> np.ndarray:
        return np.array(system.plant.function(x, f, d, [9.81, 0.1])).ravel()

    for k in range(2):
        step = h * np.eye(2)[k]
        assert A[:, k] == pytest.approx((rate(x + step, f[0]) - rate(x - step, f[0])) / (2 * h), abs=1e-6)
    assert B[:, 0] == pytest.approx((rate(x, f[0] + h) - rate(x, f[0] - h)) / (2 * h), abs=1e-6)
    assert E[:, 0] == pytest.approx([0.0, 1.0]) and np.array_equal(C, np.eye(2))
    assert linear.law[4] == pytest.approx(np.array([[-19.7, -6.2]]))


@pytest.mark.parametrize("openings", [("torque",), ("angle",), ("rate",), ("angle", "rate"), ("torque", "angle")])
def test_closing_an_opened_loop_gives_the_closed_loop(openings: tuple[str, ...]) -> None:
    linear = linearise(pendulum())
    loop = linear.loop(*openings)
    back = np.linalg.inv(np.eye(len(openings)) + loop.D)
    closed = np.linalg.eigvals(loop.A - loop.B @ back @ loop.C)
    assert np.sort_complex(closed) == pytest.approx(np.sort_complex(linear.poles()), abs=1e-10)
    assert loop.dt == 0.01 and loop.input_labels == list(openings)


def test_an_opened_loop_with_a_controller_state_closes_too() -> None:
    linear = linearise(level())
    for opening in ("flow", "height"):
        loop = linear.loop(opening)
        closed = np.linalg.eigvals(loop.A - loop.B @ loop.C / (1 + loop.D[0, 0]))
        assert np.sort_complex(closed) == pytest.approx(np.sort_complex(linear.poles()), abs=1e-10)


def test_python_control_connects_plant_and_controller_to_the_same_loop() -> None:
    linear = linearise(level())
    plant = control.sample_system(linear.plant_system()[:, 0], linear.system.dt)
    law = linear.controller_system()
    loop = -plant * law[0, 0]
    omega = np.geomspace(1e-2, 20, 30)
    ours, theirs = (s(np.exp(1j * omega * 0.1)) for s in (linear.loop("height"), loop))
    assert ours == pytest.approx(theirs, rel=1e-9)


def test_the_closed_system_predicts_a_small_step() -> None:
    system = level()
    closed = linearise(system).closed()
    time = np.arange(200) * system.dt
    u = np.vstack([np.full(200, 1e-3), np.zeros(200)])
    predicted = control.forced_response(closed, time, u).outputs
    linear = linearise(system)
    start = {"start.height": linear.at.x[0], "reference.target": 1.001}
    law = system.controller
    record = run_system(system, 20.0, start)
    # the recorded run begins with an empty integral, so only the linear loop's own prediction of the target is compared
    again = control.forced_response(closed, time, u, np.concatenate([[0.0], law.initial_state() - linear.at.z])).outputs
    assert record["height"][:, 0] - linear.at.x[0] == pytest.approx(again[0], abs=1e-9)
    assert predicted[0][-1] == pytest.approx(1e-3, rel=1e-3)


def test_mistakes_in_openings_are_named() -> None:
    with pytest.raises(InputError, match=r"opening = 'torqe': is not a signal of the loop; did you mean 'torque'"):
        linearise(pendulum()).loop("torqe")
    with pytest.raises(InputError, match="opening: is missing"):
        linearise(pendulum()).loop()


_SLOW, _TURN = 1.0 - 1e-7, [[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]]


@pytest.mark.parametrize(
    ("blocks", "stability", "states"),
    [
        ([[[0.5]], [[_SLOW]]], "stable", ()),
        ([[[0.5]], [[1.0]], [[1.0]]], "marginal", ("b0", "c0")),  # two integrators
        ([[[_SLOW]], [[1.0 + 5e-10]]], "marginal", ("b0",)),
        ([_TURN, [[0.9]]], "marginal", ("a0", "a1")),  # an oscillation without damping
        ([[[1.0, 0.1], [0.0, 0.5]]], "marginal", ("a0",)),
        ([[[1.0, 0.1], [0.0, 1.0]], [[1.0]]], "UNSTABLE", ()),  # an integrator of an integrator
        ([[[1.0]], [[1.001]]], "UNSTABLE", ()),
    ],
)
def test_states_that_do_not_return_are_named_and_no_growing_loop_is_marginal(blocks, stability, states) -> None:
    A = ca.diagcat(*map(ca.DM, blocks)).full()
    n, names = len(A), tuple(f"{'abc'[k]}{i}" for k, block in enumerate(blocks) for i in range(len(block)))
    change = np.linalg.qr(np.random.default_rng(1).normal(size=(n, n)))[0] if stability == "stable" else np.eye(n)
    zero = np.zeros((n, 0))
    plant = (change.T @ A @ change, zero, zero, zero.T, np.zeros((0, 0)))
    law = (np.zeros((0, 0)),) * 6
    loop = LinearLoop(plant, law, LoopNames("p", "c", names, (), (), (), ()), 0.1, sampled=True)
    assert (loop.stability, loop.marginal) == (stability, states)
