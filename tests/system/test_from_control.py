"""Systems of python-control as plants and controllers: their responses are python-control's own."""

from __future__ import annotations

import control
import numpy as np
import pytest

import surctl
from surctl.errors import InputError
from surctl.system import (
    Controller,
    Plant,
    System,
    linearise,
    run_system,
    to_control,
)
from surctl.system.from_control import (
    controller_from_control,
    plant_from_control,
    state_space,
    system_from_control,
)

PLANT = control.ss(
    [[0.0, 1.0], [-2.0, -0.3]], [[0.0], [1.5]], [[1.0, 0.0]], 0, inputs=["torque [N m]"], outputs=["angle [rad]"],
    states=["x[0]", "x[1]"], name="arm",
)  # fmt: skip
LEAD = control.tf([30.0, 30.0], [1.0, 8.0], name="lead")


def test_the_loop_of_two_systems_is_that_of_feedback() -> None:
    system = surctl.from_control(PLANT, LEAD, dt=0.02)
    assert isinstance(system, System)
    assert [(port.name, port.size, port.unit) for port in system.plant.state] == [("x", 2, "1")]
    assert [(port.name, port.unit) for port in system.plant.inputs] == [("torque", "N m")]
    loop = linearise(system)
    sampled = control.sample_system(PLANT, 0.02) * control.sample_system(control.ss(LEAD), 0.02, method="tustin")
    omega = np.geomspace(0.1, 100, 40)
    known, own = (one(np.exp(1j * omega * 0.02)) for one in (sampled, loop.loop("torque")))
    assert own == pytest.approx(known, rel=1e-9)
    closed = control.feedback(sampled, 1)
    time = np.arange(200) * 0.02
    record = run_system(system, 4.0, {"reference.ref_angle": 1.0})
    assert record["angle"][:, 0] == pytest.approx(control.step_response(closed, time).outputs, abs=1e-7)
    z = np.exp(1j * omega * 0.02)
    reference, setpoint, load = (loop.transfer(one, "measured.angle")(z) for one in ("ref_angle", "angle", "torque"))
    assert setpoint == pytest.approx(reference, rel=1e-12) and reference == pytest.approx(closed(z), rel=1e-9)
    plant = control.sample_system(PLANT, 0.02)
    assert load == pytest.approx(plant(z) / (1 + sampled(z)), rel=1e-9)
    assert loop.transfer("angle", "torque")(z) == pytest.approx(reference / plant(z), rel=1e-9)
    out = loop.closed()
    assert out.input_labels == ["ref_angle"] and out.output_labels == ["measured angle", "torque"]
    assert out.dt == 0.02 and isinstance(to_control(loop), control.StateSpace)


def test_signals_connect_by_name() -> None:
    law = control.ss([], [], [], [[-6.0, -2.0, 6.0]], 0.05, inputs=["rate", "angle", "target"], outputs=["torque"])
    plant = control.ss(PLANT.A, PLANT.B, np.eye(2), 0, inputs=["torque"], outputs=["angle", "rate"], name="arm")
    system = system_from_control(plant, law)
    assert [port.name for port in system.references] == ["target"]
    assert run_system(system, 0.05, {"reference.target": 2.0, "start.x": [[0.5, 1.0]]})["torque"] == pytest.approx(5.0)


def test_a_nonlinear_system_runs_as_input_output_response() -> None:
    def rate(t, x, u, params):
        return np.array([x[1], -params["g"] * np.sin(x[0]) + np.clip(u[0], -1, 1)])

    pendulum = control.nlsys(rate, None, states=2, inputs=1, outputs=2, name="pendulum", params={"g": 9.81})
    plant = surctl.from_control(pendulum)
    assert isinstance(plant, Plant) and plant.measure is not None
    x = np.array([0.3, -0.2])
    assert np.array(plant.function(x, [4.0], [], [])).ravel() == pytest.approx(pendulum.dynamics(0, x, [4.0]))
    again = to_control(plant)
    assert again.dynamics(0, x, [4.0]) == pytest.approx(pendulum.dynamics(0, x, [4.0]))
    assert pytest.approx(control.linearize(pendulum, x, [0.5]).A, abs=1e-5) == control.linearize(again, x, [0.5]).A

    def after(t, x, u, params):
        return x + 0.1 * u

    integral = control.nlsys(after, lambda t, x, u, params: 2 * x + u, states=1, inputs=1, outputs=1, dt=0.1)
    law = surctl.from_control(integral)
    assert isinstance(law, Controller) and law.dt == 0.1
    step = law.step([0.5], [1.0], [])
    assert step.tau == pytest.approx([2.0]) and step.x_next == pytest.approx([0.6])
    back = to_control(law)
    assert back.dt == 0.1 and back.output(0, np.array([0.5]), np.array([1.0])) == pytest.approx([2.0])


