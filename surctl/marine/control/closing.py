"""The last part of every law: velocity loop, limits of the thrust, status; the smooth thrust of law `calm`.

The controller cancels neither Coriolis forces nor the true drag. A body that turns while it translates needs no force
to hold its inertial velocity. To cancel the Coriolis force m u r, the thrusters would have to provide 9–14 N, but only
5 N are available. The true drag adds damping. Because the gains in surge and sway are equal, properties of the closed
loop can be proved. The feedback uses the velocity over ground, so a constant current causes only a small steady error.

Noise of the estimated velocity enters the thrust through the velocity loop: an error e becomes m k_v e, which is 1 N
for 95 kg, 1.5 1/s and 0.7 cm/s. `calmed` follows the demanded thrust through a band (hysteresis, or "play"): the
command changes at once only as far as the demand leaves the band, and slowly within the band. So the command differs
from the demand by at most the half width of the band, and not for long.

`eased` lets the velocity reference follow the decision with a time constant and a limited acceleration, unless the
speed bound of an obstacle requires more. Short-lived decisions then do not reverse the thrust. A share of the force
that accelerates the mass along this reference is added to the demand (`pushed`), so the robot follows it more closely.

The gains are chosen by a design of experiments on the compiled loop (`analysis/12_sonar_loop`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Protocol

import casadi as ca

from surctl.errors import InputError, nearest
from surctl.ir import Block, Layout, Port, Recording, fold, tabulated
from surctl.marine.control.gains import GainSpec
from surctl.marine.control.law import DEGRADED, SATURATED, TRAPPED
from surctl.marine.control.ports import YAW_SHARE
from surctl.marine.guidance.sectors import Bounds
from surctl.marine.vehicle import planar_rotation
from surctl.priority.solver.fallback import RELAXED


def velocity_control(
    nu_reference: ca.SX,
    nu: ca.SX,
    integral: ca.SX,
    model: Mapping[str, ca.SX],
    *,
    k_v: ca.SX,
    k_r: ca.SX,
    k_i: ca.SX,
    dt: float,
    calm: Callable[[ca.SX], ca.SX] | None = None,
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the thrust (4, 1) [N, N m] within its limits, the next integral ξ (4, 1), and 1 if an axis is saturated.

    Before the limits, the thrust is D(ν_d)ν_d + M (K (ν_d − ν) + ξ) with the drag D, the mass matrix M and the gains K.
    Each axis is limited separately, because a common scaling would allow a large sideways command to remove most of the
    braking force.

    Args:
        nu_reference, nu: ν_d and measured velocity over ground (4, 1) [m/s, rad/s] in {B}.
        integral: ξ (4, 1) [m/s², rad/s²].
        model: `mass`, `linear_drag`, `quadratic_drag` and `thrust_limit` of the controller's model, each (4, 1).
        k_v: bandwidth in surge, sway and heave [1/s], one number or (3, 1).
        k_r, k_i: bandwidth in yaw [1/s], and integral gain [1/s²]; the integral of a saturated axis does not change
            (conditional anti-windup).
        calm: function that keeps measurement noise out of the thrust before its limits (`control.calm`), or None.
    """
    error = nu_reference - nu
    gain = ca.vertcat(ca.SX.ones(3) * k_v, k_r)
    drag = model["linear_drag"] * nu_reference + model["quadratic_drag"] * nu_reference * ca.fabs(nu_reference)
    free = drag + model["mass"] * (gain * error + integral)
    if calm is not None:
        free = calm(free)
    limit = model["thrust_limit"]
    thrust = ca.fmin(ca.fmax(free, -limit), limit)
    clipped = ca.fabs(free - thrust) > 1e-9
    held = ca.if_else(clipped, integral, integral + dt * k_i * error)
    return thrust, held, ca.fmax(ca.fmax(clipped[0], clipped[1]), ca.fmax(clipped[2], clipped[3]))


EVADE = 0.1
"""Time constant [s] of the velocity reference while the robot evades a moving obstacle (*chosen*)."""

MODEL_NOISE = 0.05
"""Error of the vehicle model that the own-state filter of a calm law assumes [s^0.5] (*chosen*)."""

ACCELERATION_NOISE = 0.012
"""Acceleration noise that the own-state filter of a calm law always assumes [m/s^1.5] (*chosen*): a filter that follows
the fixes faster costs the loop less of its margins."""

