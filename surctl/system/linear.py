"""Equilibria of a sampled loop, or why none is found; exact linearisation; share of time of commands at a limit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.ir import Layout, Program, to_casadi
from surctl.ir.native import runnable
from surctl.ir.procedure import Procedure
from surctl.ir.routine import nested
from surctl.system.controller import Controller, SampledController
from surctl.system.linear_loop import LinearLoop, LoopNames, held_plant
from surctl.system.loop import System, once_per_system
from surctl.system.parts import entry_labels, entry_units, undefined_operation
from surctl.system.plant import Plant
from surctl.system.record import Record
from surctl.system.sampled import Instant
from surctl.system.values import RunNumbers, run_numbers
from surctl.units import as_numbers

Array = NDArray[np.float64]

# Linearisation of a plant alone about a point, with exact Jacobians


def linearise_plant(
    plant: Plant,
    x: Mapping[str, ArrayLike] | ArrayLike = (),
    f: Mapping[str, ArrayLike] | ArrayLike = (),
    *,
    d: Mapping[str, ArrayLike] | ArrayLike = (),
    p: Mapping[str, ArrayLike] | ArrayLike = (),
) -> Any:
    """Return the linear plant about a point as `control.StateSpace`, for a design without a controller, such as LQR.

    Its inputs are actuator commands, then disturbances; its outputs are the measured outputs; all have the names of the
    plant's ports. The point is a state x, commands f, disturbances d and parameters p, each as values by port name or a
    flat vector; a port without a value has its default. It need not be an equilibrium.

    Raises:
        InputError: a name or size does not fit the plant, or a derivative is not finite at the point.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Plant, linearise_plant
        >>> angle, rate = Port("angle", (1,), "rad", "from upright"), Port("rate", (1,), "rad/s", "angular rate")
        >>> torque = Port("torque", (1,), "1/s^2", "over the inertia")
        >>> pendulum = Plant(
        ...     "pendulum", Layout((angle, rate)), Layout((torque,)),
        ...     lambda x, f, d, p: {"angle": x["rate"], "rate": 9.81 * ca.sin(x["angle"]) + f["torque"]},
        ... )
        >>> hanging = linearise_plant(pendulum, {"angle": 3.14159265})
        >>> hanging.A.round(2).tolist(), hanging.input_labels
        ([[0.0, 1.0], [-9.81, 0.0]], ['torque'])
    """
    layouts = {"x": plant.state, "f": plant.inputs, "d": plant.disturbances, "p": plant.parameters}
    point = [_flat(layouts[name], part, name) for name, part in zip("xfdp", (x, f, d, p), strict=True)]
    matrices = [np.array(matrix) for matrix in _plant_slopes(plant).call(point)]
    if not all(np.isfinite(matrix).all() for matrix in matrices):
        raise InputError("has no finite derivatives at this point", key=plant.name, remedy="choose another point")
    import control  # takes seconds to import

    A, B, E, C, D = matrices
    return control.ss(
        A, np.hstack([B, E]), C, np.hstack([np.zeros((len(C), B.shape[1])), D]), states=entry_labels(plant.state),
        inputs=[*entry_labels(plant.inputs), *entry_labels(plant.disturbances)],
        outputs=entry_labels(plant.measurements, "measured "), name=plant.name,
    )  # fmt: skip


def _plant_slopes(plant: Plant) -> ca.Function:
    """Return the function of x, f, d and p that computes (A, B, E, C, D): x' = A x + B f + E d and y = C x + D d."""
    layouts = {"x": plant.state, "f": plant.inputs, "d": plant.disturbances, "p": plant.parameters}
    x, f, d, p = (ca.SX.sym(name, layout.size) for name, layout in layouts.items())
    rate, y = plant.derivative(x, f, d, p), plant.measurement(x, d, p)
    jacobians = [ca.jacobian(rate, v) for v in (x, f, d)] + [ca.jacobian(y, v) for v in (x, d)]
    return ca.Function("plant", [x, f, d, p], jacobians)


def _flat(layout: Layout, values: Mapping[str, ArrayLike] | ArrayLike, key: str) -> Array:
    if isinstance(values, Mapping):
        return layout.pack(values)
    vector = as_numbers(values, key=key).reshape(-1)
    if not vector.size:
        return layout.pack()
    if vector.size != layout.size:
        raise InputError(f"has {vector.size} numbers", key=key, remedy=f"give {layout.size}, or values by port name")
    return vector


