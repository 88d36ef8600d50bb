"""The braking distance m G(z), with a table of the convex function G, for which G' ≥ z/(braking force) is checked.

Here m is the mass, z = s + q/m, s = v + v_o is the closing speed of a vehicle with speed v and an obstacle with speed
v_o, and q is the impulse towards the obstacle that the thrust still delivers because of its lag and of the hull's
rotation. G(0) = 0, and G' is piecewise linear with the value g_j at the knot z_j (0 = z_0 < z_1 < …). Because s never
exceeds the largest closing speed, G' may stay constant from there. At own speed v =
z − v_o, the braking force is F_b − f + D(v − c), where F_b is the guaranteed thrust, f the largest disturbance, c the
speed of the current, and D the least drag for motion ahead and the largest drag for motion astern. Between two knots,
the inequality says that a cubic polynomial in z is not negative. This holds if no Bernstein coefficient of the
polynomial is negative. The checks use exact arithmetic.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from typing import Any

from surctl.certcheck.braking_claim import BrakingClaim
from surctl.certcheck.document import Rejected, record
from surctl.certcheck.region_claim import number
from surctl.certcheck.region_exact import root_down, root_up

__all__ = ["BrakingDistance", "across", "drag", "forces", "read_distance", "rounded"]

Pair = tuple[Fraction, Fraction]

_MOST_KNOTS = 400
_DIGITS = 10**12
_CELLS = 64

ROOT2 = (Fraction(141421356, 10**8), Fraction(141421357, 10**8))
HALF_ROOT2 = Fraction(70710678, 10**8)
"""A number just below 1/√2, the least share of axis-by-axis quadratic drag that acts along the motion (at 45°)."""
ROOT27 = Fraction(19245009, 10**8)
"""A number just above 1/(3√3)."""


def rounded(value: Fraction) -> Fraction:
    """Return the value rounded up to 12 decimals."""
    return Fraction(-(-value.numerator * _DIGITS // value.denominator), _DIGITS)


def drag(claim: BrakingClaim, speed: Fraction) -> Fraction:
    """Return the largest drag D(v) [N] at a speed v ≥ 0 [m/s]."""
    linear, quadratic = drag_ranges(claim)
    return linear[1] * speed + quadratic[1] * speed**2


def drag_ranges(claim: BrakingClaim) -> tuple[Pair, Pair]:
    """Return the ranges of the drag coefficients for one mass μ along n; unequal masses weight the axes differently.

    With n = (c, s) in axes of the hull, the light one first, and N = ρ c² + s², the force along n is that of an equal
    mass μ = ρ m/N whose light axis has ρ/N times its force, and the other 1/N times; 1 ≤ N ≤ ρ.
    """
    ratio = claim.ratio if claim.drag == "axes" else 1
    linear, quadratic = ((low / ratio, high * ratio) for low, high in (claim.linear, claim.quadratic))
    return linear, quadratic


def coupling(claim: BrakingClaim) -> Fraction:
    """Return κ = (ρ − 1)/(2√ρ), the largest share of a force across n that acts along n because the masses differ."""
    return (claim.ratio - 1) / (2 * root_down(claim.ratio)) if claim.ratio > 1 else Fraction(0)


def _turning(claim: BrakingClaim, through: Fraction, w: Fraction) -> Fraction:
    """Return the largest Coriolis force of unequal masses along n [N], for a hull that turns at r.

    Along n at v and across n at w, it is r m (ρ − 1)((ρ + 1) c s v + (ρ c² − s²) w)/N.
    """
    fast = max(through, claim.fastest) * (claim.ratio + 1) / (2 * root_down(claim.ratio))
    return claim.turn * claim.mass[1] * (claim.ratio - 1) * (fast + w)


def thrust_ahead(claim: BrakingClaim) -> Fraction:
    """Return F⁺, the largest thrust towards the obstacle [N]: most_n, or less if the law's velocity loop commands less.

    The loop commands M k_v (v_d − v) + D(v_d). While it does not brake, |v_d| ≤ cap and |v| ≤ fastest. While it begins
    to brake, v_d tends to the vector s that has the true speed across and no larger speed along the direction of the
    obstacle, where M k_v (s − v) does not push; and D is convex in |v_d|.
    """
    law = claim.law
    if law is None:
        return claim.most

    def fed(square: Fraction) -> Fraction:
        return max(law.linear) * root_up(square) + max(law.quadratic) * square

    error = law.cap + claim.fastest + claim.speed_error
    ahead = max(law.mass) * law.k_v * error + max(law.linear) * law.cap + max(law.quadratic) * law.cap**2
    return min(claim.most, rounded(max(ahead, fed(law.cap**2 + claim.sideways**2))))


def across(claim: BrakingClaim) -> Fraction:
    """Return the largest thrust across n [N]: side_n, or what was commanded before braking and still lags."""
    return max(claim.side, thrust_ahead(claim)) if claim.turn or claim.ratio > 1 else claim.side


@dataclass(frozen=True)
class Forces:
    """Speeds and forces in the encounter with one obstacle.

    Attributes:
        obstacle: approach speed v_o [m/s].
        through: speed of the vehicle astern through the water, v_o + c, at which the closing speed is 0 [m/s].
        disturbance: f, the largest force towards the obstacle (without drag) at closing speeds ≥ 0 [N].
        swing: q, the largest impulse towards the obstacle that the thrust still delivers because of its lag [N s].
    """

    obstacle: Fraction
    through: Fraction
    disturbance: Fraction
    swing: Fraction


def largest_disturbance(claim: BrakingClaim, through: Fraction, slowest: Fraction = Fraction(0)) -> Fraction:
    """Return the largest disturbance f [N] for a vehicle that moves astern through the water at up to `through` [m/s].

    `slowest` is a lower bound of its own speed astern [m/s]; what it leaves of the largest speed may be sideways.

    f includes the drag that a sideways speed causes in addition to D(through), and the braking force that is lost
    because the hull turns. If the masses differ, f also includes the thrust and the drag across n and the Coriolis
    force.
    """
    (low, high), (low2, high2) = drag_ranges(claim)
    w = min(claim.sideways, root_up(max(claim.fastest**2 - slowest**2, Fraction(0))))
    if claim.drag == "along":  # (X + X2 √(a² + w²)) a exceeds D(a) by at most X2 a w and X2 w²/2
        side = high2 * min(through * w, w**2 / 2)
        side += coupling(claim) * w * (high + high2 * (max(through, claim.fastest) + w))
    else:
        side = (high - low) * w / 2 + ROOT2[1] * high2 * through * w + (2 * high2 - low2) * w**2 * ROOT27
    turned = claim.turn * claim.lag
    lost = claim.ratio * turned**2 * max(thrust_ahead(claim), claim.brake)
    if claim.ratio > 1:
        lost += (coupling(claim) + claim.ratio * turned) * across(claim) + _turning(claim, through, w)
    return claim.disturbance + side + lost


def forces(claim: BrakingClaim, obstacle: Fraction) -> Forces:
    """Return the speeds and forces of the encounter with an obstacle that approaches at `obstacle` [m/s].

    Raises:
        Rejected: drag and disturbance are as large as the braking force.
    """
    if claim.ratio > 1 and claim.current:
        raise Rejected("a current together with unequal masses is not covered")
    through = obstacle + claim.current
    disturbance = largest_disturbance(claim, through)
    if claim.brake - disturbance - drag(claim, through) <= 0:
        raise Rejected(f"braking guarantees nothing for an obstacle that approaches at {float(obstacle):g} m/s")
    swing = claim.lag * (thrust_ahead(claim) + claim.brake) + claim.turn * claim.lag**2 * across(claim)
    return Forces(obstacle, through, disturbance, swing)


@dataclass(frozen=True)
class BrakingDistance:
    """The function G of the braking distance m G(z): its knots z_j, and its slopes g_j and values at these knots.

    `retreats` is whether the distance may be evaluated at closing speeds below 0; if not, it is that at 0. `straight`
    is whether the table reaches the largest closing speed; then G continues with its last slope.
    """

    knots: tuple[Fraction, ...]
    slopes: tuple[Fraction, ...]
    values: tuple[Fraction, ...]
    straight: bool
    retreats: bool = True

    def __call__(self, z: Fraction) -> Fraction:
        """Return an upper bound on G(max(z, 0)); raise Rejected for z beyond a table that may not be continued."""
        if z <= 0:
            return Fraction(0)
        if self.straight and z > self.knots[-1]:
            return self.values[-1] + self.slopes[-1] * (z - self.knots[-1])
        k = self._cell(z)
        t, width = z - self.knots[k], self.knots[k + 1] - self.knots[k]
        rise = (self.slopes[k + 1] - self.slopes[k]) / width
        return self.values[k] + self.slopes[k] * t + rise * t * t / 2

    def slope(self, z: Fraction) -> Fraction:
        """Return the slope G'(max(z, 0)); raise Rejected for z beyond a table that may not be continued."""
        if z <= 0:
            return self.slopes[0]
        if self.straight and z > self.knots[-1]:
            return self.slopes[-1]
        k = self._cell(z)
        share = (z - self.knots[k]) / (self.knots[k + 1] - self.knots[k])
        return self.slopes[k] + share * (self.slopes[k + 1] - self.slopes[k])

    def _cell(self, z: Fraction) -> int:
        if z > self.knots[-1]:
            raise Rejected("the table of the braking distance ends at too low a speed")
        return min(bisect_right(self.knots, z), len(self.knots) - 1) - 1

    def worst(self, claim: BrakingClaim, at: Forces, closing: Fraction, swing: Fraction) -> Fraction:
        """Return the largest ρ m G(s + q/m) [m] over the mass range; it is convex in m, so the ends suffice."""
        closing = closing if self.retreats else max(closing, Fraction(0))
        return rounded(max(claim.ratio * m * self(closing + swing / m) for m in claim.mass))