def test_letters_of_other_alphabets_become_names() -> None:
    law = surctl.from_control(control.ss([], [], [], np.eye(2), 0.1, inputs=["θ [rad]", "ψ"], outputs=["τ_1", "τ_2"]))
    assert [port.name for port in law.inputs] == ["theta", "psi"] and next(iter(law.inputs)).unit == "rad"
    assert [port.name for port in law.command] == ["tau_1", "tau_2"]
    labels = ["pläne", "Øst", "θ̇", "ẋ", "µ", "y₂"]
    law = surctl.from_control(control.ss([], [], [], np.eye(6), 0.1, inputs=labels, name="straße"))
    assert [port.name for port in law.inputs] == [
        "plane",
        "ost",
        "thetadot",
        "xdot",
        "mu",
        "y2",
    ] and law.name == "strase"
    with pytest.raises(InputError, match="plane: is the name of two ports; rename one of them"):
        surctl.from_control(control.ss([], [], [], np.eye(2), 0.1, inputs=["pläne", "plane"]))


def test_mistakes_are_one_line() -> None:
    fails = control.nlsys(lambda t, x, u, p: [x[0] if x[0] > 0 else 0.0], None, states=1, inputs=1, outputs=1)
    timed = control.nlsys(lambda t, x, u, p: [np.sin(t) - x[0]], None, states=1, inputs=1, outputs=1)
    two = control.ss(-np.eye(2), np.eye(2), np.eye(2), 0, inputs=["left", "right"], outputs=["a", "b"])
    crossed = control.ss([], [], [], np.eye(2), 0.1, inputs=["a", "b"], outputs=["right", "lefts"])
    for call, problem in (
        (lambda: surctl.from_control(3.0), "system: is a float"),
        (lambda: plant_from_control(control.tf([1.0, 0.0], [1.0, 1.0])), "passes an input directly to an output"),
        (lambda: plant_from_control(control.ss([[0.5]], [[1]], [[1]], 0, 0.1)), "is in discrete time"),
        (lambda: plant_from_control(control.ss([], [], [], 1)), "has no state"),
        (lambda: plant_from_control(fails), "fails on CasADi symbols"),
        (lambda: controller_from_control(LEAD), "has no control period"),
        (lambda: controller_from_control(control.ss([], [], [], 1, 0.1), dt=0.2), "has the control period 0.1 s"),
        (lambda: system_from_control(PLANT, control.ss([], [], [], [[1, 1]], 0.1)), "has 2 inputs, but the plant 1"),
        (lambda: to_control(3), "part: is a int"),
        (lambda: plant_from_control(timed), "depends on the time t"),
        (lambda: plant_from_control(control.ss([[np.inf]], [[1]], [[1]], 0)), "is not finite"),
        (lambda: controller_from_control(control.tf([1, 1, 1], [1, 0]), dt=0.1), "has no state space"),
        (lambda: surctl.from_control(PLANT, LEAD, dt="0.02"), "dt = '0.02': is not a positive time"),
        (lambda: surctl.from_control(PLANT, LEAD, dt=float("nan")), "dt = nan: is not a positive time"),
        (lambda: system_from_control(two, crossed), "commands right, but not left"),
    ):
        with pytest.raises(InputError) as raised:
            call()
        assert problem in str(raised.value) and "\n" not in str(raised.value)


@pytest.mark.parametrize("seed", range(8))
def test_a_matrix_of_transfer_functions_has_a_minimal_state_space(seed: int) -> None:
    """Drawn residues at shared poles: the response is theirs, and the order is the sum of their ranks (Gilbert)."""
    rng = np.random.default_rng(seed)
    p, m = rng.integers(1, 4, 2)
    dt = 0.1 if seed % 2 else 0
    poles = [1.0, -0.3, 0.2] if dt else [0.0, -0.5, -3.0]
    ranks = rng.integers(0, min(p, m) + 1, 3)
    residues = [rng.normal(size=(p, r)) @ rng.normal(size=(r, m)) for r in ranks]
    through = rng.normal(size=(p, m)) * (rng.random((p, m)) < 0.5)
    num, den = np.empty((2, p, m), dtype=object)
    for i, j in np.ndindex(p, m):
        used = [k for k in range(3) if abs(residues[k][i, j]) > 0]
        den[i, j] = 3.0 * np.atleast_1d(np.poly([poles[k] for k in used]))
        parts = [3.0 * residues[k][i, j] * np.atleast_1d(np.poly([poles[n] for n in used if n != k])) for k in used]
        num[i, j] = np.sum([np.pad(q, (len(den[i, j]) - len(q), 0)) for q in parts], axis=0) + through[i, j] * den[i, j]
    system = control.tf(num.tolist(), den.tolist(), dt)
    own = state_space(system)
    omega = np.geomspace(0.01, 30, 40)
    at = np.exp(1j * omega * dt) if dt else 1j * omega
    np.testing.assert_allclose(own(at), system(at), rtol=1e-7, atol=1e-9)
    assert own.nstates == sum(ranks)


def test_two_inputs_and_two_outputs_without_slycot() -> None:
    s = control.tf("s")
    matrix = control.combine_tf([[1 / s, 1 / (s * (s + 1))], [2 / s, 3 / (s + 2)]])
    plant = plant_from_control(matrix)
    assert plant.state.size == 4 and plant.inputs.size == plant.measurements.size == 2
    gains = control.tf([[[0.4], [0.1]], [[0.0], [0.2]]], [[[1.0], [1.0]], [[1.0], [1.0]]], 0.05)
    loop = system_from_control(plant, gains)
    assert np.isfinite(linearise(loop).poles()).all()
    with pytest.raises(InputError, match="has no state space"):
        plant_from_control(control.combine_tf([[s, 1 / s]]))