_NEWTON = 50
_EULER, _LONGEST = 1000, 1e6  # number of implicit steps, and their greatest length in control periods
_NEAR = 1e-6  # from here on, Newton steps are taken
_REST = 1e-9
_ZERO = 1e-15  # Newton steps towards 0 may end at a number of this size; a certificate would state all its digits
_SHOWN = 6  # largest number of states in a message
_STEP = 1e-6  # relative change of a number to which a command responds


@dataclass(frozen=True)
class Operating:
    """An equilibrium of the loop, at which random numbers of sampled blocks have their means.

    Attributes:
        x, z, f: plant state, controller state and command, flat.
        numbers: the numbers of its run.
        memory: memory of all sampled blocks, flat.
    """

    x: Array
    z: Array
    f: Array
    numbers: RunNumbers
    memory: Array


@dataclass(frozen=True, eq=False)
class Linearisation(LinearLoop):
    """The linear loop about an operating point of a system; for its matrices and methods see `LinearLoop`.

    Attributes:
        system: the closed loop.
        at: the operating point of the linearisation.
    """

    system: System
    at: Operating


def find_equilibrium(system: System, values: Mapping[str, ArrayLike] | None = None) -> Operating:
    """Return the equilibrium of plant and controller for constant references and disturbances, by Newton's method.

    Args:
        values: numbers by name, see `run_numbers`. The search begins at the start state that names `start.…` give.
            Without such names, the search begins at zero and then, if necessary, at the default state, and in the
            middle of the box `within` of the system.

    Raises:
        InputError: the search finds no equilibrium; the message names the state that moves most, or the operation that
            has no finite value or derivative where the search ends.

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
    tried, memory = [], system.blocks.memory.pack()
    starts = [numbers.start[0]] if started else [np.zeros(system.plant.state.size), numbers.start[0]]
    if not started and system.within:
        labels = entry_labels(system.plant.state)
        ends = [system.within.get(label, (x, x)) for label, x in zip(labels, numbers.start[0], strict=True)]
        starts.append(np.mean(ends, axis=1))
    for search in (_newton, _transient):
        for x in starts:
            with np.errstate(over="ignore", invalid="ignore"):  # a search may run away
                point, rests = search(functions, np.concatenate([x, system.controller.initial_state(), memory]))
            if rests:
                return functions.operating(point)
            tried.append(point)
    for point in tried:
        functions.check_finite(point)
    error = np.nan_to_num(functions.error(tried[0])[0], nan=np.inf)
    worst = _state_labels(system)[int(np.argmax(np.abs(error)))]
    constant = functions.constant_commands(tried[0])
    saturated = f", and command `{constant[0]}` does not depend on the state there (saturated?)" if constant else ""
    raise InputError(
        f"no equilibrium was found: `{worst}` still moves{saturated}", key=system.plant.name,
        remedy="begin nearer to it with start.…, or check references and disturbances",
    )  # fmt: skip


def _newton(functions: _Rest, point: Array) -> tuple[Array, bool]:
    # damped Newton steps until they change no state, however slow or small, or bring none nearer; returns whether the
    # point is an equilibrium: neither the change of a state nor the distance that it stands for is more than rounding
    for _ in range(_NEWTON):
        error, slope = functions.error(point)
        if not (np.isfinite(error).all() and np.isfinite(slope).all()):
            return point, False
        rates = np.linalg.norm(slope, axis=1)
        rates[rates == 0] = 1.0
        step = np.linalg.lstsq(slope / rates[:, None], -error / rates, rcond=None)[0]
        if (np.abs(step) <= _REST * np.abs(point)).all():
            break
        for factor in 0.5 ** np.arange(12):
            trial = point + factor * step
            if np.linalg.norm(functions.error(trial)[0] / rates) < np.linalg.norm(error / rates):
                break
        else:  # no part of the step brings it nearer
            break
        point = trial
    error, slope = functions.error(point)
    zeroed = np.where(np.abs(point) <= _ZERO * max(1.0, float(np.max(np.abs(point)))), 0.0, point)
    if (np.abs(functions.error(zeroed)[0]) <= np.abs(error)).all():
        point = zeroed
    rates = np.linalg.norm(slope, axis=1)
    apart = np.abs(error) / np.where(rates > 0, np.minimum(rates, 1.0), 1.0)
    return point, bool(np.max(apart) <= _REST * max(1.0, float(np.max(np.abs(point)))))


def _transient(functions: _Rest, point: Array) -> tuple[Array, bool]:
    """Follow the loop by implicit Euler steps of growing length, then take Newton steps.

    Newton's method alone stalls where a saturated command does not depend on the state.
    """
    system = functions.system
    rates = np.ones(point.size)
    rates[system.plant.state.size :] = 1 / system.dt  # of controller and blocks
    length, size = system.dt, np.inf
    for _ in range(_EULER):
        error, slope = functions.error(point)
        if not (np.isfinite(error).all() and np.isfinite(slope).all()):
            break
        before, size = size, float(np.linalg.norm(rates * error))
        if not _NEAR * max(1.0, float(np.max(np.abs(point)))) < size < np.inf:
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
        at: the operating point; by default the result of `find_equilibrium(system, values)`.

    Raises:
        InputError: as in `find_equilibrium`, or a sampled block has a longer period than the controller, so that the
            loop changes from one period to the next.

    Example:
        >>> from surctl.system import linearise
        >>> from surctl.testing import cart_system
        >>> linear = linearise(cart_system(2.0))
        >>> linear.plant[1].tolist(), linear.poles().real.round(3).tolist()
        ([[1.0]], [0.8])
    """
    functions = _Rest.of(system, values) if at is None else _Rest(system, at.numbers)
    point = _equilibrium(functions, values) if at is None else at
    f = functions.inputs(point)
    slopes = functions.functions["plant"].call([point.x, f, functions.disturbance, point.numbers.plant[0]])
    matrices, names = tuple(np.array(matrix) for matrix in slopes), _loop_names(system)
    if sampled := bool(system.blocks.all):
        matrices = functions.sampled_plant(point, matrices)
        names = replace(names, states=(*names.states, *entry_labels(system.blocks.memory)), inputs=names.commands)
    return Linearisation(matrices, functions.law(point), names, system.dt, system, point, sampled=sampled)