def read_distance(claim: BrakingClaim, at: Forces, table: Any) -> BrakingDistance:
    """Return the function G for one obstacle from its table, after a check of G' between every two knots.

    Raises:
        Rejected: the table is malformed or not convex, or one of its slopes is too small.
    """
    entry = record(table, ("knots", "slopes"), "proof.distances")
    lists = [entry[key] for key in ("knots", "slopes")]
    if any(not isinstance(x, list) or not 2 <= len(x) <= _MOST_KNOTS for x in lists) or len(lists[0]) != len(lists[1]):
        raise Rejected("proof.distances: knots and slopes must be lists of the same length")
    knots, slopes = (tuple(number(x, "proof.distances") for x in entries) for entries in lists)
    if knots[0] != 0 or any(b <= a for a, b in pairwise(knots)):
        raise Rejected("proof.distances: the knots must start at 0 and rise")
    if any(b < a for a, b in pairwise(slopes)):
        raise Rejected("the braking distance is not convex: a slope falls")
    values = [Fraction(0)]
    for k in range(len(knots) - 1):
        _check_cell(claim, at, knots[k : k + 2], slopes[k : k + 2])
        values.append(rounded(values[-1] + (knots[k + 1] - knots[k]) * (slopes[k] + slopes[k + 1]) / 2))
    distance = BrakingDistance(knots, slopes, tuple(values), knots[-1] >= claim.fastest + at.obstacle)
    return replace(distance, retreats=_retreats(claim, at, distance))


