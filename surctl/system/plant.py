"""A plant, defined by ordinary differential equations whose states, inputs and parameters have names and units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca

from surctl.errors import InputError
from surctl.ir import Block, Layout, Recording, without_libm
from surctl.ir.c99 import identifier
from surctl.system.parts import EMPTY, Parts, called, checked_layout, joined


def runge_kutta(rate: Callable[..., Any], x: Any, h: float | ca.SX, late: ca.SX | float = 0.0) -> Any:
    """Return x after a fourth-order Runge-Kutta step of h [s], with the rate of x and of the time `late` [s] before it.

    The states are CasADi expressions or arrays.
    """
    k1 = rate(x, late)
    k2 = rate(x + h / 2 * k1, late + h / 2)
    k3 = rate(x + h / 2 * k2, late + h / 2)
    k4 = rate(x + h * k3, late + h)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


@dataclass(frozen=True, eq=False)
class Plant:
    """Continuous dynamics x' = ode(x, f, d, p) with measured outputs y = measure(x, d, p).

    Each vector consists of ports, that is, of named parts with size and unit.

    Attributes:
        name: C identifier.
        state: ports of the plant state x.
        inputs: ports of the actuator commands f, which are constant over a control period.
        ode: function of x, f, d and p that returns the time derivative of each state port; the arguments are mappings
            from port name to CasADi SX.
        parameters: ports of the parameters p; the defaults of the ports are the nominal values.
        disturbances: ports of the disturbances d, which are zero unless a run sets them.
        outputs: ports of the outputs y that a controller can measure; by default the state.
        measure: function of x, d and p that returns each port of `outputs`; required if `outputs` is given.

    Raises:
        InputError: a port has no unit, a function does not return all its ports, an operation cannot be compiled, or a
            function uses a CasADi symbol that is not one of its arguments.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Plant
        >>> pendulum = Plant(
        ...     "pendulum",
        ...     state=Layout((Port("angle", (1,), "rad", "from upright"), Port("rate", (1,), "rad/s", "angular rate"))),
        ...     inputs=Layout((Port("torque", (1,), "N m", "at the pivot"),)),
        ...     parameters=Layout((Port("gravity", (1,), "1/s^2", "g / l", 9.81),)),
        ...     ode=lambda x, f, d, p: {
        ...         "angle": x["rate"], "rate": p["gravity"] * ca.sin(x["angle"]) + f["torque"]
        ...     },
        ... )
        >>> pendulum.function([0.1, 0.2], [0.0], [], [9.81])
        DM([0.2, 0.979366])
    """

    name: str
    state: Layout
    inputs: Layout
    ode: Callable[[Parts, Parts, Parts, Parts], Any] = field(repr=False)
    parameters: Layout = EMPTY
    disturbances: Layout = EMPTY
    outputs: Layout = EMPTY
    measure: Callable[[Parts, Parts, Parts], Any] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        identifier(self.name)
        for name in ("state", "inputs", "parameters", "disturbances", "outputs"):
            checked_layout(getattr(self, name), key=f"{self.name}.{name}")
        if not self.state.size:
            raise InputError("has no state", key=self.name, remedy="name the states in a Layout")
        if (self.measure is None) != (self.outputs.size == 0):
            lacks, other = ("measure", "outputs") if self.measure is None else ("outputs", "measure")
            raise InputError(f"is missing beside {other}", key=f"{self.name}.{lacks}", remedy="give both, or none")
        _ = self.block, self.measured  # a plant that cannot be compiled is reported when it is created

    @property
    def measurements(self) -> Layout:
        """Return the layout of the measured outputs y, which is `outputs`, or the state if `outputs` is not given."""
        return self.state if self.measure is None else self.outputs

    def derivative(self, x: ca.SX, f: ca.SX, d: ca.SX, p: ca.SX) -> ca.SX:
        """Return the time derivative x' (n, 1) of the state for flat symbolic vectors."""
        parts = self.state.split(x), self.inputs.split(f), self.disturbances.split(d), self.parameters.split(p)
        key = f"{self.name}.ode"
        return joined(self.state, called(self.ode, *parts, key=key), key=key)

    def measurement(self, x: ca.SX, d: ca.SX, p: ca.SX) -> ca.SX:
        """Return the measured outputs y (m, 1) for flat symbolic vectors."""
        if self.measure is None:
            return x
        parts, key = (self.state.split(x), self.disturbances.split(d), self.parameters.split(p)), f"{self.name}.measure"
        return joined(self.measurements, called(self.measure, *parts, key=key), key=key)

    @cached_property
    def block(self) -> Block:
        """Return the computation of x' from x, f, d and p as a list of instructions.

        The instructions do not call functions of the C library, such as sin.
        """
        with Recording() as recording:
            symbols = self._symbols()
            rates = self.derivative(*symbols.values())
            if rates.is_constant() and not rates.is_zero():
                remedy = "compute the time derivatives from the states and inputs"
                raise InputError("returns numbers, which depend on no argument", key=f"{self.name}.ode", remedy=remedy)
            return without_libm(recording.block(self.name, symbols, {"xdot": rates}))

    @cached_property
    def measured(self) -> Block:
        """Return the computation of y from x, d and p as a list of instructions.

        The instructions do not call functions of the C library, such as sin.
        """
        with Recording() as recording:
            symbols = {name: symbol for name, symbol in self._symbols().items() if name != "f"}
            outputs = {"y": self.measurement(*symbols.values())}
            return without_libm(recording.block(f"{self.name}_measured", symbols, outputs))

    @cached_property
    def function(self) -> ca.Function:
        """Return the CasADi function that computes x' from x, f, d and p.

        It accepts numbers and expressions, and CasADi can differentiate it exactly.
        """
        symbols = self._symbols()
        return ca.Function(
            self.name, list(symbols.values()), [self.derivative(*symbols.values())], list(symbols), ["xdot"]
        )

    def digest(self) -> str:
        """Return the SHA-256 of the plant's computations: dynamics and measurement."""
        return f"{self.block.digest()}{self.measured.digest()}"

    def _symbols(self) -> dict[str, ca.SX]:
        layouts = {"x": self.state, "f": self.inputs, "d": self.disturbances, "p": self.parameters}
        return {name: ca.SX.sym(name, layout.size) for name, layout in layouts.items()}
