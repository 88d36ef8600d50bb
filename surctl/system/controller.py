"""A sampled controller: one symbolic step with explicit state; refused names, and numbers that are not finite."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate
from typing import Any, NamedTuple, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir import Block, Layout, Port, Recording, replay, without_libm
from surctl.ir.c99 import identifier
from surctl.ir.native import runnable
from surctl.system.parts import EMPTY, Parts, called, checked_layout, joined, not_finite
from surctl.units import as_numbers, is_number

Vector = NDArray[np.float64]

_STATUS = Layout((Port("status", (1,), "1", "sum of bits"),))

_RESERVED, _SHORTEST = "surctl_", 1e-9  # s

NONFINITE = -2
"""Status of a step that had or gave a number that is not finite; its command is zero and its state unchanged."""


class Action(NamedTuple):
    """Named expressions of the results that a controller computes in one step.

    Attributes:
        command: expression of each command by name; if there is only one command, its expression alone is enough.
        state: expression of each part of the state one control period later, by name.
        telemetry: expression of each telemetry output by name.
        status: expression of the status: 0, or a sum of bits that the controller defines; never negative.
    """

    command: Any
    state: Any = ()
    telemetry: Any = ()
    status: Any = 0


class ControllerStep(NamedTuple):
    """Results of one step of a controller: command (m,), next state (n,), status, and telemetry (k,).

    The status is a sum of bits (0 if no bit is set), or a negative error code. For a law of the robot, the command is
    the thrust (4,) in {B}: F_u, F_v, F_w [N] and F_r [N m].
    """

    tau: Vector
    x_next: Vector
    status: int
    telemetry: Vector


class SampledController(Protocol):
    """Interface of a controller: a step computes command, next state, status and telemetry from state, input and gains.

    Closed loops and the export use this interface; `Controller` and every built-in law implement it.
    """

    @property
    def name(self) -> str:
        """Return the name of the controller, a C identifier."""

    @property
    def dt(self) -> float:
        """Return the control period [s]."""

    @property
    def state(self) -> Layout:
        """Return the layout (names, sizes, units) of the controller state x (nx,)."""

    @property
    def inputs(self) -> Layout:
        """Return the layout (names, sizes, units) of the inputs u (nu,), which are measurements and references."""

    @property
    def gains(self) -> Layout:
        """Return the layout (names, sizes, units) of the gains p (np,)."""

    @property
    def outputs(self) -> Layout:
        """Return the layout (names, sizes, units) of the outputs: commands, then telemetry."""

    @property
    def block(self) -> Block:
        """Return the step as a program or routine that computes tau, x_next, status and telemetry from x, u and p.

        All arguments and results are flat vectors; the status has one entry.
        """

    def initial_state(self) -> Vector:
        """Return the controller state before the first step (nx,)."""

    def step(self, x: Vector, u: Vector, p: Vector) -> ControllerStep:
        """Run one step; if a number is not finite, the result is tau = 0, x_next = x and the status `NONFINITE`."""


@dataclass(frozen=True, eq=False)
class Controller:
    """A control law, evaluated once every `dt`.

    From state x, inputs u and gains p, the law computes the command, the next state, a status and telemetry. Each
    vector consists of ports, that is, of named parts with size and unit.

    Attributes:
        name: C identifier.
        dt: control period [s].
        inputs: ports of the inputs u. An input with the name of a measured output of the plant receives this output;
            every other input is a reference.
        command: ports of the actuator commands, with the names of the plant's inputs.
        law: function of x, u and p that returns an `Action`, or the command alone; x, u and p are mappings from port
            name to CasADi SX.
        state: ports of the controller state x, with initial values as defaults.
        gains: ports of the gains p, with nominal values as defaults.
        telemetry: ports of further outputs.

    Raises:
        InputError: a port has no unit, the period is not positive, the law does not return all ports, an operation
            cannot be compiled, or the law uses a CasADi symbol that is not one of its arguments.

    Example:
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Action, Controller
        >>> integral = Controller(
        ...     "integral_control",
        ...     dt=0.1,
        ...     inputs=Layout((Port("level", (1,), "m", "measured"), Port("target", (1,), "m", "reference"))),
        ...     command=Layout((Port("flow", (1,), "m^3/s", "into the tank"),)),
        ...     state=Layout((Port("sum", (1,), "m s", "integral of the error"),)),
        ...     gains=Layout((Port("k_i", (1,), "m^2/s^2", "integral gain", 0.5),)),
        ...     law=lambda x, u, p: Action(p["k_i"] * x["sum"], {"sum": x["sum"] + 0.1 * (u["target"] - u["level"])}),
        ... )
        >>> integral.step([0.2], [1.0, 2.0], [0.5])
        ControllerStep(tau=array([0.1]), x_next=array([0.3]), status=0, telemetry=array([], dtype=float64))
    """

    name: str
    dt: float
    inputs: Layout
    command: Layout
    law: Callable[[Parts, Parts, Parts], Any] = field(repr=False)
    state: Layout = EMPTY
    gains: Layout = EMPTY
    telemetry: Layout = EMPTY

    def __post_init__(self) -> None:
        identifier(self.name)
        if self.name.startswith(_RESERVED):
            problem = f"begins with {_RESERVED}, as the names of the built-in laws do"
            raise InputError(problem, key="name", value=self.name, remedy="choose another name")
        if not is_number(self.dt) or self.dt < _SHORTEST:
            remedy = f"give seconds, at least {_SHORTEST:g}"
            raise InputError("is not a control period", key=f"{self.name}.dt", value=self.dt, remedy=remedy)
        object.__setattr__(self, "dt", float(self.dt))
        for name in ("inputs", "command", "state", "gains", "telemetry"):
            checked_layout(getattr(self, name), key=f"{self.name}.{name}")
        if not self.command.size:
            raise InputError("commands nothing", key=f"{self.name}.command", remedy="name the plant's inputs")
        _ = self.outputs, self.block  # a law that cannot be compiled is reported when the controller is created

    @cached_property
    def outputs(self) -> Layout:
        """Return the layout of the outputs: command ports, then telemetry ports."""
        return Layout((*self.command, *self.telemetry))

    def action(self, x: ca.SX, u: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Return command, next state, status and telemetry as flat symbolic vectors, from flat symbolic x, u and p."""
        parts, key = (self.state.split(x), self.inputs.split(u), self.gains.split(p)), f"{self.name}.law"
        result = called(self.law, *parts, key=key)
        act = result if isinstance(result, Action) else Action(result)
        status = joined(_STATUS, act.status, key=f"{key}.status")
        if status.is_constant() and float(status) < 0:
            remedy = "return 0 or a sum of bits; negative codes are those of failed steps"
            raise InputError("is negative", key=f"{key}.status", value=float(status), remedy=remedy)
        return (
            joined(self.command, act.command, key=f"{key}.command"),
            joined(self.state, act.state if self.state.size else {}, key=f"{key}.state"),
            status,
            joined(self.telemetry, act.telemetry if self.telemetry.size else {}, key=f"{key}.telemetry"),
        )

    @cached_property
    def block(self) -> Block:
        """Return the step as a list of instructions, which is run in Python and exported as C.

        The instructions compute tau, x_next, status and telemetry from x, u and p.
        """
        with Recording() as recording:
            layouts = {"x": self.state, "u": self.inputs, "p": self.gains}
            symbols = {name: ca.SX.sym(name, layout.size) for name, layout in layouts.items()}
            names = ("tau", "x_next", "status", "telemetry")
            results = dict(zip(names, self.action(*symbols.values()), strict=True))
            return without_libm(recording.block(self.name, symbols, results))

    def initial_state(self) -> Vector:
        """Return the controller state before the first step."""
        return self.state.pack()

    def step(self, x: Any, u: Any, p: Any) -> ControllerStep:
        """Run one step; an argument or result that is not finite gives a zero command and the status `NONFINITE`.

        Raises:
            InputError: the size of a vector differs from its layout.
        """
        return finite_step(self, self._run, *step_vectors(self, x, u, p))

    @cached_property
    def _run(self) -> Callable[..., list[Vector]]:
        return runnable(self.block)