BRAKE, BRAKE_AT_START, HARD = 3.0, 6.0, 0.03
"""How a calm law brakes above a speed bound, see `stopping.braked` (*chosen*): harder near the start, where an obstacle
may be in the blind range of the sonars."""

_SMOOTH = 0.4  # [s] time constant of the reference's acceleration before it becomes thrust
_WIDEST = 0.3  # share of the thrust limit: largest half width of the band
_HEAVE, _DEPTH = 0.18, 0.33  # shares of `k_v` and `k2`: nothing is near above or below, so the depth may return slowly
_HEAVE_LAG = 1.0  # [s] `settle` in heave, whose demand is about 0 and would often change its sign
_BESIDE, _AHEAD = 0.3, 0.8  # cosines to the course: a mark beside the robot, and ahead of it
_SLOW = 0.05  # [m/s] speed below which the robot hardly approaches anything

CALM_PORTS = (
    Port("eased", (2,), "m/s", "velocity reference of the step before, without braking, in {E}", gap="anew"),
    Port("pushed", (2,), "m/s^2", "low-pass filtered acceleration of `eased`, in {E}", gap="anew"),
    Port("held", (4,), "N, N m", "thrust command of the step before", gap="anew"),
)

CALM_GAINS: Mapping[str, GainSpec] = {
    "ease": GainSpec("s", "time constant of the velocity reference; 0 for none", True, default=0.9, range=(0.0, 1.5)),
    "ramp": GainSpec(
        "1", "largest change of the velocity reference, as a share of the acceleration at full thrust", default=0.9,
        range=(0.5, 2.0),
    ),
    "soft": GainSpec("1", "share of `k_v` that this law uses in surge and sway", default=0.65, range=(0.3, 1.0)),
    "prompt": GainSpec("1", "share of `reaction` that this law uses", default=1.0, range=(0.5, 1.0)),
    "feed_forward": GainSpec("1", "fed forward share of a steady acceleration", True, default=0.5, range=(0.0, 1.0)),
    "still": GainSpec(
        "m/s", "velocity error that changes the thrust only slowly; 0 for none", True, default=0.02, range=(0.0, 0.04)
    ),
    "settle": GainSpec("s", "time constant of the thrust after such an error", default=0.5, range=(0.1, 5.0)),
    "beside": GainSpec("1", "share of `margin` kept from marks beside the course", True, default=0.3, range=(0.0, 1.0)),
}  # fmt: skip
"""Gains of law `calm` in addition to those of law `guarded`."""


def calm_parameters(p: Mapping[str, ca.SX]) -> dict[str, ca.SX]:
    """Return the parameters with the shares of `reaction` and `k2` that the decision of a calm law uses."""
    return {**p, "reaction": p["prompt"] * p["reaction"], "k2": _DEPTH * p["k2"]}


def soft_gain(p: Mapping[str, ca.SX]) -> ca.SX:
    """Return the bandwidth (3, 1) of the velocity loops in surge, sway and heave [1/s]."""
    return p["k_v"] * ca.vertcat(p["soft"], p["soft"], _HEAVE)


