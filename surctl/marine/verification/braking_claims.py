"""Claims `braking-keeps`, `-retreat` and `-mass`: the steps of the proof that a vehicle brakes before an obstacle.

`analysis/15_braking_barrier/proof.md` contains the proof. For a law with sampled control and given numerical
values, `surctl.marine.verification.braking` issues a separate certificate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from surctl.marine.guidance.braking import Brakes, brakes_of, fastest_obstacle
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.assumptions import check_alike
from surctl.verification.claim import Claim, Variable

_OBSTACLE = 0.15  # [m/s] largest speed of an obstacle in the claims


NOT_RESTED_ON: Mapping[str, str] = {
    "braking-keeps": f"it is about obstacles of up to {_OBSTACLE:g} m/s, and the no-contact claim examines its own",
    "braking-retreat": "it is about distances that count during a retreat, where the no-contact claim counts the one "
    "at a closing speed of 0",
}
"""Why a no-contact claim does not rest on a claim of this module that may be refuted (steps 2 and 7 of the proof)."""


@dataclass(frozen=True, eq=False)
class _Box:
    # the parameters may lie anywhere in their ranges
    brakes: Brakes
    fastest: float

    @property
    def swing(self) -> float:
        # the largest momentum τ(F + F_b) [N s] that the thrust lag can add
        return self.brakes.lag * (self.brakes.most + self.brakes.least)

    def mass(self) -> Variable:
        return Variable("m", ca.SX.sym("m"), "kg", *self.brakes.masses, "mass, surge and sway")

    def obstacle(self) -> Variable:
        most = min(_OBSTACLE, 0.95 * fastest_obstacle(self.brakes))
        return Variable("v_o", ca.SX.sym("v_o"), "m/s", 0.0, most, "speed of the obstacle towards the vehicle")

    def closing(self) -> Variable:
        return Variable("s", ca.SX.sym("s"), "m/s", 0.0, self.fastest + _OBSTACLE, "closing speed")

    def left(self, obstacle: ca.SX) -> ca.SX:
        # the least braking force F' [N]
        return self.brakes.least - self.most_drag(obstacle)

    def most_drag(self, speed: ca.SX) -> ca.SX:
        return self.brakes.linear[1] * speed + self.brakes.quadratic[1] * speed * speed


def _box(vehicle: Vehicle, fastest: float) -> _Box:
    # if surge and sway differed in mass, Coriolis forces would act
    check_alike(vehicle, mass_alone=True, ranges=True)
    return _Box(brakes_of(vehicle), fastest)


def _claim(name: str, statement: str, variables: tuple[Variable, ...], left: ca.SX, right: ca.SX, unit: str) -> Claim:
    step = "guidance.braking, step 2"
    return Claim(name, statement, step, (), "proved", variables, left, right, unit, paper=False)


def braking_keeps(vehicle: Vehicle, fastest: float) -> Claim:
    """Return the claim that l − S does not decrease while the vehicle brakes and the distance l decreases.

    S is the stopping distance, and l the distance to the obstacle. The claim is the inequality of step 2 of the proof,
    multiplied by the least braking force. The claim covers the worse case: the vehicle moves astern at a speed g, and
    the obstacle approaches at v_o = g + s with the closing speed s. While the vehicle still moves ahead, drag helps to
    brake.
    """
    box = _box(vehicle, fastest)
    b = box.brakes
    m, half = box.mass(), _OBSTACLE / 2
    s = Variable("s", ca.SX.sym("s"), "m/s", 0.0, half, "closing speed")
    g = Variable("g", ca.SX.sym("g"), "m/s", 0.0, half, "own speed astern")
    x = Variable("X", ca.SX.sym("X"), "N s/m", *b.linear, "linear drag")
    x2 = Variable("X2", ca.SX.sym("X2"), "N s^2/m^2", *b.quadratic, "quadratic drag")
    more = Variable("more", ca.SX.sym("more"), "N", 0.0, max(b.most - b.least, 0.0), "braking thrust in excess of F_b")
    lags = Variable(
        "lags", ca.SX.sym("lags"), "N", 0.0, b.most + b.least, "F + F_b, thrust not yet reversed by the lag"
    )
    z = s.symbol + b.lag * lags.symbol / m.symbol
    drag = x.symbol * g.symbol + x2.symbol * g.symbol * g.symbol
    statement = (
        "d/dt (l - S) >= 0 while the vehicle brakes with F_b or more and s >= 0, multiplied by F': "
        "s F' <= z (F_b - D(g)); the vehicle moves astern at g and the obstacle approaches at g + s"
    )
    left, right = s.symbol * box.left(g.symbol + s.symbol), z * (b.least + more.symbol - drag)
    return _claim("braking-keeps", statement, (m, x, x2, more, lags, s, g), left, right, "N m/s")


def braking_retreat(vehicle: Vehicle, fastest: float) -> Claim:
    """Return the claim that l − S does not decrease while the vehicle retreats faster than the obstacle approaches.

    l is the distance to the obstacle, and S the stopping distance. The vehicle moves astern at v_o + r, where v_o is
    the obstacle's speed; the vehicle's drag then exceeds its drag at the speed v_o. S is still positive, because the
    lagging thrust still adds speed.
    """
    box = _box(vehicle, fastest)
    m, vo = box.mass(), box.obstacle()
    lightest = box.brakes.masses[0]
    r = Variable("r", ca.SX.sym("r"), "m/s", 0.0, box.swing / lightest, "speed at which the clearance opens")
    statement = (
        "d/dt (l - S) >= 0 while the vehicle brakes and s = -r < 0 < z, multiplied by F': z (D(v_o + r) - F_b) <= r F'"
    )
    left = (box.swing / m.symbol - r.symbol) * (box.most_drag(vo.symbol + r.symbol) - box.brakes.least)
    return _claim("braking-retreat", statement, (m, r, vo), left, r.symbol * box.left(vo.symbol), "N m/s")


def braking_mass(vehicle: Vehicle, fastest: float) -> Claim:
    """Return the claim that the stopping distance is largest at an end of the mass range.

    The stopping distance is a convex function of the mass: its graph between two masses lies below the chord.
    """
    box = _box(vehicle, fastest)
    s = box.closing()
    q = Variable("q", ca.SX.sym("q"), "N s", 0.0, box.swing, "momentum that the lagging thrust still adds")
    lightest, heaviest = box.brakes.masses
    above = Variable("above", ca.SX.sym("above"), "kg", 0.0, heaviest - lightest, "mass minus the lightest mass")
    below = Variable("below", ca.SX.sym("below"), "kg", 0.0, heaviest - lightest, "heavier mass minus the mass")
    a, b, m = above.symbol, below.symbol, lightest + above.symbol

    def distance(mass: ca.SX) -> ca.SX:
        return mass * (s.symbol + q.symbol / mass) ** 2

    statement = "m z^2 with z = s + q/m lies below its chord between two masses, multiplied by their difference"
    chord = b * distance(ca.SX(lightest)) + a * distance(m + b)
    return _claim("braking-mass", statement, (s, q, above, below), distance(m) * (a + b), chord, "kg^2 m^2/s^2")
