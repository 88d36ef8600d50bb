"""A small law with every operation of the instruction list, in the shape that the export expects."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.export import Records
from surctl.ir import Block, Layout, Port, lower
from tests.ir.expressions import EXACT, LIBM_MAKERS

Vector = NDArray[np.float64]


class StandInStep(NamedTuple):
    tau: Vector
    x_next: Vector
    status: int
    telemetry: Vector


@dataclass(frozen=True, eq=False)
class StandIn:
    name: str
    dt: float
    state: Layout
    inputs: Layout
    gains: Layout
    outputs: Layout
    function: ca.Function

    @cached_property
    def block(self) -> Block:
        return lower(self.function)

    def initial_state(self) -> Vector:
        return self.state.pack()

    def step(self, x: Vector, u: Vector, p: Vector) -> StandInStep:
        safe = StandInStep(np.zeros(4), np.array(x), -2, np.zeros(self.outputs.size - 4))
        if not all(np.isfinite(v).all() for v in (x, u, p)):
            return safe
        tau, x_next, status, telemetry = (np.asarray(r).reshape(-1) for r in self.function(x, u, p))
        if not all(np.isfinite(v).all() for v in (tau, x_next, telemetry)):
            return safe
        return StandInStep(tau, x_next, int(status[0]), telemetry)


STATE = (
    Port("integral", (4,), "m/s", "integral of the velocity error, body frame", default=0.25),
    Port("latch", (1,), "1", "side of the encounter"),
    Port("memory", (2, 3), "m", "last ranges, newest row first", default=1.5),
)
INPUTS = (
    Port("eta", (4,), "m, m, m, rad", "pose in the world frame"),
    Port("ranges", (2, 3), "m", "ranges by sensor */ ??/ | η", default=2.0),
    Port("fresh", (1,), "1", "1 when the ranges are new", default=1.0),
)
GAINS = (
    Port("k_p", (4,), "1/s", "proportional gain", default=1.0),
    Port("limit", (1,), "N", "largest thrust", default=5.0),
)


def stand_in(
    *,
    name: str = "standin",
    gain: float = 0.1,
    state: tuple[Port, ...] = STATE,
    inputs: tuple[Port, ...] = INPUTS,
    telemetry: bool = True,
) -> StandIn:
    """A law that saturates, latches, remembers, and reports every operation in its telemetry."""
    layouts = Layout(state), Layout(inputs), Layout(GAINS)
    (x, xs), (u, us), (p, ps) = (layout.symbols(letter) for layout, letter in zip(layouts, "xup", strict=True))
    eta, memory = us.get("eta", ca.SX([1, 2, 3, 4])), xs.get("memory", ca.SX.ones(2, 3))
    integral = xs.get("integral", ca.SX.zeros(4))
    wanted = -ps["k_p"] * ca.vertcat(eta[:3], ca.atan2(ca.sin(eta[3]), ca.cos(eta[3]))) - integral
    tau = ca.fmin(ca.fmax(wanted, -ps["limit"]), ps["limit"])
    saturated = ca.fmax(ca.mmax(ca.fabs(wanted)), 0)
    latch = ca.if_else(eta[0] > eta[1], 1, ca.if_else(eta[0] < -eta[1], -1, xs.get("latch", ca.SX(0))))
    ranges = us.get("ranges", ca.SX.ones(2, 3))
    parts = {
        "integral": 0.9 * integral + gain * eta,
        "latch": latch,
        "memory": ca.if_else(us.get("fresh", ca.SX(1)) > 0.5, ca.vertcat(ranges[0, :], memory[0, :]), memory),
    }
    every = [make(eta[0], eta[1], memory[0, 1]) for make in (EXACT | LIBM_MAKERS).values()]
    report = (Port("report", (len(every),), "1", "one entry an operation"),) if telemetry else ()
    outputs = Layout((Port("tau", (4,), "N, N, N, N m", "thrust, body frame"), *report))
    x_next = layouts[0].join({port.name: parts[port.name] for port in state}) if state else ca.SX(0, 1)
    status = (saturated > ps["limit"]) + 2 * ca.ne(latch, xs.get("latch", ca.SX(0)))
    function = ca.Function("law", [x, u, p], [tau, x_next, status, ca.vertcat(*every) if telemetry else ca.SX(0, 1)])
    return StandIn(name, 0.05, *layouts, outputs, function)


def recorded(law: StandIn, *, steps: int = 200, seed: int = 5) -> Records:
    """A closed run with random inputs."""
    rng = np.random.default_rng(seed)
    x, p = law.initial_state(), law.gains.pack()
    X, U = [], []
    for _ in range(steps):
        u = law.inputs.pack() + rng.normal(0.0, 3.0, law.inputs.size)
        X.append(x)
        U.append(u)
        x = law.step(x, u, p).x_next
    return Records(np.array(X).reshape(steps, -1), np.array(U).reshape(steps, -1), p)
