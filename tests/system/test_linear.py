"""Equilibria and the linear loop: against differences, python-control and the poles of the loop itself."""

from __future__ import annotations

import control
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.system import find_equilibrium, linearise, run_system
from tests.system.examples import level, pendulum


def test_an_equilibrium_is_where_a_long_run_ends() -> None:
    values = {"disturbance.gust": 0.3, "start.angle": 0.1}
    point = find_equilibrium(pendulum(), values)
    record = run_system(pendulum(), 20.0, values)
    assert point.x == pytest.approx([record["angle"][-1, 0], 0.0], abs=1e-9)
    assert point.f == pytest.approx(record["torque"][-1], abs=1e-9)
    rain = find_equilibrium(level(), {"disturbance.rain": 0.05})
    assert rain.x == pytest.approx([1.0]) and rain.z == pytest.approx([(0.2 - 0.05) / 0.3])


def test_where_nothing_rests_the_moving_state_is_named() -> None:
    with pytest.raises(InputError, match=r"pendulum: no equilibrium is found: `(angle|rate)` still moves"):
        find_equilibrium(pendulum(), {"disturbance.gust": 40.0})


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
    with pytest.raises(InputError, match=r"opening = 'torqe': is no signal of the loop; did you mean 'torque'"):
        linearise(pendulum()).loop("torqe")
    with pytest.raises(InputError, match="opening: is missing"):
        linearise(pendulum()).loop()