class _Rest:
    # x' = 0, z⁺ = z, and memory of the sampled blocks b⁺ = b
    def __init__(self, system: System, numbers: RunNumbers) -> None:
        self.system, self.numbers = system, numbers
        self.functions = _functions(system)
        self.reference = np.array(self.functions["reference"](numbers.reference[0])).reshape(-1)
        self.disturbance = np.array(self.functions["disturbance"](numbers.disturbance[0])).reshape(-1)
        self.arguments = [numbers.gains[0], numbers.plant[0], self.reference, self.disturbance, numbers.blocks[0]]

    @classmethod
    def of(cls, system: System, values: Mapping[str, ArrayLike] | None) -> _Rest:
        numbers = run_numbers(system, values)
        if numbers.count != 1:
            raise InputError(f"are for {numbers.count} runs", key="values", remedy="give one number each")
        return cls(system, numbers)

    def error(self, point: Array) -> tuple[Array, Array]:
        # residual at (x, z), and its derivative
        error, slope, _, _ = self.functions["rest"].call([*self._split(point), *self.arguments])
        return np.array(error).reshape(-1), np.array(slope)

    def constant_commands(self, point: Array) -> list[str]:
        # labels of commands that do not change with the state about this point
        slopes = np.array(self.functions["rest"].call([*self._split(point), *self.arguments])[3])
        return [name for name, row in zip(entry_labels(self.system.commands), slopes, strict=True) if not row.any()]

    def check_finite(self, point: Array) -> None:
        """Raise InputError if a rate, or its derivative by a state, is not finite at the point."""
        error, slope = self.error(point)
        rows = ~(np.isfinite(error) & np.isfinite(slope).all(axis=1))
        if not rows.any():
            return
        labels, (x, z, b) = _state_labels(self.system), self._split(point)
        row = int(np.argmax(rows))
        what = f"the rate of `{labels[row]}`"
        if slope_only := bool(np.isfinite(error[row])):
            column = int(np.argmax(~np.isfinite(slope[row])))
            what = f"the derivative of {what} by `{labels[column]}`"
        law, numbers = self.functions["control"], self._constants(b)
        measured, _ = self.functions["measure"](x, *numbers)
        u = self.functions["inputs"](measured, self.reference)
        f = law.call([z, u, self.numbers.gains[0]])[0]
        plant, gains = self.system.plant, self.numbers.gains[0]
        at = [x, f, *numbers]
        cause = undefined_operation("plant", self.functions["rate"], at, {3: plant.parameters}, slope=slope_only)
        own = {2: self.system.controller.gains}
        cause = cause or undefined_operation("law", law, [z, u, gains], own, slope=slope_only)
        raise InputError(
            f"{what} is not finite where the search ends ({_place(labels, point)}){cause}",
            key=plant.name,
            remedy="write it smoothly there (sqrt(x**2 + 1e-12), say), or begin near the equilibrium: "
            f"start.{plant.state.ports[0].name}=…",
        )

    def operating(self, point: Array) -> Operating:
        x, z, b = self._split(point)
        f = np.array(self.functions["rest"].call([x, z, b, *self.arguments])[2]).reshape(-1)
        return Operating(x, z, f, self.numbers, b)

    def inputs(self, point: Operating) -> Array:
        # of the plant
        return np.array(self.functions["drive"](point.f, point.x, *self._constants(point.memory))[0]).reshape(-1)

    def law(self, point: Operating) -> tuple[Array, ...]:
        # derivatives of next controller state, then command, by controller state, measurements, references
        measured, _ = self.functions["measure"](point.x, *self._constants(point.memory))
        results = self.functions["law"].call([point.z, measured, self.reference, self.numbers.gains[0]])
        return tuple(np.array(result) for result in results)

    def sampled_plant(self, point: Operating, plant: tuple[Array, ...]) -> tuple[Array, ...]:
        """Return (A, B, E, C, D) of plant and sampled blocks from one control instant to the next, by commands.

        `plant` are the matrices of the plant alone, in continuous time.
        """
        system = self.system
        for name, periods in system.blocks.slow().items():
            problem = f"is sampled once in {periods} control periods, so the loop changes from one period to the next"
            raise InputError(problem, key=f"{name}.period", remedy="give it the control period, or simulate the loop")
        numbers = self._constants(point.memory)
        sizes = system.plant.state.size, len(point.memory), len(point.f), len(self.disturbance)
        at = [slice(a, b) for a, b in pairwise(np.cumsum([0, *sizes]))]
        now = np.eye(sum(sizes))  # rows: state, memory, command, disturbance now; columns: those at the control instant
        A, B, E = plant[:3]
        held = held_plant(A, B, E, system.dt / system.blocks.instants)
        for k, (sense, drive) in enumerate(_block_slopes(system)):
            y, memory = (np.array(slope) for slope in sense(point.x, *numbers))
            if k == 0:
                measured = y @ now[_rows(at, 0, 1, 3)]
            now[at[1]] = memory @ now[_rows(at, 0, 1, 3)]
            f, memory = (np.array(slope) for slope in drive(point.f, point.x, *numbers))
            inputs, after = f @ now[_rows(at, 2, 0, 1, 3)], memory @ now[_rows(at, 2, 0, 1, 3)]
            now[at[1]] = after
            now[at[0]] = held[0] @ now[at[0]] + held[1] @ inputs + held[2] @ now[at[3]]
        both = slice(0, at[1].stop)
        return now[both, both], now[both, at[2]], now[both, at[3]], measured[:, both], measured[:, at[3]]

    def _constants(self, memory: Array) -> list[Array]:
        # arguments of the functions of plant and blocks
        return [self.disturbance, self.numbers.plant[0], memory, self.numbers.blocks[0]]

    def _split(self, point: Array) -> list[Array]:
        size, last = self.system.plant.state.size, self.system.blocks.memory.size
        return [point[:size], point[size : point.size - last], point[point.size - last :]]


