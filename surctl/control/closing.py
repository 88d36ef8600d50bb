"""The last stage of every law: from the velocity that the priority solver gives to thrust, status and telemetry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from surctl.control.law import DEGRADED, SATURATED, TRAPPED
from surctl.control.ports import YAW_SHARE
from surctl.control.velocity import velocity_control
from surctl.ir import Block, Layout, Recording
from surctl.priority.solver.ladder import RELAXED

__all__ = ["CLIMB", "Closing", "Memory", "yaw_limit"]

CLIMB = 0.1
"""[m/s] largest heave command."""


def _has_degraded(flags: ca.SX) -> ca.SX:
    """Whether the bit `DEGRADED` is set; only `TRAPPED` is above it."""
    return flags - TRAPPED * (flags >= TRAPPED) >= DEGRADED


def yaw_limit(p: dict[str, ca.SX]) -> ca.SX:
    """Yaw rate [rad/s] that 85 % of the yaw thrust holds."""
    moment, linear, quadratic = YAW_SHARE * p["thrust_limit"][3], p["linear_drag"][3], p["quadratic_drag"][3]
    root = ca.sqrt(linear * linear + 4 * quadratic * moment)
    # the form without a difference of near-equal numbers, and defined without quadratic drag
    return 2 * moment / ca.fmax(linear + root, 1e-6)


class Memory(NamedTuple):
    """What is known before the priority decision: next state but for the integral, telemetry after the wish, flags."""

    carried: ca.SX
    told: ca.SX
    flags: ca.SX


@dataclass(frozen=True)
class Closing:
    """Last stage: limit the wanted velocity, velocity control, and put the outputs together."""

    state: Layout
    outputs: Layout
    flat_u: ca.SX
    u: dict[str, ca.SX]
    flat_p: ca.SX
    p: dict[str, ca.SX]
    dt: float

    def block(self) -> Block:
        """(u, p, carried, told, flags, nu_wanted, rung) → (tau, x_next, status, telemetry)."""
        sizes = (self.state.size, self.outputs.size - 8, 1)
        memory = Memory(*(ca.SX.sym(name, size) for name, size in zip(Memory._fields, sizes, strict=True)))
        wanted, rung = ca.SX.sym("nu_wanted", 4), ca.SX.sym("rung")
        given = {"u": self.flat_u, "p": self.flat_p, **memory._asdict(), "nu_wanted": wanted, "rung": rung}
        return Recording().block("post", given, self.outputs_of(memory, wanted, rung))

    def outputs_of(self, memory: Memory, nu_wanted: ca.SX, rung: ca.SX) -> dict[str, ca.SX]:
        """tau, x_next, status, telemetry of a wanted velocity; rung of the priority tick, 0 if there was none."""
        carried = self.state.split(memory.carried)
        tau, integral, saturated, clamped = self._thrust(nu_wanted, carried["integral"])
        opened = ca.logic_and(rung >= RELAXED, ca.logic_not(_has_degraded(memory.flags)))
        status = memory.flags + SATURATED * saturated + DEGRADED * opened
        return {
            "tau": tau,
            "x_next": self.state.join({**carried, "integral": integral}),
            "status": status,
            "telemetry": ca.vertcat(clamped, memory.told),
        }

    def _thrust(self, wanted: ca.SX, integral: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        p = self.p
        speed = ca.sqrt(ca.sumsqr(wanted[:2]))
        horizontal = wanted[:2] * ca.fmin(1, p["cap"] / ca.fmax(speed, 1e-6))
        turn = yaw_limit(p)
        clamped = ca.vertcat(
            horizontal,
            ca.fmin(ca.fmax(wanted[2], -CLIMB), CLIMB),
            ca.fmin(ca.fmax(wanted[3], -turn), turn),
        )
        tau, integral, saturated = velocity_control(
            clamped, self.u["nu"], integral, p, k_v=p["k_v"], k_r=p["k_r"], k_i=p["k_i"], dt=self.dt
        )
        return tau, integral, saturated, clamped
