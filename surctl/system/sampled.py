"""Sampled sensors and actuators of a loop: memory, noise, own period; messages that are late or lost."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple

import casadi as ca

from surctl.errors import InputError
from surctl.ir import Block, Layout, Port, Recording, without_libm
from surctl.ir.c99 import identifier
from surctl.noise import NOISE_STATE, draw_normals, draw_uniforms, remainder
from surctl.system.parts import EMPTY, Parts, called, checked_layout, joined
from surctl.units import is_number

CLOCK = Layout((Port("time", (1,), "s", "time since the start"),))
"""What every block can read, unless a signal of the loop has this name."""

Side = Literal["sensors", "actuators"]

_MOST = 1000  # samples in a control period, and control periods between two samples
_NEAR = 1e-6  # of a whole number
_RESERVED = ("gains", "plant", "reference", "disturbance", "start", "seed")


@dataclass(frozen=True, eq=False)
class Sampled:
    """A sampled block between plant and controller: a sensor, an actuator, a message, or a monitor of the run.

    A sample computes the block's outputs, which are held until the next sample, and its state.

    Attributes:
        name: C identifier; `NAME.PARAMETER` names a parameter of the block in a run.
        inputs: ports that the block reads at a sample. Those of a sensor are measured outputs of the plant or outputs
            of an earlier sensor; those of an actuator are commands, outputs of an earlier actuator, or measured
            outputs of the plant. Each can also be `time`, the time since the start [s].
        outputs: ports of the outputs; their defaults are the values before the first sample. An output hides a signal
            of its name from all that reads it later.
        step: function of x, u, p and w that returns each port of `state` and `outputs` after the sample; x holds these
            ports before it, u the inputs, p the parameters and w the random numbers, as mappings from name to SX.
        state: ports of the memory, with initial values as defaults.
        parameters: ports of the parameters, with nominal values as defaults.
        normal: ports of independent standard normal random numbers, which are new at every sample.
        uniform: ports of independent random numbers, uniform in (0, 1), which are new at every sample.
        period: time between two samples [s]: the control period (default), a whole fraction or a multiple of it.

    Raises:
        InputError: a port has no unit, the function does not return all ports, or an operation cannot be compiled.

    Example:
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Sampled
        >>> camera = Sampled(
        ...     "camera", period=0.02,
        ...     inputs=Layout((Port("position", (1,), "m", "of the cart"),)),
        ...     outputs=Layout((Port("sighted", (1,), "m", "position in the picture"),)),
        ...     parameters=Layout((Port("deviation", (1,), "m", "standard deviation", 0.01),)),
        ...     normal=Layout((Port("noise", (1,), "1", "of the picture"),)),
        ...     step=lambda x, u, p, w: {"sighted": u["position"] + p["deviation"] * w["noise"]},
        ... )
        >>> [port.name for port in camera.memory]
        ['sighted']
    """

    name: str
    inputs: Layout
    outputs: Layout
    step: Callable[[Parts, Parts, Parts, Parts], Any] = field(repr=False)
    state: Layout = EMPTY
    parameters: Layout = EMPTY
    normal: Layout = EMPTY
    uniform: Layout = EMPTY
    period: float | None = None

    def __post_init__(self) -> None:
        identifier(self.name)
        if self.name in _RESERVED:
            raise InputError("is a kind of numbers of a run", key="name", value=self.name, remedy="choose another name")
        for name in ("inputs", "outputs", "state", "parameters", "normal", "uniform"):
            checked_layout(getattr(self, name), key=f"{self.name}.{name}")
        if self.period is not None and not (is_number(self.period) and self.period > 0):
            raise InputError("is not a period", key=f"{self.name}.period", value=self.period, remedy="give seconds")
        if double := [port.name for port in self.normal if port.name in self.uniform]:
            raise InputError("is the name of two random numbers", key=f"{self.name}.{double[0]}", remedy="rename one")
        _ = self.memory, self.block  # a block that cannot be compiled is reported when it is created

    @cached_property
    def memory(self) -> Layout:
        """Return the layout of what the block keeps between two samples: its state and the held outputs."""
        return Layout((*self.state, *self.outputs))

    def sample(self, memory: ca.SX, u: ca.SX, p: ca.SX, normal: ca.SX, uniform: ca.SX) -> ca.SX:
        """Return the flat memory after a sample, for flat symbolic vectors."""
        random = {**self.normal.split(normal), **self.uniform.split(uniform)}
        parts = self.memory.split(memory), self.inputs.split(u), self.parameters.split(p), random
        key = f"{self.name}.step"
        return joined(self.memory, called(self.step, *parts, key=key), key=key)

    @cached_property
    def block(self) -> Block:
        """Return the computation of a sample as a list of instructions."""
        sizes = {"x": self.memory, "u": self.inputs, "p": self.parameters, "n": self.normal, "r": self.uniform}
        with Recording() as recording:
            symbols = {name: ca.SX.sym(name, layout.size) for name, layout in sizes.items()}
            return without_libm(recording.block(self.name, symbols, {"x_next": self.sample(*symbols.values())}))


def message(
    name: str, ports: Layout, *, period: float | None = None, samples_late: int = 0, loss: float = 0.0
) -> Sampled:
    """Return a block that transmits signals: they arrive late, and a message may be lost.

    A signal keeps its last value when a message is lost. The parameter `loss` is the probability of this.

    Args:
        period: time between two messages [s]; by default the control period.
        samples_late: delay of each message, in periods of the messages.
        loss: probability from 0 to 1 that a message is lost; each is drawn independently.

    Raises:
        InputError: a number is out of range.

    Example:
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import message
        >>> radio = message("radio", Layout((Port("speed", (1,), "m/s", "of the cart"),)), samples_late=2, loss=0.1)
        >>> [port.name for port in radio.memory]
        ['speed_sent_1', 'speed_sent_2', 'speed']
    """
    if isinstance(samples_late, bool) or not isinstance(samples_late, int) or not 0 <= samples_late <= _MOST:
        remedy = f"give a whole number from 0 to {_MOST}"
        raise InputError("is not a delay", key=f"{name}.samples_late", value=samples_late, remedy=remedy)
    if not (is_number(loss) and 0 <= loss <= 1):
        raise InputError("is not a probability", key=f"{name}.loss", value=loss, remedy="give a number from 0 to 1")

    def sent(port: Port) -> list[str]:
        return [f"{port.name}_sent_{k + 1}" for k in range(samples_late)]

    def step(x: Parts, u: Parts, p: Parts, w: Parts) -> dict[str, Any]:
        after: dict[str, Any] = {}
        for port in ports:
            chain = [u[port.name], *(x[own] for own in sent(port))]  # newest first
            after |= dict(zip(sent(port), chain, strict=False))
            after[port.name] = ca.if_else(w["chance"] < p["loss"], x[port.name], chain[-1])
        return after

    return Sampled(
        name, ports, ports, step, period=period,
        state=Layout(tuple(replace(port, name=own) for port in ports for own in sent(port))),
        parameters=Layout((Port("loss", (1,), "1", "probability that a message is lost", float(loss)),)),
        uniform=Layout((Port("chance", (1,), "1", "of a message"),)),
    )  # fmt: skip


class Instant(NamedTuple):
    """An instant of a control period; all vectors are flat.

    Attributes:
        x, d: plant state and disturbances then.
        p, q: parameters of the plant, and of all sampled blocks.
        period: number of the control period.
        k: number of the instant in it, from 0.
    """

    x: ca.SX
    d: ca.SX
    p: ca.SX
    q: ca.SX
    period: ca.SX | float = 0.0
    k: int = 0


@dataclass(frozen=True, eq=False)
class Blocks:
    """All sampled blocks of a loop, with one flat memory and one flat vector of parameters.

    Attributes:
        sensors: between the plant's measured outputs and the controller, in this order.
        actuators: between the commands and the plant's inputs, in this order.
        dt: control period [s].
    """

    sensors: tuple[Sampled, ...]
    actuators: tuple[Sampled, ...]
    dt: float

    def __post_init__(self) -> None:
        names = [block.name for block in self.all]
        for block in self.all:
            if names.count(block.name) > 1:
                raise InputError("is the name of two blocks", key=block.name, remedy="rename one of them")
        _ = self._rates  # a period that does not fit is reported when the loop is created

    @property
    def outputs(self) -> dict[Side, list[Layout]]:
        """Return the outputs of each sensor and of each actuator."""
        return {"sensors": [b.outputs for b in self.sensors], "actuators": [b.outputs for b in self.actuators]}

    @property
    def all(self) -> tuple[Sampled, ...]:
        """Return the sensors, then the actuators."""
        return (*self.sensors, *self.actuators)

    @cached_property
    def memory(self) -> Layout:
        """Return the layout of the memory of all blocks; the names are BLOCK.PORT."""
        return self._stacked("memory")

    @cached_property
    def parameters(self) -> Layout:
        """Return the layout of the parameters of all blocks; the names are BLOCK.PORT."""
        return self._stacked("parameters")

    @cached_property
    def noise(self) -> int:
        """Return the size of the noise generator's state; 0 if no block has random numbers."""
        return NOISE_STATE * any(block.normal.size or block.uniform.size for block in self.all)

    @cached_property
    def instants(self) -> int:
        """Return the number of instants of a control period: at equal distances, each sample at one of them."""
        return math.lcm(1, *(samples for samples, _ in self._rates.values()))

    def slow(self) -> dict[str, int]:
        """Return the number of control periods between two samples of each block that has more than one."""
        return {name: periods for name, (_, periods) in self._rates.items() if periods > 1}

    @cached_property
    def _rates(self) -> dict[str, tuple[int, int]]:
        # samples in a control period, control periods between samples; one of them is 1
        rates = {}
        for block in self.all:
            ratio = self.dt / (block.period or self.dt)
            samples, periods = max(1, round(ratio)), max(1, round(1 / ratio))
            if abs(ratio * periods / samples - 1) > _NEAR or max(samples, periods) > _MOST:
                remedy = f"give the control period {self.dt:g} s, a whole fraction or a multiple of it, up to {_MOST}"
                raise InputError(
                    "does not fit the control period", key=f"{block.name}.period", value=block.period, remedy=remedy
                )
            rates[block.name] = samples, periods
        return rates

    def _stacked(self, vector: str) -> Layout:
        return Layout(
            tuple(replace(p, name=f"{block.name}.{p.name}") for block in self.all for p in getattr(block, vector))
        )

    def sampled(
        self, side: Side, at: Instant, signals: Mapping[str, ca.SX], memory: ca.SX, noise: ca.SX
    ) -> tuple[dict[str, ca.SX], ca.SX, ca.SX]:
        """Return the signals behind the sensors or actuators, the memory and the noise generator's state.

        The memory of all blocks is flat. If `noise`, the state of the generator, is empty, every random number has its
        mean (0, or 1/2 if uniform).
        """
        time = ca.SX(at.period) * self.dt + at.k * self.dt / self.instants
        behind, parts, numbers = {"time": time, **signals}, self.memory.split(memory), self.parameters.split(at.q)
        for block in self.sensors if side == "sensors" else self.actuators:
            own = {port.name: f"{block.name}.{port.name}" for port in block.memory}
            samples, periods = self._rates[block.name]
            if at.k % (self.instants // samples) == 0 and (periods == 1 or at.k == 0):
                old = block.memory.join({name: parts[key] for name, key in own.items()})
                normal, uniform, noise = _random(block, noise)
                p = block.parameters.join({q.name: numbers[f"{block.name}.{q.name}"] for q in block.parameters})
                new = block.sample(old, block.inputs.join(behind), p, normal, uniform)
                if periods > 1:
                    new = ca.if_else(remainder(ca.SX(at.period), periods) == 0, new, old)
                parts |= {own[name]: part for name, part in block.memory.split(new).items()}
            behind |= {port.name: parts[own[port.name]] for port in block.outputs}
        return behind, self.memory.join(parts), noise


def _random(block: Sampled, noise: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    normals, uniforms = block.normal.size, block.uniform.size
    if noise.numel() == 0:
        return ca.SX.zeros(normals), 0.5 * ca.SX.ones(uniforms), noise
    normal, uniform = ca.SX(0, 1), ca.SX(0, 1)
    if normals:
        normal, noise = draw_normals(noise, normals + normals % 2)
    if uniforms:
        uniform, noise = draw_uniforms(noise, uniforms)
    return normal[:normals], uniform, noise


def connected(*layouts: Layout) -> Layout:
    """Return the layout of all ports; a port replaces one of its name in an earlier layout."""
    return Layout(tuple({port.name: port for layout in layouts for port in layout}.values()))
