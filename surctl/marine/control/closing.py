"""The last part of every law: it computes thrust, status and telemetry from the priority solver's velocity ν."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol

import casadi as ca

from surctl.ir import Block, Layout, Recording
from surctl.marine.control.calm import calmed, soft_gain
from surctl.marine.control.law import DEGRADED, SATURATED, TRAPPED
from surctl.marine.control.ports import YAW_SHARE
from surctl.marine.control.velocity import velocity_control
from surctl.marine.vehicle import planar_rotation
from surctl.priority.solver.fallback import RELAXED

__all__ = ["CLIMB", "Closing", "Memory", "Thrust", "thrust_bounds", "yaw_limit"]


class Thrust(Protocol):
    """Velocity controller of a law."""

    def __call__(
        self, reference: ca.SX, nu: ca.SX, state: ca.SX, p: Mapping[str, ca.SX], dt: float, /
    ) -> tuple[ca.SX, ca.SX]:
        """Return the thrust before limits (4, 1) [N, N m], and the next state (4, 1) of the controller.

        Args:
            reference: velocity reference u, v, w [m/s], r [rad/s] (4, 1).
            nu: measured velocity (4, 1), in the same order.
            state: state of the controller (4, 1), zero at the start.
            p: gains, vehicle and mission by name.
            dt: control period [s].
        """


_CLIPPED = 1e-9  # [N, N m] smallest difference that counts as a reached thrust limit

CLIMB = 0.1
"""Largest heave velocity command [m/s]."""


def _has_degraded(flags: ca.SX) -> ca.SX:
    # `TRAPPED` is the only bit above `DEGRADED`
    return flags - TRAPPED * (flags >= TRAPPED) >= DEGRADED


def yaw_limit(p: dict[str, ca.SX]) -> ca.SX:
    """Return the steady yaw rate [rad/s] at which the drag moment equals 85 % of the largest yaw moment."""
    moment, linear, quadratic = YAW_SHARE * p["thrust_limit"][3], p["linear_drag"][3], p["quadratic_drag"][3]
    root = ca.sqrt(linear * linear + 4 * quadratic * moment)
    # this form of the root avoids a difference of nearly equal numbers, and works without quadratic drag
    return 2 * moment / ca.fmax(linear + root, 1e-6)


def thrust_bounds(p: Mapping[str, ca.SX]) -> tuple[ca.SX, ca.SX]:
    """Return the least and the largest thrust (4, 1) [N, N m] that a law commands.

    The largest surge thrust is the parameter `ahead_limit`, if the law has it and it is larger than the limit astern.
    """
    limit = p["thrust_limit"]
    if "ahead_limit" not in p:
        return -limit, limit
    return -limit, ca.vertcat(ca.fmax(limit[0], p["ahead_limit"]), limit[1:])


class Memory(NamedTuple):
    """The values that the law has computed before the priority solver runs.

    `carried` is the next state before the velocity integral is updated, `reported` is the telemetry except
    `nu_reference`, and `flags` is the sum of the status bits.
    """

    carried: ca.SX
    reported: ca.SX
    flags: ca.SX


@dataclass(frozen=True)
class Closing:
    """The last part of a law: it limits the velocity reference, computes the thrust, and assembles the outputs."""

    state: Layout
    outputs: Layout
    flat_u: ca.SX
    u: dict[str, ca.SX]
    flat_p: ca.SX
    p: dict[str, ca.SX]
    dt: float
    thrust: Thrust | None = None

    def block(self) -> Block:
        """Return `outputs_of` as an instruction list or routine with the vectors u and p as further inputs."""
        sizes = (self.state.size, self.outputs.size - 8, 1)
        memory = Memory(*(ca.SX.sym(name, size) for name, size in zip(Memory._fields, sizes, strict=True)))
        nu_reference, stage = ca.SX.sym("nu_reference", 4), ca.SX.sym("stage")
        inputs = {"u": self.flat_u, "p": self.flat_p, **memory._asdict(), "nu_reference": nu_reference, "stage": stage}
        return Recording().block("post", inputs, self.outputs_of(memory, nu_reference, stage))

    def outputs_of(self, memory: Memory, nu_reference: ca.SX, stage: ca.SX) -> dict[str, ca.SX]:
        """Return tau, x_next, status and telemetry for a velocity reference.

        `stage` says which fallback of the priority solver computed `nu_reference`; 0 if the solver did not run.
        """
        carried = self.state.split(memory.carried)
        tau, integral, saturated, clamped = self._thrust(nu_reference, carried)
        if "held" in carried:
            carried = {**carried, "held": tau}
        opened = ca.logic_and(stage >= RELAXED, ca.logic_not(_has_degraded(memory.flags)))
        status = memory.flags + SATURATED * saturated + DEGRADED * opened
        return {
            "tau": tau,
            "x_next": self.state.join({**carried, "integral": integral}),
            "status": status,
            "telemetry": ca.vertcat(clamped, memory.reported),
        }

    def _thrust(self, nu_reference: ca.SX, carried: Mapping[str, ca.SX]) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        p, integral, calm = self.p, carried["integral"], None
        speed = ca.sqrt(ca.sumsqr(nu_reference[:2]))
        horizontal = nu_reference[:2] * ca.fmin(1, p["cap"] / ca.fmax(speed, 1e-6))
        turn = yaw_limit(p)
        clamped = ca.vertcat(
            horizontal,
            ca.fmin(ca.fmax(nu_reference[2], -CLIMB), CLIMB),
            ca.fmin(ca.fmax(nu_reference[3], -turn), turn),
        )
        if self.thrust is not None:
            free, following = self.thrust(clamped, self.u["nu"], integral, p, self.dt)
            least, most = thrust_bounds(p)
            tau = ca.fmin(ca.fmax(free, least), most)
            return tau, following, ca.mmax(ca.fabs(free - tau) > _CLIPPED), clamped
        k_v = p["k_v"]
        if "held" in carried:
            k_v = soft_gain(p)
            acceleration = planar_rotation(self.u["eta"][3]).T @ carried["pushed"]
            calm = partial(calmed, held=carried["held"], acceleration=acceleration, p=p, dt=self.dt)
        tau, integral, saturated = velocity_control(
            clamped, self.u["nu"], integral, p, k_v=k_v, k_r=p["k_r"], k_i=p["k_i"], dt=self.dt, calm=calm
        )
        return tau, integral, saturated, clamped
