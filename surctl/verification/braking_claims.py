"""The steps of the barrier's proof as claims over a vehicle's whole box of ranges (`surctl.guidance.braking`).

What follows of them for numbers, laws and sampled data is a certificate of its own: `surctl.verification.braking`.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from surctl.guidance.braking import Brakes, brakes_of, fastest_obstacle
from surctl.vehicle import Vehicle
from surctl.verification.assumptions import check_alike
from surctl.verification.claim import Claim, Variable

__all__ = ["braking_keeps", "braking_mass", "braking_retreat"]

_OBSTACLE = 0.15  # [m/s] largest of the claims


@dataclass(frozen=True, eq=False)
class _Box:
    """A vehicle anywhere in its ranges, symbolic."""

    brakes: Brakes
    fastest: float

    @property
    def swing(self) -> float:
        """Largest τ(F + F_b) [N s]."""
        return self.brakes.lag * (self.brakes.most + self.brakes.least)

    def mass(self) -> Variable:
        return Variable("m", ca.SX.sym("m"), "kg", *self.brakes.masses, "mass, surge and sway")

    def obstacle(self) -> Variable:
        most = min(_OBSTACLE, 0.95 * fastest_obstacle(self.brakes))
        return Variable("v_o", ca.SX.sym("v_o"), "m/s", 0.0, most, "speed of the obstacle towards the vehicle")

    def closing(self) -> Variable:
        return Variable("s", ca.SX.sym("s"), "m/s", 0.0, self.fastest + _OBSTACLE, "closing speed")

    def left(self, obstacle: ca.SX) -> ca.SX:
        """F' [N]."""
        return self.brakes.least - self.most_drag(obstacle)

    def most_drag(self, speed: ca.SX) -> ca.SX:
        return self.brakes.linear[1] * speed + self.brakes.quadratic[1] * speed * speed


def _box(vehicle: Vehicle, fastest: float) -> _Box:
    """NotApplicable where surge and sway differ in mass: Coriolis forces then push."""
    check_alike(vehicle, mass_alone=True, ranges=True)
    return _Box(brakes_of(vehicle), fastest)


def braking_keeps(vehicle: Vehicle, fastest: float) -> Claim:
    """While it brakes and comes nearer, the clearance beyond S does not fall: step 2 of the proof, times F'.

    In the worse half of the cases: it goes astern at g, the obstacle comes on at v_o = g + s. Ahead, drag helps.
    """
    box = _box(vehicle, fastest)
    b = box.brakes
    m, half = box.mass(), _OBSTACLE / 2
    s = Variable("s", ca.SX.sym("s"), "m/s", 0.0, half, "closing speed")
    g = Variable("g", ca.SX.sym("g"), "m/s", 0.0, half, "own speed astern")
    x = Variable("X", ca.SX.sym("X"), "N s/m", *b.linear, "linear drag")
    x2 = Variable("X2", ca.SX.sym("X2"), "N s^2/m^2", *b.quadratic, "quadratic drag")
    more = Variable("more", ca.SX.sym("more"), "N", 0.0, max(b.most - b.least, 0.0), "brake beyond F_b")
    lags = Variable("lags", ca.SX.sym("lags"), "N", 0.0, b.most + b.least, "F + F_b, what the lag has yet to turn")
    z = s.symbol + b.lag * lags.symbol / m.symbol
    drag = x.symbol * g.symbol + x2.symbol * g.symbol * g.symbol
    return Claim(
        name="braking-keeps",
        statement="d/dt (l - S) >= 0 while it brakes with F_b or more and s >= 0, times F': s F' <= z (F_b - D(g)), "
        "astern at g before what comes on at g + s",
        equation="guidance.braking, step 2",
        errata=(),
        expected="proved",
        paper=False,
        variables=(m, x, x2, more, lags, s, g),
        left=s.symbol * box.left(g.symbol + s.symbol),
        right=z * (b.least + more.symbol - drag),
        unit="N m/s",
    )


def braking_retreat(vehicle: Vehicle, fastest: float) -> Claim:
    """The same where it goes back at r beyond v_o, and z is still positive: drag then pushes more than D(v_o)."""
    box = _box(vehicle, fastest)
    m, vo = box.mass(), box.obstacle()
    lightest = box.brakes.masses[0]
    r = Variable("r", ca.SX.sym("r"), "m/s", 0.0, box.swing / lightest, "speed at which the clearance opens")
    return Claim(
        name="braking-retreat",
        statement="d/dt (l - S) >= 0 while it brakes and s = -r < 0 < z, times F': z (D(v_o + r) - F_b) <= r F'",
        equation="guidance.braking, step 2",
        errata=(),
        expected="proved",
        paper=False,
        variables=(m, r, vo),
        left=(box.swing / m.symbol - r.symbol) * (box.most_drag(vo.symbol + r.symbol) - box.brakes.least),
        right=r.symbol * box.left(vo.symbol),
        unit="N m/s",
    )


def braking_mass(vehicle: Vehicle, fastest: float) -> Claim:
    """No mass between two needs a longer way than the chord between them, so that an end of the range is the worst."""
    box = _box(vehicle, fastest)
    s = box.closing()
    q = Variable("q", ca.SX.sym("q"), "N s", 0.0, box.swing, "what the lag leaves of the thrust that pushes")
    lightest, heaviest = box.brakes.masses
    above = Variable("above", ca.SX.sym("above"), "kg", 0.0, heaviest - lightest, "mass less the lighter one")
    below = Variable("below", ca.SX.sym("below"), "kg", 0.0, heaviest - lightest, "the heavier one less the mass")
    a, b, m = above.symbol, below.symbol, lightest + above.symbol

    def distance(mass: ca.SX) -> ca.SX:
        return mass * (s.symbol + q.symbol / mass) ** 2

    return Claim(
        name="braking-mass",
        statement="m z^2, z = s + q/m, is below its chord between two masses, times what these differ by",
        equation="guidance.braking, step 2",
        errata=(),
        expected="proved",
        paper=False,
        variables=(s, q, above, below),
        left=distance(m) * (a + b),
        right=b * distance(ca.SX(lightest)) + a * distance(m + b),
        unit="kg^2 m^2/s^2",
    )
