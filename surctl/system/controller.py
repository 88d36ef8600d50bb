"""A sampled controller: one symbolic step with explicit state, and its guarded evaluation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir import Block, Layout, Port, Recording, identifier, runnable, without_libm
from surctl.system.parts import EMPTY, Parts, called, checked_layout, joined

__all__ = ["NONFINITE", "Action", "Controller", "ControllerStep", "SampledController"]

Vector = NDArray[np.float64]

_STATUS = Layout((Port("status", (1,), "1", "sum of bits"),))

NONFINITE = -2
"""Status of a step that had or gave a number that is not finite; its command is zero and its state unchanged."""


class Action(NamedTuple):
    """What a controller computes in one step, as named expressions.

    Attributes:
        command: each command port; for one port its expression is enough.
        state: each state port one period later.
        telemetry: each telemetry port.
        status: 0, or a sum of bits that the controller defines; never negative.
    """

    command: Any
    state: Any = ()
    telemetry: Any = ()
    status: Any = 0


class ControllerStep(NamedTuple):
    """The numbers of one step: command (m,), next state (n,), status and telemetry (k,)."""

    tau: Vector
    x_next: Vector
    status: int
    telemetry: Vector


class SampledController(Protocol):
    """What a closed loop needs of a controller; `Controller` and every built-in law have it."""

    @property
    def name(self) -> str:
        """C identifier."""

    @property
    def dt(self) -> float:
        """Control period [s]."""

    @property
    def state(self) -> Layout:
        """Layout of x."""

    @property
    def inputs(self) -> Layout:
        """Layout of u: measurements and references."""

    @property
    def gains(self) -> Layout:
        """Layout of p."""

    @property
    def outputs(self) -> Layout:
        """Layout of the commands, then of the telemetry."""

    @property
    def block(self) -> Block:
        """(x, u, p) → (command, x_next, status (1,), telemetry)."""

    def initial_state(self) -> Vector:
        """State before the first step."""

    def step(self, x: Vector, u: Vector, p: Vector) -> Any:
        """One guarded step: `tau`, `x_next`, `status`, `telemetry`."""


@dataclass(frozen=True, eq=False)
class Controller:
    """A control law (x, u, p) → (command, next state, status, telemetry), evaluated once every `dt`.

    Attributes:
        name: C identifier.
        dt: control period [s].
        inputs: ports of u. A port that the plant measures is fed by the plant; any other is a reference.
        command: ports of the actuator commands, named as the plant's inputs.
        law: (x, u, p), each a mapping from port name to CasADi SX, → `Action`, or the command alone.
        state: ports of x with their initial values as defaults.
        gains: ports of p with their nominal values as defaults.
        telemetry: ports of further outputs.

    Raises:
        InputError: a port without a unit, a period that is not positive, a law that does not return its ports, an
            operation that cannot be compiled, or a symbol that is no argument.

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
        if not (isinstance(self.dt, float | int) and np.isfinite(self.dt) and self.dt > 0):
            raise InputError("is not a positive time", key=f"{self.name}.dt", value=self.dt, remedy="give seconds")
        for name in ("inputs", "command", "state", "gains", "telemetry"):
            checked_layout(getattr(self, name), key=f"{self.name}.{name}")
        if not self.command.size:
            raise InputError("commands nothing", key=f"{self.name}.command", remedy="name the plant's inputs")
        _ = self.outputs, self.block  # what cannot be compiled is a mistake of this controller, so it is found here

    @cached_property
    def outputs(self) -> Layout:
        """The command ports, then the telemetry ports."""
        return Layout((*self.command, *self.telemetry))

    def action(self, x: ca.SX, u: ca.SX, p: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """(command, next state, status, telemetry), flat, for flat symbolic vectors."""
        parts, key = (self.state.split(x), self.inputs.split(u), self.gains.split(p)), f"{self.name}.law"
        result = called(self.law, *parts, key=key)
        act = result if isinstance(result, Action) else Action(result)
        return (
            joined(self.command, act.command, key=f"{key}.command"),
            joined(self.state, act.state if self.state.size else {}, key=f"{key}.state"),
            joined(_STATUS, act.status, key=f"{key}.status"),
            joined(self.telemetry, act.telemetry if self.telemetry.size else {}, key=f"{key}.telemetry"),
        )

    @cached_property
    def block(self) -> Block:
        """(x, u, p) → (tau, x_next, status, telemetry) as instructions; what runs and what is exported as C."""
        with Recording() as recording:
            layouts = {"x": self.state, "u": self.inputs, "p": self.gains}
            symbols = {name: ca.SX.sym(name, layout.size) for name, layout in layouts.items()}
            names = ("tau", "x_next", "status", "telemetry")
            results = dict(zip(names, self.action(*symbols.values()), strict=True))
            return without_libm(recording.block(self.name, symbols, results))

    def initial_state(self) -> Vector:
        """State before the first step."""
        return self.state.pack()

    def step(self, x: Any, u: Any, p: Any) -> ControllerStep:
        """One step. A number that is not finite, before or after, gives a zero command and `NONFINITE`.

        Raises:
            InputError: a vector of another size than its layout.
        """
        vectors = [np.asarray(v, dtype=float).reshape(-1) for v in (x, u, p)]
        for vector, layout, name in zip(vectors, (self.state, self.inputs, self.gains), "xup", strict=True):
            if vector.size != layout.size:
                raise InputError(f"has {vector.size} numbers, expected {layout.size}", key=f"{self.name}.{name}")
        if all(np.isfinite(vector).all() for vector in vectors):
            results = [np.asarray(part, dtype=float).reshape(-1) for part in self._run(*vectors)]
            if all(np.isfinite(part).all() for part in results):
                tau, after, status, telemetry = results
                return ControllerStep(tau, after, int(status[0]), telemetry)
        return ControllerStep(np.zeros(self.command.size), vectors[0].copy(), NONFINITE, np.zeros(self.telemetry.size))

    @cached_property
    def _run(self) -> Callable[..., list[Vector]]:
        return runnable(self.block)