def beside_margin(normal: ca.SX, *, course: ca.SX, now: ca.SX, full: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
    """Return the margin [m] to a mark of the map: `margin` ahead, and its share `beside` beside the desired course.

    In a gap between two marks the robot passes both, and does not approach them. Ahead the margin covers an obstacle
    that drifts towards the robot within the blind range of its sonars. `normal` is the unit vector (2, 1) to the mark;
    a mark in the direction of the desired velocity `course` or of the velocity over ground `now` [m/s] is ahead. Where
    `full` is 1, every mark needs `margin`.
    """
    cosine = ca.fmax(_cosine(normal, course, 1e-3), _cosine(normal, now, _SLOW))
    ahead = ca.fmin(ca.fmax((cosine - _BESIDE) / (_AHEAD - _BESIDE), 0), 1)
    return p["margin"] * ca.if_else(full, 1, p["beside"] + (1 - p["beside"]) * ahead)


def calmed(free: ca.SX, held: ca.SX, acceleration: ca.SX, *, p: Mapping[str, ca.SX], dt: float) -> ca.SX:
    """Return the thrust (4, 1) that follows the demand slowly within a band, and at once where it leaves the band.

    The yaw moment is the demand. The half width of the band is at most 30 % of the thrust limit.

    Args:
        free, held: demanded thrust before the limits, without acceleration of the reference, and command of the step
            before (4, 1) [N, N m].
        acceleration: acceleration of the reference (2, 1) in {B} [m/s²]; the share `feed_forward` of it is used.
    """
    free = free + p["feed_forward"] * p["mass"] * ca.vertcat(acceleration, 0, 0)
    width = ca.fmin(p["mass"][:3] * soft_gain(p) * p["still"], _WIDEST * p["thrust_limit"][:3])
    width = ca.vertcat(width, 0)
    lag = ca.vertcat(p["settle"], p["settle"], _HEAVE_LAG, p["settle"])
    slow = held + dt / (dt + lag) * (free - held)
    return ca.fmin(ca.fmax(slow, free - width), free + width)


def _cosine(normal: ca.SX, velocity: ca.SX, least: float) -> ca.SX:
    return ca.dot(normal, velocity) / ca.fmax(ca.sqrt(ca.sumsqr(velocity)), least)


def eased(
    velocity: ca.SX, before: ca.SX, bounds: Bounds, *, time: ca.SX | float, fastest: ca.SX | float, dt: float
) -> ca.SX:
    """Return a velocity between the reference of the step before and the desired one, within the bounds.

    Where the reference would exceed a speed bound that the desired velocity respects, it follows faster, as far as the
    bound requires. Both velocities are (2, 1) in {E} [m/s]; `time` is the time constant [s] and `fastest` the largest
    acceleration of the reference [m/s²].
    """
    step = velocity - before

    def further(share: ca.SX, row: ca.SX) -> ca.SX:
        along, excess = ca.dot(row[:2], step), ca.dot(row[:2], before) - row[2]
        needed = ca.fmin(excess / ca.fmax(-along, 1e-9), 1)
        return ca.if_else(ca.logic_and(excess > 0, along < 0), ca.fmax(share, needed), share)

    share = ca.fmin(dt / (dt + time), fastest * dt / ca.fmax(ca.sqrt(ca.sumsqr(step)), 1e-9))
    return before + fold("eased", further, share, tabulated(bounds, 3)) * step


def pushed(velocity: ca.SX, before: ca.SX, held: ca.SX, *, dt: float) -> ca.SX:
    """Return the low-pass filtered acceleration (2, 1) [m/s²] of the reference in {E}; `held` is the last one."""
    return held + dt / (dt + _SMOOTH) * ((velocity - before) / dt - held)


class AxisVector(ca.SX):
    """A vector (4, 1) of surge, sway, heave and yaw whose entries also have names."""

    NAMES = ("u", "v", "w", "r")

    def __getitem__(self, key: Any) -> Any:
        """Return one entry by its name, or what CasADi returns for a number or a slice."""
        if isinstance(key, str) and key not in self.NAMES:
            raise InputError("no such name here", key=key, remedy=nearest(key, self.NAMES))
        return super().__getitem__(self.NAMES.index(key) if isinstance(key, str) else key)


class Thrust(Protocol):
    """Velocity controller of a law."""

    def __call__(
        self, reference: AxisVector, nu: AxisVector, state: AxisVector, p: Mapping[str, ca.SX], dt: float, /
    ) -> tuple[ca.SX, ca.SX]:
        """Return the thrust before limits (4, 1) [N, N m], and the next state (4, 1) of the controller.

        Args:
            reference: velocity reference u, v, w [m/s], r [rad/s] (4, 1), by name or number: `reference["u"]`.
            nu: measured velocity (4, 1), with the same names.
            state: state of the controller (4, 1), zero at the start, with the same names.
            p: gains, vehicle and mission by name.
            dt: control period [s].
        """


_CLIPPED = 1e-9  # [N, N m] smallest difference that counts as a reached thrust limit

CLIMB = 0.1
"""Largest heave velocity command [m/s]."""


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
        flags = memory.flags
        degraded = flags - TRAPPED * (flags >= TRAPPED) >= DEGRADED  # `TRAPPED` is the only bit above `DEGRADED`
        opened = ca.logic_and(stage >= RELAXED, ca.logic_not(degraded))
        status = flags + SATURATED * saturated + DEGRADED * opened
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
            horizontal, ca.fmin(ca.fmax(nu_reference[2], -CLIMB), CLIMB), ca.fmin(ca.fmax(nu_reference[3], -turn), turn)
        )
        if self.thrust is not None:
            reference, nu, state = (AxisVector(vector) for vector in (clamped, self.u["nu"], integral))
            free, following = self.thrust(reference, nu, state, p, self.dt)
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