def _check_cell(claim: BrakingClaim, at: Forces, z: tuple[Fraction, ...], g: tuple[Fraction, ...]) -> None:
    """Check G' (F_b − f + D) ≥ z between two knots: no Bernstein coefficient of the cubic polynomial is negative."""
    h, left, (linear, quadratic) = z[1] - z[0], claim.brake - at.disturbance, drag_ranges(claim)
    behind = z[0] - at.through  # speed through the water at the cell's start
    if behind < 0 < z[1] - at.through:
        raise Rejected("the speed through the water changes sign inside a cell: put a knot there")
    if behind >= 0:
        share = Fraction(1) if claim.drag == "along" else HALF_ROOT2
        first, second = linear[0], quadratic[0] * share
    else:
        first, second = linear[1], -quadratic[1]
    f = (left + first * behind + second * behind**2, first + 2 * second * behind, second)
    if min(f[0], f[0] + f[1] * h + f[2] * h**2) <= 0:
        raise Rejected("no braking force is left in part of a cell")
    rise = (g[1] - g[0]) / h
    c = (g[0] * f[0] - z[0], g[0] * f[1] + rise * f[0] - 1, g[0] * f[2] + rise * f[1], rise * f[2])
    ends = (c[0], c[0] + c[1] * h / 3, c[0] + 2 * c[1] * h / 3 + c[2] * h**2 / 3,
            c[0] + c[1] * h + c[2] * h**2 + c[3] * h**3)  # fmt: skip
    if min(ends) < 0:
        raise Rejected(f"the braking distance is too short: its slope is too small at {float(z[0]):.4g} m/s")


def _retreats(claim: BrakingClaim, at: Forces, distance: BrakingDistance) -> bool:
    """Return whether ρ G'(q/m − r) (D(v_o + c + r) + f − F_b) ≤ r for the least mass and all speeds r of retreat.

    The vehicle is never faster than stated, so r ≤ q/m and v_o + r ≤ fastest, and its speed
    across is what they leave of it.

    Raises:
        Rejected: this fails, and the hull turns; then lagging thrust across n becomes thrust along n.
    """
    most = at.swing / claim.mass[0]
    widest = max(min(most, claim.fastest - at.obstacle), Fraction(0))
    for k in range(_CELLS):
        slow, quick = widest * k / _CELLS, widest * (k + 1) / _CELLS
        through = at.through + quick
        over = drag(claim, through) + largest_disturbance(claim, through, at.obstacle + slow) - claim.brake
        if over > 0 and claim.ratio * distance.slope(most - slow) * over > slow:
            if claim.turn:
                raise Rejected("drag during a retreat costs more distance than the retreat gains")
            return False
    return True
