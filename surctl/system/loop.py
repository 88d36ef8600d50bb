"""The closed loop (`System`): connection by names and units, costs, stops, and mistakes refused at its creation."""

from __future__ import annotations

import difflib
import hashlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TypeVar, cast, get_args
from weakref import WeakKeyDictionary

import casadi as ca

from surctl.errors import InputError, mistakes_in, nearest
from surctl.files import Mistakes
from surctl.ir import Layout, Port, Recording
from surctl.ir.c99 import identifier
from surctl.system.controller import SampledController, command_ports, step_results
from surctl.system.parts import Parts, called, joined
from surctl.system.plant import Plant
from surctl.system.sampled import CLOCK, Blocks, Instant, Sampled, connected
from surctl.units import as_range, is_number

_FIGURE = Layout((Port("value", (1,), "1", "a figure"),))

_MISSPELT = 0.75  # similarity of two names from which one is taken for a slip of the other
_MOST = 1000  # steps of integration in a control period

ENDED, LOST = "time", "not finite"
"""Why a run ended, where no stop of the system ended it: its time was over, or a number was no longer finite."""

How = Literal["integral", "mean", "rms", "max", "min", "final", "last_time"]


class Signals(NamedTuple):
    """The signals of the loop at one control instant; all but the time t are mappings from name to CasADi SX.

    Attributes:
        x: plant state.
        f: actuator command that is applied from this control instant on.
        y: measured outputs, behind the sensors.
        r: references.
        d: disturbances.
        p: plant parameters.
        g: gains of the controller.
        k: telemetry of the controller.
        t: time since the start [s].
    """

    x: Parts
    f: Parts
    y: Parts
    r: Parts
    d: Parts
    p: Parts
    g: Parts
    k: Parts
    t: ca.SX


@dataclass(frozen=True)
class Cost:
    """One metric of a run: an expression of the signals, and how its values at the control instants become one number.

    Attributes:
        of: function that returns a scalar expression of the signals (`Signals`).
        how: how the values over a run become one number. `integral` is their sum times the period, without
            the instant at which a stop ends the run. `mean`, `rms`, `max` and `min` have their usual meaning. `final`
            is the value at the last control instant. `last_time` is the last time [s] at which the expression is
            positive, or 0 if the expression is never positive. So the `last_time` of an error minus its tolerance is a
            settling time.
        unit: SI unit of the metric.
        meaning: description of the metric, for tables and plots.
        at_most: upper bound of the metric, which tuned gains must satisfy (see `surctl.tuning.tune_system`), or None.
    """

    of: Callable[[Signals], Any]
    how: How
    unit: str
    meaning: str = ""
    at_most: float | None = None