def _rows(at: Sequence[slice], *parts: int) -> list[int]:
    return [k for part in parts for k in range(at[part].start, at[part].stop)]


@once_per_system
def _block_slopes(system: System) -> list[tuple[ca.Function, ca.Function]]:
    """Return, for each instant, the derivatives of measured outputs and memory, and of plant inputs and memory.

    Those behind the sensors are by plant state, memory and disturbance; those behind the actuators by command first.
    """
    x, b, d, p, q, c = _block_symbols(system)
    by, mean, pairs = ca.vertcat(x, b, d), ca.SX(0, 1), []
    for k in range(system.blocks.instants):
        at = Instant(x, d, p, q, k=k)
        memory, _ = system.sensed(at, b, mean)
        y = system.held(system.plant.measurement(x, d, p), memory)
        sense = ca.Function("sense", [x, d, p, b, q], [ca.jacobian(y, by), ca.jacobian(memory, by)])
        f, memory, _ = system.driven(c, at, b, mean)
        every = ca.vertcat(c, by)
        drive = ca.Function("drive", [c, x, d, p, b, q], [ca.jacobian(f, every), ca.jacobian(memory, every)])
        pairs.append((sense, drive))
    return pairs


def _block_symbols(system: System) -> list[ca.SX]:
    sizes = {
        "x": system.plant.state.size, "b": system.blocks.memory.size, "d": system.plant.disturbances.size,
        "p": system.plant.parameters.size, "q": system.blocks.parameters.size, "c": system.commands.size,
    }  # fmt: skip
    return [ca.SX.sym(name, size) for name, size in sizes.items()]


