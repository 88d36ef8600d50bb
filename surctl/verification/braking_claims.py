"""Claims about the barrier with inertia, over the whole box of a vehicle's ranges (`surctl.guidance.braking`)."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from surctl.control import Gains
from surctl.guidance.braking import Brakes, Watch, brakes_of, fastest_obstacle
from surctl.vehicle import Vehicle
from surctl.verification.claim import Claim, Variable

__all__ = ["braking_bound", "braking_keeps", "braking_range"]

_OBSTACLE, _SPEED = 0.15, 0.25  # [m/s] largest of the claims


@dataclass(frozen=True, eq=False)
class _Box:
    """A vehicle anywhere in its ranges, symbolic."""

    brakes: Brakes

    def mass(self) -> Variable:
        return Variable("m", ca.SX.sym("m"), "kg", *self.brakes.masses, "mass, surge and sway")

    def linear(self) -> Variable:
        return Variable("X", ca.SX.sym("X"), "N s/m", *self.brakes.linear, "linear drag")

    def quadratic(self) -> Variable:
        return Variable("X2", ca.SX.sym("X2"), "N s^2/m^2", *self.brakes.quadratic, "quadratic drag")

    def brake(self) -> Variable:
        most = max(self.brakes.most, self.brakes.least)
        return Variable("F_b", ca.SX.sym("F_b"), "N", self.brakes.least, most, "thrust against the motion")

    def thrust(self, least: float) -> Variable:
        return Variable("F", ca.SX.sym("F"), "N", least, self.brakes.most, "thrust now, positive towards the obstacle")

    def obstacle(self) -> Variable:
        most = min(_OBSTACLE, 0.95 * fastest_obstacle(self.brakes))
        return Variable("v_o", ca.SX.sym("v_o"), "m/s", 0.0, most, "speed of the obstacle towards the vehicle")

    def left(self, obstacle: ca.SX, *, linear: ca.SX | float, quadratic: ca.SX | float) -> ca.SX:
        return self.brakes.least - linear * obstacle - quadratic * obstacle * obstacle


def braking_keeps(vehicle: Vehicle, gains: Gains) -> Claim:
    """While it brakes, the clearance beyond S does not fall: step 2 of the proof, multiplied by F'."""
    del gains
    box = _Box(brakes_of(vehicle))
    m, x, x2, b, f, vo = (
        box.mass(),
        box.linear(),
        box.quadratic(),
        box.brake(),
        box.thrust(-box.brakes.least),
        box.obstacle(),
    )
    v = Variable("v", ca.SX.sym("v"), "m/s", -vo.upper, _SPEED, "own speed towards the obstacle")
    closing = v.symbol + vo.symbol
    left = box.left(vo.symbol, linear=box.brakes.linear[1], quadratic=box.brakes.quadratic[1])
    z = closing + box.brakes.lag * (f.symbol + box.brakes.least) / m.symbol
    drag = x.symbol * v.symbol + x2.symbol * v.symbol * ca.fabs(v.symbol)
    return Claim(
        name="braking-keeps",
        statement="d/dt (l - S) >= 0 while it brakes with F_b or more and s >= 0, times F': s F' <= z (F_b + D(v))",
        equation="guidance.braking, step 2",
        errata=(),
        expected="not refuted",
        paper=False,
        variables=(m, x, x2, b, f, v, vo),
        left=closing * left,
        right=z * (b.symbol + drag),
        unit="N m/s",
        constraints=-closing,
    )


def braking_range(vehicle: Vehicle, gains: Gains) -> Claim:
    """No vehicle in the box needs more than the closed form at the worst of its ranges."""
    del gains
    box = _Box(brakes_of(vehicle))
    m, x, x2, b, f, vo = box.mass(), box.linear(), box.quadratic(), box.brake(), box.thrust(0.0), box.obstacle()
    s = Variable("s", ca.SX.sym("s"), "m/s", 0.0, _SPEED + vo.upper, "closing speed")
    brakes = box.brakes
    left = b.symbol - x.symbol * vo.symbol - x2.symbol * vo.symbol * vo.symbol
    needed = m.symbol * (s.symbol + brakes.lag * (f.symbol + b.symbol) / m.symbol) ** 2 / (2 * left)
    least = box.left(vo.symbol, linear=brakes.linear[1], quadratic=brakes.quadratic[1])
    swing, worst = brakes.lag * (brakes.most + brakes.least), ca.SX(0)
    for mass in brakes.masses:
        worst = ca.fmax(worst, mass * (s.symbol + swing / mass) ** 2 / (2 * least))
    return Claim(
        name="braking-range",
        statement="the way to a stop, anywhere in the vehicle's ranges, is at most S at their worst",
        equation="guidance.braking, step 2",
        errata=(),
        expected="not refuted",
        paper=False,
        variables=(m, x, x2, b, f, s, vo),
        left=needed,
        right=worst,
        unit="m",
    )


def braking_bound(vehicle: Vehicle, gains: Gains) -> Claim:
    """The law's bound s^2/(2a) + s t and its margin are enough before what stands.

    The way with drag, step 3, for an obstacle at rest: the integral of m z/(F_b + D(z)) up to z, at most
    m z^2 (6 F_b + D)/(2 F_b (6 F_b + 4 D)) with D = X z + min(X2 z^2, F_b): D(z) is above its chord z^2/z_0^2, and
    ln(1 + x) <= x (6 + x)/(6 + 4 x).
    """
    box, watch = _Box(brakes_of(vehicle)), Watch()
    brakes = box.brakes
    m, x, x2, b, f = box.mass(), box.linear(), box.quadratic(), box.brake(), box.thrust(0.0)
    v = Variable("v", ca.SX.sym("v"), "m/s", 0.0, _SPEED, "own speed towards the obstacle, at the law's bound")
    gain = f.symbol / m.symbol
    z = v.symbol + gain * watch.period + brakes.lag * (f.symbol + b.symbol) / m.symbol
    drag = x.symbol * z + ca.fmin(x2.symbol * z * z, b.symbol)
    way = m.symbol * z * z / (2 * b.symbol) * (6 * b.symbol + drag) / (6 * b.symbol + 4 * drag)
    needed = v.symbol * watch.period + gain * watch.period**2 / 2 + way
    weakest, heaviest = float(min(vehicle.thrust_limit[:2])), float(max(vehicle.mass[:2]))
    kept = v.symbol**2 * heaviest / (2 * gains["brake"] * weakest) + v.symbol * gains["reaction"] + gains["margin"]
    return Claim(
        name="braking-bound",
        statement="what the law keeps, s^2/(2a) + s t + margin, is enough to stop before what stands, true ranges read "
        "every 0.05 s, full thrust as soon as it is faster than its bound, anywhere in the vehicle's ranges",
        equation="guidance.braking, steps 3 and 4",
        errata=(),
        expected="not refuted",
        paper=False,
        variables=(m, x, x2, b, f, v),
        left=needed,
        right=kept,
        unit="m",
    )