def step_vectors(controller: SampledController, x: Any, u: Any, p: Any) -> list[Vector]:
    """Return the arguments of a step as vectors of the sizes of their layouts, or raise InputError."""
    vectors, layouts = [], (controller.state, controller.inputs, controller.gains)
    for name, layout, value in zip("xup", layouts, (x, u, p), strict=True):
        key = f"{controller.name}.{name}"
        vectors.append(as_numbers(value, key=key).reshape(-1))
        if vectors[-1].size != layout.size:
            raise InputError(f"has {vectors[-1].size} numbers, expected {layout.size}", key=key)
    return vectors


def finite_step(
    controller: SampledController, run: Callable[..., Sequence[Any]], x: Vector, u: Vector, p: Vector
) -> ControllerStep:
    """Return the step that `run` computes; a number that is not finite gives a zero command and `NONFINITE`."""
    if all(np.isfinite(vector).all() for vector in (x, u, p)):
        results = [np.asarray(part, dtype=float).reshape(-1) for part in run(x, u, p)]
        if all(np.isfinite(part).all() for part in results):
            tau, after, status, telemetry = results
            return ControllerStep(tau, after, int(status[0]), telemetry)
    size = command_ports(controller).size
    return ControllerStep(np.zeros(size), np.array(x, dtype=float), NONFINITE, np.zeros(controller.outputs.size - size))


def command_ports(controller: SampledController) -> Layout:
    """Return the layout of the commands, which are the first outputs of a controller."""
    size, ends = controller.block.outputs[0][1], accumulate(port.size for port in controller.outputs)
    return Layout(tuple(port for port, end in zip(controller.outputs, ends, strict=True) if end <= size))


def step_results(controller: SampledController) -> tuple[tuple[str, Layout], ...]:
    """Return kind and layout of the four results of a step: command, next state, status and telemetry."""
    commands = command_ports(controller)
    telemetry = Layout(tuple(port for port in controller.outputs if port.name not in commands))
    return ("command", commands), ("next state", controller.state), ("status", _STATUS), ("telemetry", telemetry)


def lost_entry(controller: SampledController, x: Vector, u: Vector, p: Vector) -> str:
    """Return the name of the first number of a step that is not finite, such as "command force[1]".

    Arguments (state, inputs, gains) come before results; the text is empty if all numbers are finite.
    """
    kinds, layouts = ("controller state", "input", "gain"), (controller.state, controller.inputs, controller.gains)
    if lost := not_finite(zip(kinds, layouts, (x, u, p), strict=True)):
        return lost
    results = replay(controller.block, x, u, p)
    return not_finite((kind, layout, v) for (kind, layout), v in zip(step_results(controller), results, strict=True))