@once_per_system
def _functions(system: System) -> dict[str, ca.Function]:
    """Return the functions of a system that `_Rest` evaluates; gains and parameters are arguments of them."""
    plant, controller = system.plant, system.controller
    law = law_function(controller)
    x, b, d, p, q, c = _block_symbols(system)
    y, r = ca.SX.sym("y", system.measurements.size), ca.SX.sym("r", system.references.size)
    mean = ca.SX(0, 1)
    at = Instant(x, d, p, q)
    behind, _ = system.sensed(at, b, mean)
    measure = ca.Function("measure", [x, d, p, b, q], [system.held(plant.measurement(x, d, p), behind), behind])
    inputs = ca.Function("inputs", [y, r], [system.inputs_of(y, r)])
    f, driven, _ = system.driven(c, at, b, mean)
    drive = ca.Function("drive", [c, x, d, p, b, q], [f, driven])
    rate = ca.Function("rate", [x, c, d, p, b, q], [plant.derivative(x, f, d, p)])
    X, Z, B = ca.MX.sym("x", plant.state.size), ca.MX.sym("z", controller.state.size), ca.MX.sym("b", b.numel())
    G, P, Q = ca.MX.sym("g", controller.gains.size), ca.MX.sym("p", plant.parameters.size), ca.MX.sym("q", q.numel())
    R, D = ca.MX.sym("r", system.references.size), ca.MX.sym("d", plant.disturbances.size)
    sensed, memory = measure(X, D, P, B, Q)
    command, after = law(Z, inputs(sensed, R), G)[:2]
    _, carried = drive(command, X, D, P, memory, Q)
    error = ca.vertcat(rate(X, command, D, P, memory, Q), after - Z, carried - B)
    point = ca.vertcat(X, Z, B)
    results = [error, ca.jacobian(error, point), command, ca.jacobian(command, point)]
    Y = ca.MX.sym("y", system.measurements.size)
    command, after = law(Z, inputs(Y, R), G)[:2]
    slopes = [ca.jacobian(out, by) for out in (after, command) for by in (Z, Y, R)]
    return {
        "measure": measure,
        "inputs": inputs,
        "drive": drive,
        "rate": rate,
        "control": law,
        "rest": ca.Function("rest", [X, Z, B, G, P, R, D, Q], results),
        "law": ca.Function("slopes", [Z, Y, R, G], slopes),
        "plant": _plant_slopes(plant),
        "reference": ca.Function("reference", [r], [system.reference_at(ca.SX(0), r)]),
        "disturbance": ca.Function("disturbance", [d], [system.disturbance_at(ca.SX(0), d)]),
    }


def law_function(controller: SampledController) -> ca.Function:
    """Return the function (x, u, p) → (command, next state, …) of a controller."""
    if not isinstance(controller, Controller) or not isinstance(controller.block, Program):  # a block with loops
        return to_casadi(controller.block)
    symbols = [
        ca.SX.sym(n, v.size)
        for n, v in zip("xup", (controller.state, controller.inputs, controller.gains), strict=True)
    ]
    return ca.Function(controller.name, symbols, list(controller.action(*symbols)))


