"""Equilibria of a sampled closed loop, and linearisation of the loop at an equilibrium with exact Jacobians."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, nearest
from surctl.ir import to_casadi
from surctl.system.controller import Controller, SampledController
from surctl.system.loop import System
from surctl.system.parts import entry_labels
from surctl.system.plant_linear import plant_matrices, state_space
from surctl.system.values import RunNumbers, run_numbers

__all__ = ["Linearisation", "Operating", "find_equilibrium", "linearise"]

Array = NDArray[np.float64]

_NEWTON = 50
_EULER, _LONGEST = 1000, 1e6  # number of implicit steps, and their greatest length in control periods
_NEAR = 1e-6  # from here on, Newton steps are taken
_REST = 1e-9


@dataclass(frozen=True)
class Operating:
    """An equilibrium of the loop: flat plant state x, controller state z and command f, and the numbers of its run."""

    x: Array
    z: Array
    f: Array
    numbers: RunNumbers


@dataclass(frozen=True, eq=False)
class Linearisation:
    """The linear loop about an operating point, with the plant in continuous time and the controller in discrete time.

    Attributes:
        system: the closed loop.
        at: the operating point of the linearisation.
        plant: matrices (A, B, E, C, D_d) of the plant, with x' = A x + B f + E d and y = C x + D_d d, for command f,
            disturbance d and measured output y.
        law: matrices (A, B_y, B_r, C, D_y, D_r) of the controller, with z⁺ = A z + B_y y + B_r r and command = C z +
            D_y y + D_r r, for controller state z and reference r.
    """

    system: System
    at: Operating
    plant: tuple[Array, ...]
    law: tuple[Array, ...]

    def plant_system(self) -> Any:
        """Return the plant as `control.StateSpace`, from actuator commands and disturbances to measured outputs."""
        return state_space(self.system.plant, self.plant)

    def controller_system(self) -> Any:
        """Return the controller as discrete-time `control.StateSpace`, from measurements and references to commands."""
        import control  # takes seconds to import

        A, By, Br, C, Dy, Dr = self.law
        system = self.system
        return control.ss(
            A, np.hstack([By, Br]), C, np.hstack([Dy, Dr]), system.dt, states=entry_labels(system.controller.state),
            inputs=[*entry_labels(system.plant.measurements, "measured "), *entry_labels(system.references)],
            outputs=entry_labels(system.commands), name=system.controller.name,
        )  # fmt: skip

    def closed(self) -> Any:
        """Return the closed loop as discrete-time `control.StateSpace`, exact at the control instants.

        The inputs are references and disturbances, which are constant over a control period; the outputs are the
        measured outputs and the commands.

        Raises:
            InputError: the loop has no inputs.
        """
        import control  # takes seconds to import

        system = self.system
        inputs = [*entry_labels(system.references), *entry_labels(system.plant.disturbances)]
        if not inputs:
            raise InputError("has neither references nor disturbances", key="closed", remedy="call poles()")
        _, Bd, Ed = self._sampled_plant
        C, D = self.plant[3:]
        By, Br, Cz, Dy, Dr = self.law[1:]
        B = np.block([[Bd @ Dr, Ed + Bd @ Dy @ D], [Br, By @ D]])
        outputs = np.block([[C, np.zeros((len(C), len(By)))], [Dy @ C, Cz]])
        through = np.block([[np.zeros((len(C), Dr.shape[1])), D], [Dr, Dy @ D]])
        return control.ss(
            self._transition(), B, outputs, through, system.dt, states=self.states(), inputs=inputs,
            outputs=[*entry_labels(system.plant.measurements, "measured "), *entry_labels(system.commands)],
            name="closed loop",
        )  # fmt: skip

    def loop(self, *openings: str) -> Any:
        """Return the loop transfer function L(z), opened at the given signals only, as `control.StateSpace`.

        Args:
            openings: labels of commands or measured outputs at which the loop is opened; a label is the port's name,
                with [i] if the port has several entries. Each opening is one channel of L, from the signal injected
                behind the opening to the signal that returns, under negative feedback.

        Raises:
            InputError: no opening is given, or an opening is unknown.
        """
        import control  # takes seconds to import

        A, B, C, D = self.opened(*openings)
        return control.ss(
            A, B, C, D, self.system.dt, states=self.states(), inputs=list(openings),
            outputs=[f"{name} back" for name in openings], name="loop",
        )  # fmt: skip

    def opened(self, *openings: str) -> tuple[Array, Array, Array, Array]:
        """Return the matrices (A, B, C, D) of the opened loop that `loop` returns."""
        system = self.system
        commands, outputs = entry_labels(system.commands), entry_labels(system.plant.measurements)
        if not openings:
            raise InputError("is missing", key="opening", remedy="name a command or a measured output")
        for name in openings:
            if name not in (*commands, *outputs):
                raise InputError(
                    "is no signal of the loop", key="opening", value=name, remedy=nearest(name, (*commands, *outputs))
                )
        at_command = np.array([[float(name == label) for label in commands] for name in openings])
        at_output = np.array(
            [[float(name == label and name not in commands) for label in outputs] for name in openings]
        )
        Ad, Bd, _ = self._sampled_plant
        C = self.plant[3]
        Az, By, _, Cz, Dy, _ = self.law
        # at a loop opening, the channel's own signal is cut, and the injected signal replaces it
        keep_f, keep_y = (
            np.eye(len(commands)) - at_command.T @ at_command,
            np.eye(len(outputs)) - at_output.T @ at_output,
        )
        measured, enters = keep_y @ C, at_output.T
        f_x, f_z, f_e = Dy @ measured, Cz, Dy @ enters
        A = np.block([[Ad + Bd @ keep_f @ f_x, Bd @ keep_f @ f_z], [By @ measured, Az]])
        B = np.vstack([Bd @ (keep_f @ f_e + at_command.T), By @ enters])
        back = np.hstack([at_command @ f_x + at_output @ C, at_command @ f_z])
        return A, B, -back, -(at_command @ f_e)

    def channels(self) -> list[str]:
        """Return the labels of signals at which the loop can be opened: every command, then every measured output."""
        commands = entry_labels(self.system.commands)
        return [*commands, *(name for name in entry_labels(self.system.plant.measurements) if name not in commands)]

    def poles(self) -> NDArray[np.complex128]:
        """Return the poles z of the sampled closed loop, largest first.

        The loop is stable if all poles lie inside the unit circle.
        """
        poles = np.linalg.eigvals(self._transition()).astype(complex)
        return poles[np.argsort(-np.abs(poles), kind="stable")]

    def states(self) -> list[str]:
        """Return the labels of the plant states, then of the controller states."""
        return _state_labels(self.system)

    @cached_property
    def _sampled_plant(self) -> tuple[Array, Array, Array]:
        # (A_d, B_d, E_d) over one control period, driven by the commands and the disturbances
        return _held(self.plant[0], self.plant[1] @ self._selection(), self.plant[2], self.system.dt)

    def _transition(self) -> Array:
        # from one control instant to the next
        Ad, Bd, _ = self._sampled_plant
        Az, By, _, Cz, Dy, _ = self.law
        C = self.plant[3]
        return np.block([[Ad + Bd @ Dy @ C, Bd @ Cz], [By @ C, Az]])

    def _selection(self) -> Array:
        # (plant inputs, commands): 1 where an actuator takes a command
        system = self.system
        commands, inputs = entry_labels(system.commands), entry_labels(system.plant.inputs)
        return np.array([[float(name == label) for label in commands] for name in inputs])


def find_equilibrium(system: System, values: Mapping[str, ArrayLike] | None = None) -> Operating:
    """Return the equilibrium of plant and controller for constant references and disturbances, by Newton's method.

    Args:
        system: the closed loop; its `reference` and `disturbance` are evaluated at t = 0.
        values: numbers by name, see `run_numbers`. The search begins at the start state that names `start.…` give.
            Without such names, the search begins at zero and then, if necessary, at the default state.

    Raises:
        InputError: the search finds no equilibrium; the message names the state that moves most.

    Example:
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Controller, Plant, System, find_equilibrium
        >>> speed, force = Port("speed", (1,), "m/s", "of the boat"), Port("force", (1,), "m/s^2", "over the mass")
        >>> wind = Layout((Port("wind", (1,), "m/s^2", "over the mass"),))
        >>> boat = Plant(
        ...     "boat", Layout((speed,)), Layout((force,)), disturbances=wind,
        ...     ode=lambda x, f, d, p: {"speed": f["force"] + d["wind"] - 0.5 * x["speed"]},
        ... )
        >>> law = Controller("hold", 0.1, Layout((speed,)), Layout((force,)), lambda x, u, p: 2 * (1 - u["speed"]))
        >>> find_equilibrium(System(boat, law), {"disturbance.wind": 0.5}).x
        array([1.])
    """
    return _equilibrium(_Rest.of(system, values), values)


def _equilibrium(functions: _Rest, values: Mapping[str, ArrayLike] | None) -> Operating:
    system, numbers = functions.system, functions.numbers
    started = any(name.startswith("start.") for name in values or {})
    ends = []
    starts = [numbers.start[0]] if started else [np.zeros(system.plant.state.size), numbers.start[0]]
    for search in (_newton, _transient):
        for x in starts:
            point, rests = search(functions, np.concatenate([x, system.controller.initial_state()]))
            if rests:
                return functions.operating(point)
            ends.append(point)
    error = np.nan_to_num(functions.error(ends[0])[0], nan=np.inf)
    worst = _state_labels(system)[int(np.argmax(np.abs(error)))]
    constant = functions.constant_commands(ends[0])
    saturated = f", and command `{constant[0]}` does not depend on the state there (saturated?)" if constant else ""
    raise InputError(
        f"no equilibrium is found: `{worst}` still moves{saturated}", key=system.plant.name,
        remedy="begin nearer to it with start.…, or check references and disturbances",
    )  # fmt: skip


def _newton(functions: _Rest, point: Array) -> tuple[Array, bool]:
    # damped Newton steps; returns whether the point is an equilibrium
    for _ in range(_NEWTON):
        error, slope = functions.error(point)
        if not (np.isfinite(error).all() and np.isfinite(slope).all()):
            break
        if np.max(np.abs(error)) <= _REST * max(1.0, float(np.max(np.abs(point)))):
            return point, True
        step = np.linalg.lstsq(slope, -error, rcond=None)[0]
        for factor in 0.5 ** np.arange(12):
            trial = point + factor * step
            if np.linalg.norm(functions.error(trial)[0]) < np.linalg.norm(error):
                break
        point = trial
    return point, False


def _transient(functions: _Rest, point: Array) -> tuple[Array, bool]:
    """Follow the loop by implicit Euler steps of growing length, then take Newton steps.

    Newton's method alone stalls where a saturated command does not depend on the state.
    """
    system = functions.system
    rates = np.ones(point.size)
    rates[system.plant.state.size :] = 1 / system.dt
    length, size = system.dt, np.inf
    for _ in range(_EULER):
        error, slope = functions.error(point)
        if not (np.isfinite(error).all() and np.isfinite(slope).all()):
            break
        before, size = size, float(np.linalg.norm(rates * error))
        if size <= _NEAR * max(1.0, float(np.max(np.abs(point)))):
            break
        length = float(np.clip(length * min(2.0, max(0.5, before / size)), system.dt, _LONGEST * system.dt))
        step = np.eye(point.size) / length - rates[:, None] * slope
        point = point + np.linalg.lstsq(step, rates * error, rcond=None)[0]
    return _newton(functions, point)


def linearise(
    system: System, values: Mapping[str, ArrayLike] | None = None, *, at: Operating | None = None
) -> Linearisation:
    """Return the linear loop about an operating point, from exact derivatives of plant and controller.

    Args:
        system: the closed loop.
        values: numbers by name, see `run_numbers`.
        at: the operating point; by default the result of `find_equilibrium(system, values)`.

    Raises:
        InputError: as in `find_equilibrium`.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Controller, Plant, System, linearise
        >>> angle, rate = Port("angle", (1,), "rad", "from upright"), Port("rate", (1,), "rad/s", "angular rate")
        >>> torque = Port("torque", (1,), "1/s^2", "over the inertia")
        >>> pendulum = Plant(
        ...     "pendulum", Layout((angle, rate)), Layout((torque,)),
        ...     lambda x, f, d, p: {"angle": x["rate"], "rate": 9.81 * ca.sin(x["angle"]) + f["torque"]},
        ... )
        >>> law = Controller(
        ...     "pd", 0.01, Layout((angle, rate)), Layout((torque,)), lambda x, u, p: -20 * u["angle"] - 6 * u["rate"]
        ... )
        >>> linear = linearise(System(pendulum, law))
        >>> linear.plant[0].round(2).tolist(), abs(linear.poles()).round(3).tolist()
        ([[0.0, 1.0], [9.81, 0.0]], [0.97, 0.97])
    """
    functions = _Rest.of(system, values) if at is None else _Rest(system, at.numbers)
    point = _equilibrium(functions, values) if at is None else at
    numbers, d = point.numbers, ca.SX.sym("d", system.plant.disturbances.size)
    late = ca.Function("late", [d], [system.disturbance_at(ca.SX(0), d)])(numbers.disturbance[0])
    commands = dict(zip(entry_labels(system.commands), point.f, strict=True))
    applied = np.array([commands[label] for label in entry_labels(system.plant.inputs)])
    matrices = plant_matrices(system.plant, point.x, applied, np.array(late).reshape(-1), numbers.plant[0])
    return Linearisation(system, point, matrices, functions.law(point))


class _Rest:
    # x' = 0 and z⁺ = z
    def __init__(self, system: System, numbers: RunNumbers) -> None:
        self.system, self.numbers = system, numbers
        plant, controller = system.plant, system.controller
        law = _law_function(controller)
        parameters, gains = ca.SX(ca.DM(numbers.plant[0])), ca.DM(numbers.gains[0])
        disturbance = ca.SX(ca.DM(numbers.disturbance[0]))
        d = system.disturbance_at(ca.SX(0), disturbance)
        self.reference = np.array(ca.DM(system.reference_at(ca.SX(0), ca.SX(ca.DM(numbers.reference[0])))))
        x, f = ca.SX.sym("x", plant.state.size), ca.SX.sym("f", system.commands.size)
        y, r = ca.SX.sym("y", plant.measurements.size), ca.SX.sym("r", system.references.size)
        measure = ca.Function("measure", [x], [plant.measurement(x, d, parameters)])
        inputs = ca.Function("inputs", [y, r], [system.inputs_of(y, r)])
        rate = ca.Function("rate", [x, f], [plant.derivative(x, system.applied(f), d, parameters)])
        X, Z = ca.MX.sym("x", plant.state.size), ca.MX.sym("z", controller.state.size)
        command, after = law(Z, inputs(measure(X), self.reference), gains)[:2]
        error, point = ca.vertcat(rate(X, command), after - Z), ca.vertcat(X, Z)
        self._error = ca.Function(
            "rest", [X, Z], [error, ca.jacobian(error, point), command, ca.jacobian(command, point)]
        )
        Y, R = ca.MX.sym("y", plant.measurements.size), ca.MX.sym("r", system.references.size)
        command, after = law(Z, inputs(Y, R), gains)[:2]
        slopes = [ca.jacobian(out, by) for out in (after, command) for by in (Z, Y, R)]
        self._slopes = ca.Function("slopes", [Z, Y, R], slopes)
        self._measure = measure

    @classmethod
    def of(cls, system: System, values: Mapping[str, ArrayLike] | None) -> _Rest:
        numbers = run_numbers(system, values or {})
        if numbers.count != 1:
            raise InputError(f"are for {numbers.count} runs", key="values", remedy="give one number each")
        return cls(system, numbers)

    def error(self, point: Array) -> tuple[Array, Array]:
        # residual at (x, z), and its derivative
        error, slope, _, _ = self._error.call(self._split(point))
        return np.array(error).reshape(-1), np.array(slope)

    def constant_commands(self, point: Array) -> list[str]:
        # labels of commands that do not change with the state about this point
        slopes = np.array(self._error.call(self._split(point))[3])
        return [name for name, row in zip(entry_labels(self.system.commands), slopes, strict=True) if not row.any()]

    def operating(self, point: Array) -> Operating:
        x, z = self._split(point)
        return Operating(x, z, np.array(self._error.call([x, z])[2]).reshape(-1), self.numbers)

    def law(self, point: Operating) -> tuple[Array, ...]:
        # derivatives of next controller state, then command, by controller state, measurements, references
        results = self._slopes.call([point.z, self._measure(point.x), self.reference])
        return tuple(np.array(result) for result in results)

    def _split(self, point: Array) -> list[Array]:
        size = self.system.plant.state.size
        return [point[:size], point[size:]]


def _law_function(controller: SampledController) -> ca.Function:
    # (x, u, p) → (command, next state, …)
    if not isinstance(controller, Controller):
        return to_casadi(controller.block)
    symbols = [
        ca.SX.sym(n, v.size)
        for n, v in zip("xup", (controller.state, controller.inputs, controller.gains), strict=True)
    ]
    return ca.Function(controller.name, symbols, list(controller.action(*symbols)))


def _held(A: Array, B: Array, E: Array, dt: float) -> tuple[Array, Array, Array]:
    # held inputs: x⁺ = A_d x + B_d f + E_d d, exact
    from scipy.linalg import expm  # takes a second to import

    n, m = len(A), B.shape[1] + E.shape[1]
    whole = np.zeros((n + m, n + m))
    whole[:n] = np.hstack([A, B, E])
    transition = expm(whole * dt)
    return transition[:n, :n], transition[:n, n : n + B.shape[1]], transition[:n, n + B.shape[1] :]


def _state_labels(system: System) -> list[str]:
    return [*entry_labels(system.plant.state), *entry_labels(system.controller.state, "controller ")]