@dataclass(frozen=True, eq=False)
class System:
    """A plant under a sampled controller, with references, disturbances, metrics and reasons to stop a run.

    Signals are connected by name: a controller input with the name of a measured plant output, or of an output of a
    sensor, receives this output, and every other controller input is a reference; each plant input receives the
    command, or the output of an actuator, of its name. Shapes and units of connected signals must agree.

    Attributes:
        plant: continuous dynamics and measured outputs.
        controller: controller that is evaluated once a control period; its command is held for this period.
        substeps: number of fourth-order Runge-Kutta steps in a control period; at least one is taken between two
            samples of sensors or actuators.
        costs: metrics of a run by name.
        stops: failures that end a run, by name, such as a fall; each is a function that returns an expression of the
            signals (`Signals`), and a run ends when this expression is not 0. The bound of a cost states a goal.
        reference: function that returns each reference at time t [s] from t and constants r, which a run sets; by
            default the references are r.
        disturbance: function that returns each disturbance at time t [s] from t and constants d, which a run sets; by
            default the disturbances are d.
        ranges: lower and upper bound of uncertain numbers by name (see `run_numbers`), such as `plant.mass`; margins
            are judged at every corner of them.
        duration: duration of a run [s] for commands that state none, or None.
        within: lower and upper bound of each state, by name: the box in which `surctl verify` and `study` prove a
            region of attraction if the command line states none.
        limits: lower and upper limit of states, commands or references by name, which plots of a run show.
        sensors, actuators: sampled blocks between plant and controller, in their order.

    Raises:
        InputError: a port is not connected, or is connected to a port of another shape or unit; a duration, bound or
            limit is not a finite number, or bounds are reversed.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Controller, Cost, Plant, System, simulate_system
        >>> level, target = Port("level", (1,), "m", "of the water"), Port("target", (1,), "m", "desired level", 1.0)
        >>> flow = Port("flow", (1,), "m/s", "inflow over the area")
        >>> tank = Plant(
        ...     "tank", state=Layout((level,)), inputs=Layout((flow,)),
        ...     ode=lambda x, f, d, p: {"level": f["flow"] - 0.1 * x["level"]},
        ... )
        >>> law = Controller(
        ...     "proportional", dt=0.1, inputs=Layout((level, target)), command=Layout((flow,)),
        ...     gains=Layout((Port("k", (1,), "1/s", "gain", 0.9),)),
        ...     law=lambda x, u, p: p["k"] * (u["target"] - u["level"]),
        ... )
        >>> error = Cost(lambda s: s.r["target"] - s.x["level"], "final", "m", "error at the end")
        >>> runs = simulate_system(System(tank, law, costs={"error": error}), 20.0, {"k": [0.9, 1.9]})
        >>> runs["error"].round(3)
        array([0.1 , 0.05])
    """

    plant: Plant
    controller: SampledController
    substeps: int = 4
    costs: Mapping[str, Cost] = field(default_factory=dict)
    stops: Mapping[str, Callable[[Signals], Any]] = field(default_factory=dict)
    reference: Callable[[ca.SX, Parts], Any] | None = field(default=None, repr=False)
    disturbance: Callable[[ca.SX, Parts], Any] | None = field(default=None, repr=False)
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    sensors: Sequence[Sampled] = ()
    actuators: Sequence[Sampled] = ()
    duration: float | None = None
    within: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for key, part, attribute, remedy in (
            ("plant", self.plant, "ode", "give a surctl.system.Plant"),
            ("controller", self.controller, "block", "give a surctl.system.Controller"),
        ):
            if isinstance(part, type) or not hasattr(part, attribute):
                raise InputError(f"is of type {type(part).__name__}", key=key, remedy=remedy)
        if not is_number(self.substeps) or self.substeps not in range(1, _MOST + 1):
            remedy = f"give a whole number from 1 to {_MOST}"
            raise InputError("is not a number of steps", key="substeps", value=self.substeps, remedy=remedy)
        object.__setattr__(self, "substeps", int(self.substeps))
        tables = [(kind, getattr(self, kind)) for kind in ("costs", "stops", "ranges", "within", "limits")]
        for kind, table in tables:
            if not isinstance(table, Mapping):
                remedy = 'write {"name": …}'
                raise InputError(f"is of type {type(table).__name__}", key=kind, remedy=remedy)
            for name in table if kind in ("costs", "stops") else ():
                identifier(name)
            object.__setattr__(self, kind, MappingProxyType(dict(table)))
        self._check_blocks()
        layouts = (self.plant.state, self.measurements, self.commands, self.controller.inputs, self.controller.gains)
        named = {port.name for layout in layouts for port in layout}
        if ENDED in self.stops:
            remedy = "choose another name for the stop"
            raise InputError("is the reason of a run that reaches its duration", key=f"stops.{ENDED}", remedy=remedy)
        self._check_names()
        shown = {port.name for layout in (self.plant.state, self.commands, self.references) for port in layout}
        driving, to = connected(self.commands, *self.blocks.outputs["actuators"]), f"command of {self.controller.name}"
        mistakes = Mistakes()
        for name, cost in self.costs.items():
            with mistakes.collected():
                _check_cost(name, cost)
                if name in named:
                    remedy = "choose another name for the cost"
                    raise InputError("is a signal or a gain of the system", key=f"costs.{name}", remedy=remedy)
                if str(cost.how) not in get_args(How):
                    remedy = nearest(str(cost.how), get_args(How))
                    raise InputError("is not known", key=f"costs.{name}.how", value=cost.how, remedy=remedy)
        if self.duration is not None:
            with mistakes.collected(), mistakes_in(None, "duration"):
                periods(self, self.duration)
        for kind in ("limits", "ranges", "within"):
            for name, ends in getattr(self, kind).items():
                with mistakes.collected():
                    key = f"{kind}.{name}"
                    if kind == "limits" and name not in shown:
                        raise InputError("is no signal of a run", key=key, remedy=nearest(name, sorted(shown)))
                    low, high = as_range(ends, key=key)
                    if kind == "limits" and low == high:
                        raise InputError("is empty", key=key, value=ends, remedy="write such as (-1, 1)")
        for port in self.plant.inputs:
            with mistakes.collected():
                _connected(port, driving, key=f"{self.plant.name}.inputs", to=to)
        for port in self.controller.inputs:
            if port.name in self.measurements:
                with mistakes.collected():
                    _connected(port, self.measurements, key=f"{self.controller.name}.inputs", to="measured output")
        mistakes.check()
        self._warn_of_misspelt_inputs()
        self._check_compiles()

    @cached_property
    def commands(self) -> Layout:
        """Return the layout of the controller's commands; the plant uses those with the names of its inputs."""
        return command_ports(self.controller)

    @cached_property
    def telemetry(self) -> Layout:
        """Return the layout of the telemetry of the controller."""
        return step_results(self.controller)[-1][1]

    @cached_property
    def references(self) -> Layout:
        """Return the layout of the references, which are the controller inputs that nothing measures."""
        return Layout(tuple(port for port in self.controller.inputs if port.name not in self.measurements))

    @cached_property
    def blocks(self) -> Blocks:
        """Return the sampled blocks: sensors and actuators."""
        return Blocks(tuple(self.sensors), tuple(self.actuators), self.dt)

    @cached_property
    def measurements(self) -> Layout:
        """Return the layout of the measured outputs behind the sensors; the plant's if there are none."""
        return connected(self.plant.measurements, *self.blocks.outputs["sensors"])

    @property
    def title(self) -> str:
        """Return the names of plant and controller as text."""
        return f"{self.plant.name} under {self.controller.name}"

    @property
    def dt(self) -> float:
        """Return the control period [s]."""
        return self.controller.dt

    def reference_at(self, t: ca.SX, r: ca.SX) -> ca.SX:
        """Return the flat references at time t for the constants r of a run."""
        if self.reference is None:
            return r
        returned = called(self.reference, t, self.references.split(r), key="reference")
        return joined(self.references, returned, key="reference")

    def disturbance_at(self, t: ca.SX, d: ca.SX) -> ca.SX:
        """Return the flat disturbances at time t for the constants d of a run."""
        if self.disturbance is None:
            return d
        returned = called(self.disturbance, t, self.plant.disturbances.split(d), key="disturbance")
        return joined(self.plant.disturbances, returned, key="disturbance")

    def inputs_of(self, y: ca.SX, r: ca.SX) -> ca.SX:
        """Return the flat inputs of the controller from measured outputs and references."""
        measured, references = self.measurements.split(y), self.references.split(r)
        return self.controller.inputs.join(
            {**references, **{n: v for n, v in measured.items() if n in self.controller.inputs}}
        )

    def held(self, y: ca.SX, memory: ca.SX) -> ca.SX:
        """Return the flat measured outputs behind the sensors, from the plant's and the memory of all blocks."""
        behind, parts = self.plant.measurements.split(y), self.blocks.memory.split(memory)
        for block in self.blocks.sensors:
            behind |= {port.name: parts[f"{block.name}.{port.name}"] for port in block.outputs}
        return self.measurements.join(behind)

    def sensed(self, at: Instant, memory: ca.SX, noise: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the memory of all blocks and the noise generator's state after the sensors of an instant.

        All vectors are flat; see `Blocks.sampled`.
        """
        y = self.plant.measurements.split(self.plant.measurement(at.x, at.d, at.p))
        return self.blocks.sampled("sensors", at, y, memory, noise)[1:]

    def driven(self, command: ca.SX, at: Instant, memory: ca.SX, noise: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return the flat inputs of the plant behind the actuators of an instant, the memory and the noise's state."""
        signals = self.commands.split(command)
        if self.blocks.actuators:
            signals = self.plant.measurements.split(self.plant.measurement(at.x, at.d, at.p)) | signals
        behind, memory, noise = self.blocks.sampled("actuators", at, signals, memory, noise)
        return self.plant.inputs.join({port.name: behind[port.name] for port in self.plant.inputs}), memory, noise

    def _symbols(self) -> dict[str, ca.SX]:
        sizes = {
            "x": self.plant.state.size, "f": self.commands.size, "d": self.plant.disturbances.size,
            "r": self.references.size, "p": self.plant.parameters.size, "g": self.controller.gains.size,
            "k": self.telemetry.size, "t": 1, "b": self.blocks.memory.size,
        }  # fmt: skip
        return {name: ca.SX.sym(name, size) for name, size in sizes.items()}

    def _warn_of_misspelt_inputs(self) -> None:
        """Warn of a reference whose name is nearly that of a measured output which no input receives."""
        layouts = [self.controller.inputs, *(block.inputs for block in self.blocks.all)]
        read = {port.name for layout in layouts for port in layout}
        free = [port.name for port in self.measurements if port.name not in read]
        for port in self.references:
            for name in difflib.get_close_matches(port.name, free, n=1, cutoff=_MISSPELT):
                if port.unit == self.measurements.port(name).unit:
                    text = f"{self.controller.name}.inputs.{port.name}: is a reference, because nothing measures it"
                    warnings.warn(f"{text}; did you mean {name!r}?", stacklevel=3)

    def _check_blocks(self) -> None:
        """Raise InputError if a sensor or actuator is no block, or an input of it is not connected."""
        for kind, blocks in (("sensors", self.sensors), ("actuators", self.actuators)):
            if not isinstance(cast(object, blocks), Sequence):
                raise InputError(f"is of type {type(blocks).__name__}", key=kind, remedy="write (block,)")
            for block in blocks:
                if not isinstance(cast(object, block), Sampled):
                    remedy = "give a surctl.system.Sampled"
                    raise InputError(f"has an element of type {type(block).__name__}", key=kind, remedy=remedy)
        measured, commanded = [CLOCK, self.plant.measurements], [CLOCK, self.plant.measurements, self.commands]
        for blocks, layouts, to in (
            (self.blocks.sensors, measured, "measured output"),
            (self.blocks.actuators, commanded, "command or measured output"),
        ):
            for block in blocks:
                for port in block.inputs:
                    _connected(port, connected(*layouts), key=f"{block.name}.inputs", to=to)
                layouts.append(block.outputs)

    def _check_names(self) -> None:
        """Raise InputError if two signals of a record have one name; a measured output may have that of its state."""
        kinds: dict[str, str] = {}
        for kind, layout in (
            ("state", self.plant.state), ("command", self.commands), ("measured output", self.measurements),
            ("reference", self.references), ("telemetry output", self.telemetry),
        ):  # fmt: skip
            for port in layout:
                other = kinds.setdefault(port.name, kind)
                if other != kind and (other, kind) != ("state", "measured output"):
                    raise InputError(f"is the name of a {other} and of a {kind}", key=port.name, remedy="rename one")

    def _check_compiles(self) -> None:
        """Raise InputError if a function of the system cannot be compiled; the key of the error names this function."""
        symbols = self._symbols()
        with Recording() as recording:
            costs, stops = self.evaluated(**symbols)
            functions = {
                "reference": self.reference_at(symbols["t"], symbols["r"]),
                "disturbance": self.disturbance_at(symbols["t"], symbols["d"]),
                **{f"costs.{name}": costs[k] for k, name in enumerate(self.costs)},
                **{f"stops.{name}": stops[k] for k, name in enumerate(self.stops)},
            }
            for key, expression in functions.items():
                with mistakes_in(None, key):
                    recording.block("value", symbols, {"value": expression})

    def evaluated(
        self, *, x: ca.SX, f: ca.SX, d: ca.SX, r: ca.SX, p: ca.SX, g: ca.SX, k: ca.SX, t: ca.SX, b: ca.SX
    ) -> tuple[ca.SX, ca.SX]:
        """Return expressions of all costs and of all stops for flat symbolic signals; d and r are constant in a run."""
        late_d, late_r = self.disturbance_at(t, d), self.reference_at(t, r)
        y = self.held(self.plant.measurement(x, late_d, p), b)
        signals = Signals(
            self.plant.state.split(x), self.commands.split(f), self.measurements.split(y),
            self.references.split(late_r), self.plant.disturbances.split(late_d), self.plant.parameters.split(p),
            self.controller.gains.split(g), self.telemetry.split(k), t,
        )  # fmt: skip
        costs = [_scalar(called(c.of, signals, key=f"costs.{n}"), f"costs.{n}") for n, c in self.costs.items()]
        stops = [_scalar(called(s, signals, key=f"stops.{n}"), f"stops.{n}") for n, s in self.stops.items()]
        return ca.vertcat(ca.SX(0, 1), *costs), ca.vertcat(ca.SX(0, 1), *stops)

    def digest(self) -> str:
        """Return the SHA-256 of the loop's computations: plant, controller, period and integration."""
        text = f"{self.plant.digest()} {self.controller.block.digest()} {float(self.dt).hex()} {self.substeps}"
        for block in self.blocks.all:
            text += f" {block.block.digest()} {float(block.period or self.dt).hex()}"
        return hashlib.sha256(text.encode()).hexdigest()


def periods(system: System, seconds: float) -> int:
    """Return the number of control periods in a duration in seconds.

    Raises:
        InputError: the duration is not a positive number, or is less than half a period.

    Example:
        >>> from surctl.system import periods
        >>> from surctl.testing import cart_system
        >>> periods(cart_system(), 2.0)
        20
    """
    steps = round(seconds / system.dt) if is_number(seconds) and is_number(seconds / system.dt) else 0
    if steps < 1:
        remedy = f"give at least a period, {system.dt:g} s"
        raise InputError("is not a duration of a run", key="seconds", value=seconds, remedy=remedy)
    return steps


T = TypeVar("T")


def once_per_system(build: Callable[[System], T]) -> Callable[[System], T]:
    """Return a function that calls `build` once for each system and stores the result as long as the system exists."""
    results: WeakKeyDictionary[System, T] = WeakKeyDictionary()

    def result(system: System) -> T:
        if system not in results:
            results[system] = build(system)
        return results[system]

    return result


def _connected(port: Port, layout: Layout, *, key: str, to: str) -> None:
    if port.name not in layout:
        known = [other.name for other in layout]
        raise InputError(f"is no {to}", key=f"{key}.{port.name}", remedy=nearest(port.name, known))
    other = layout.port(port.name)
    if port.size != other.size:
        raise InputError(
            f"has {port.size} entries, the {to} {other.size}", key=f"{key}.{port.name}", remedy="match them"
        )
    if port.unit.replace(" ", "") != other.unit.replace(" ", ""):
        raise InputError(
            f"is in {port.unit}, the {to} in {other.unit}", key=f"{key}.{port.name}", remedy="use one unit for both"
        )


def _check_cost(name: str, cost: object) -> None:
    """Raise InputError if a metric has no expression, no unit, or a bound that is no number."""
    key = f"costs.{name}"
    if not isinstance(cost, Cost):
        raise InputError(f"is of type {type(cost).__name__}", key=key, remedy="give a surctl.system.Cost")
    if not isinstance(cast("object", cost.unit), str) or not cost.unit.strip():
        raise InputError("has no unit", key=key, remedy='name it in SI, "1" if it has none')
    bound = cost.at_most
    if bound is not None and not is_number(bound):
        raise InputError("is not a number", key=f"{key}.at_most", value=bound, remedy=f"give a bound in {cost.unit}")


def _scalar(value: Any, key: str) -> ca.SX:
    return joined(_FIGURE, value, key=key)