def _loop_names(system: System) -> LoopNames:
    """Return the labels of all signals of a system."""
    plant, controller = system.plant, system.controller
    layouts = (plant.state, controller.state, plant.inputs, system.commands, system.measurements, system.references)
    labels: list[Any] = [tuple(entry_labels(layout)) for layout in (*layouts, plant.disturbances)]
    kinds = {
        "command": system.commands, "measured": system.measurements, "reference": system.references,
        "disturbance": plant.disturbances,
    }  # fmt: skip
    units = [
        (f"{kind}.{label}", unit)
        for kind, layout in kinds.items()
        for label, unit in zip(entry_labels(layout), entry_units(layout), strict=True)
    ]
    return replace(LoopNames(plant.name, controller.name, *labels), units=tuple(units))


def _place(labels: list[str], point: Array) -> str:
    shown = [f"{label} = {value + 0.0:.4g}" for label, value in zip(labels, point, strict=True)]
    return ", ".join(shown[:_SHOWN] + ["…"] * (len(shown) > _SHOWN))


def _state_labels(system: System) -> list[str]:
    memory = entry_labels(system.blocks.memory)
    return [*entry_labels(system.plant.state), *entry_labels(system.controller.state, "controller "), *memory]


def unresponsive(record: Record) -> dict[str, float]:
    """Return, by label of the command, the share of a run's control instants at which it does not respond.

    There its derivatives by all inputs and states of the controller are 0, such as at a limit; of a controller that
    contains a procedure, the command stays the same if any one of them changes. Commands that never depend on them are
    left out.
    """
    z, u, gains = (part.copy() for part in record.controller)
    labels, block = entry_labels(record.system.commands), record.system.controller.block
    if any(isinstance(inner, Procedure) for inner in nested(block).values()):
        sizes, depends = _changes(runnable(block), z, u, gains)[:, : len(labels)].T, [True] * len(labels)
    else:
        slopes, depends = _slopes(record.system)
        sizes = np.array(slopes.map(len(u))(z.T, u.T, np.tile(gains[:, None], len(u))))
    return {name: float(np.mean(row == 0.0)) for name, row, acts in zip(labels, sizes, depends, strict=True) if acts}


def idle_commands(system: System, loop: LinearLoop) -> list[str]:
    """Return the labels of the commands that do not respond at the point of a linear loop, see `unresponsive`."""
    blocks = nested(system.controller.block).values()
    depends = any(isinstance(inner, Procedure) for inner in blocks) or np.array(_slopes(system)[1])
    A, C, paths = loop.law[0], loop.law[3], [np.hstack(loop.law[4:]), np.hstack(loop.law[1:3])]
    for _ in range(len(A)):  # an input may reach a command by the states of the law alone
        paths[0], paths[1] = np.hstack([paths[0], C @ paths[1]]), A @ paths[1]
    still = ~np.any(paths[0], axis=1) & depends
    return [label for label, idle in zip(entry_labels(system.commands), still, strict=True) if idle]


def _changes(run: Callable[..., list[Array]], z: Array, u: Array, gains: Array) -> Array:
    """Return the sums of the changes of each command (n, commands) for a small change of each state and input.

    Derivatives of a procedure are those of the operations that it executes in Python, a thousand times slower.
    """
    p = np.tile(gains, (len(u), 1))
    before = run(z, u, p)[0]
    total = np.zeros_like(before)
    for part in (z, u):
        for column in part.T:
            own = column.copy()
            for step in (-_STEP, _STEP):
                column[:] = own + step * (1.0 + np.abs(own))
                total += np.abs(run(z, u, p)[0] - before)
            column[:] = own
    return total


@once_per_system
def _slopes(system: System) -> tuple[ca.Function, list[bool]]:
    # sum of the sizes of the derivatives of each command, and whether there are any
    controller = system.controller
    law = law_function(controller)
    z, u, p = (
        ca.SX.sym(n, v.size)
        for n, v in zip("zup", (controller.state, controller.inputs, controller.gains), strict=True)
    )
    J = ca.jacobian(law(z, u, p)[0], ca.vertcat(z, u))
    rows = set(J.sparsity().row())
    return ca.Function("slopes", [z, u, p], [ca.sum2(ca.fabs(J))]), [k in rows for k in range(J.shape[0])]
