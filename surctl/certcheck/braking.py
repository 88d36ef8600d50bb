"""Check of a braking certificate, which claims that a vehicle with inertia and thrust lag never touches an obstacle.

Under the assumptions of the claim, clearance ≥ ρ m G(z) ≥ 0 holds at all later instants if it holds at one instant.
Here m is the mass of the lighter axis, ρ the ratio of the masses, z = s + q/m, s = v + v_o the closing speed of a
vehicle with the speed v and an obstacle with the speed v_o, and q the impulse towards the obstacle that the thrust
still delivers because of its lag. The certificate states G', which does not fall, is linear between knots and constant
beyond the last one, and proves inequalities, which this module derives from the claim and
`surctl.certcheck.inequality` checks:

1. G'(s) (F_b − f + D(s − v_o − c)) ≥ s with the guaranteed thrust F_b, the largest disturbance f, the speed c of the
   current, and the least drag D for motion ahead, the largest one for motion astern, for 0 ≤ s ≤ V + v_o;
2. ρ G'(q/m − r) (D(v_o + c + r) + f − F_b) ≤ r for all speeds r of a retreat, if G is to count there (`retreats`);
3. for a law: travelled + ρ m G(z⁺) ≤ clearance, for all values b of the law's speed bound and all speeds at which the
   velocity loop commands less than F_b, where z⁺ is the largest z after a control period.

Lemma: while the vehicle brakes, ż ≤ −(F_b − f + D)/(ρ m), and G'(z) ≥ G'(s) as z ≥ s, so that (ρ m G(z))˙ ≤ −s by
1., and the clearance l satisfies l̇ ≥ −s: l − ρ m G(z) does not fall. It does not fall during a retreat either, by 2.;
without 2., G counts as that at s = 0, while l rises and q falls. As G is convex, ρ m G(s + q/m) is convex in m, so that
the ends of the range of masses decide. After a period without braking, the range that the rule needs, or 3., leaves
l ≥ ρ m G(z).

In 3., z rises by what the loop commands, u ≤ U with U ≥ −F_b, and by the thrust across if the hull turns. If the masses
differ, m ≤ μ ≤ ρ m, a thrust F < 0 counts as F/μ to v̇, but as F/m to z. So let Z = s + τ (max(F, min(U, 0)) + F_b)/m,
which is at least z, and at first at most s + q/m. Where F ≥ 0, m Ż ≤ u + f + D; where U ≤ F < 0, m Ż ≤ u − F +
max(f + D + F, 0), with u − F ≤ 0; where F < min(U, 0), Z changes with s only. So z never exceeds s + q/m +
T max(U + f + D, 0)/m in a period T. Where b ≥ V, the command is at most that for b = V.
`analysis/15_braking_barrier/proof.md` derives f, q and the largest thrust.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from math import nextafter
from typing import Any

from surctl.certcheck.braking_claim import BrakingClaim, GuardedLaw, read_claim
from surctl.certcheck.document import Rejected, record
from surctl.certcheck.enclosure import enclose
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.fields import Pair, row
from surctl.certcheck.identity import Exact
from surctl.certcheck.inequality import Obligation, check_all, listed

__all__ = [
    "Distance", "bound_distance", "check", "disturbance", "drag_ranges", "left_at", "read_distance", "thrust_ahead",
    "upper",
]  # fmt: skip

_FIGURE, _DIGITS = 10**4, 10**12  # ranges of the table are rounded up to 0.1 mm, other numbers to 12 decimals


def _text(x: Fraction) -> str:
    decimal = format(Decimal(x.numerator) / x.denominator, "f")
    return f"({decimal if Fraction(decimal) == x else x})"


@lru_cache(1024)
def upper(text: str) -> Fraction:
    """Return an upper bound with 12 decimals of an expression without variables."""
    table = ExpressionTable(())
    sign, man, exp, _ = enclose(table, [table.read(text)], [])[0][1]
    value = (-1) ** sign * Fraction(int(man)) * Fraction(2) ** int(exp)
    return Fraction(-(-value.numerator * _DIGITS // value.denominator), _DIGITS)


def drag_ranges(claim: BrakingClaim) -> tuple[Pair, Pair]:
    """Return the ranges of the drag coefficients for one mass μ along n; unequal masses weight the axes differently.

    With n = (c, s) in axes of the hull, the light one first, and N = ρ c² + s², the force along n is that of an equal
    mass μ = ρ m/N whose light axis has ρ/N times its force, and the other 1/N times; 1 ≤ N ≤ ρ.
    """
    ratio = claim.ratio if claim.drag == "axes" else 1
    linear, quadratic = ((low / ratio, high * ratio) for low, high in (claim.linear, claim.quadratic))
    return linear, quadratic


def thrust_ahead(claim: BrakingClaim) -> Fraction:
    """Return F⁺, the largest thrust towards the obstacle [N]: most_n, or less if the law's velocity loop commands less.

    The loop commands M k_v (v_d − v) + D(v_d). While it does not brake, |v_d| ≤ cap and |v| ≤ fastest. While it begins
    to brake, v_d tends to the vector s that has the true speed across and no larger speed along the direction of the
    obstacle, where M k_v (s − v) does not push; and D is convex in |v_d|.
    """
    law = claim.law
    if law is None:
        return claim.most
    error, x, y = law.cap + claim.fastest + claim.speed_error, max(law.linear), max(law.quadratic)
    ahead, square = max(law.mass) * law.k_v * error + x * law.cap + y * law.cap**2, law.cap**2 + claim.sideways**2
    return min(claim.most, upper(f"max({ahead}, {_text(x)}*sqrt({square}) + {_text(y * square)})"))


def _across(claim: BrakingClaim) -> Fraction:
    """Return the largest thrust across n [N]: side_n, or what was commanded before braking and still lags."""
    return max(claim.side, thrust_ahead(claim)) if claim.turn or claim.ratio > 1 else claim.side


def _drag(claim: BrakingClaim, astern: str) -> str:
    """Return the largest drag D(v) [N] at a speed v ≥ 0 [m/s]."""
    (_, linear), (_, quadratic) = drag_ranges(claim)
    return f"({_text(linear)}*({astern}) + {_text(quadratic)}*({astern})^2)"


def disturbance(claim: BrakingClaim, astern: str, own: str = "") -> str:
    """Return the largest disturbance f [N] for a vehicle that moves astern through the water at up to `astern` [m/s].

    `own` is a lower bound of its own speed astern [m/s]; what it leaves of the largest speed may be sideways.

    f includes the drag that a sideways speed causes in addition to D(astern), and the braking force that is lost
    because the hull turns. If the masses differ, f also includes the thrust and the drag across n and the Coriolis
    force: κ = (ρ − 1)/(2√ρ) is the largest share of a force across n that acts along n. For a hull that turns at r,
    the Coriolis force at v along n and w across n is r m (ρ − 1)((ρ + 1) c s v + (ρ c² − s²) w)/N.
    """
    (low, high), (low2, high2) = drag_ranges(claim)
    ratio, turned, w = claim.ratio, claim.turn * claim.lag, _text(min(claim.sideways, claim.fastest))
    if own:
        w = f"min({_text(claim.sideways)}, sqrt(max({_text(claim.fastest**2)} - ({own})^2, 0)))"
    fast = f"max({astern}, {_text(claim.fastest)})"
    share = _text(upper(f"({ratio - 1})/(2*sqrt({_text(ratio)}))"))
    if claim.drag == "along":  # by how much (X + X2 √(a² + w²)) a exceeds D(a)
        total = f"{_text(high2)}*({astern})*(sqrt(({astern})^2 + {w}^2) - ({astern}))"
        if ratio > 1:
            total += f" + {share}*{w}*({_text(high)} + {_text(high2)}*({fast} + {w}))"
    else:
        total = f"{_text((high - low) / 2)}*{w} + {_text(high2)}*sqrt(2)*({astern})*{w}"
        total += f" + {_text(2 * high2 - low2)}*{w}^2*sqrt(1/27)"
    lost = claim.disturbance + ratio * turned**2 * max(thrust_ahead(claim), claim.brake)
    if ratio > 1:
        total += f" + ({share} + {_text(ratio * turned)})*{_text(_across(claim))}"
        fast = f"{fast}*{_text(upper(f'{_text(ratio + 1)}/(2*sqrt({_text(ratio)}))'))} + {w}"
        total += f" + {_text(claim.turn * claim.mass[1] * (ratio - 1))}*({fast})"
    return f"({total} + {_text(lost)})"


def left_at(claim: BrakingClaim, obstacle: Fraction) -> Fraction:
    """Return a lower bound of the braking force at closing speed 0 [N]."""
    through = _text(obstacle + claim.current)
    return claim.brake - upper(f"{disturbance(claim, through)} + {_drag(claim, through)}")


def _steepest(claim: BrakingClaim) -> Fraction:
    """Return by how much drag and Coriolis force towards the obstacle can rise with a speed astern [N s/m]."""
    fastest = claim.fastest + claim.speed_error + claim.current
    steepest = claim.linear[1] + 2 * claim.quadratic[1] * (fastest + claim.sideways)
    return claim.ratio * steepest + claim.turn * claim.mass[1] * (claim.ratio**2 - 1)


@dataclass(frozen=True)
class Distance:
    """The braking distance ρ m G(z) before one obstacle, and the inequalities that prove it.

    Attributes:
        claim: the claim.
        obstacle: approach speed v_o of the obstacle [m/s].
        knots: closing speeds between which G' is linear [m/s]: the first one is 0.
        slopes: G' at the knots [m/(N s)].
        retreats: whether G counts at closing speeds below 0; if not, it is that at 0.

    Raises:
        Rejected: drag and disturbance are as large as the braking force, or the claim is not covered.
    """

    claim: BrakingClaim
    obstacle: Fraction
    knots: tuple[Fraction, ...]
    slopes: tuple[Fraction, ...]
    retreats: bool

    def __post_init__(self) -> None:
        claim = self.claim
        if claim.ratio > 1 and claim.current:
            raise Rejected("a current together with unequal masses is not covered")
        if left_at(claim, self.obstacle) <= 0:
            raise Rejected(
                f"braking guarantees nothing for an obstacle that approaches at {float(self.obstacle):g} m/s"
            )
        if self.obstacle > claim.fastest:  # braking ends with a retreat at the speed of the obstacle
            raise Rejected(f"an obstacle of {float(self.obstacle):g} m/s is faster than fastest_m_per_s")
        if self.knots[0] or any(b <= a for a, b in pairwise(self.knots)) or len(self.slopes) != len(self.knots):
            raise Rejected("the knots of the braking distance must start at 0 and rise, with a slope for each knot")
        if self.slopes[0] < 0 or any(b < a for a, b in pairwise(self.slopes)):
            raise Rejected("the slopes of the braking distance must not fall")
        if self.knots[-1] < claim.fastest + self.obstacle:
            raise Rejected("the braking distance ends at too low a speed")
        if claim.turn and not self.retreats:
            raise Rejected("the braking distance of a hull that turns must count during a retreat")

    @property
    def through(self) -> Fraction:
        """The speed of the vehicle astern through the water at which the closing speed is 0, v_o + c [m/s]."""
        return self.obstacle + self.claim.current

    @property
    def swing(self) -> Fraction:
        """The largest impulse q towards the obstacle that the thrust still delivers because of its lag [N s]."""
        claim = self.claim
        swing = claim.lag * (thrust_ahead(claim) + claim.brake)
        return swing + claim.turn * claim.lag**2 * _across(claim)

    def _pieces(self) -> list[tuple[Fraction, Fraction, Fraction, Fraction]]:
        """Return start, width, first value and slope of G' in each piece."""
        pairs = zip(pairwise(self.knots), pairwise(self.slopes), strict=True)
        return [(a, b - a, g, (h - g) / (b - a)) for (a, b), (g, h) in pairs]

    def slope(self, z: str) -> str:
        """Return G'(z) for z ≥ 0 [m/(N s)]."""
        rises = [
            f"{_text(rise)}*min(max({z} - {_text(start)}, 0), {_text(width)})"
            for start, width, _, rise in self._pieces()
        ]
        return f"({' + '.join([_text(self.slopes[0]), *rises])})"

    def length(self, closing: str, mass: Fraction) -> str:
        """Return ρ m G(s + q/m) [m] at a closing speed s."""
        closing = closing if self.retreats else f"max({closing}, 0)"
        z = f"({closing} + {_text(upper(_text(self.swing / mass)))})"
        terms = [f"max({z} - {_text(self.knots[-1])}, 0)*{_text(self.slopes[-1])}"]
        for start, width, first, rise in self._pieces():
            y = f"min(max({z} - {_text(start)}, 0), {_text(width)})"
            terms.append(f"{y}*({_text(first)} + {_text(rise / 2)}*{y})")
        return f"{_text(self.claim.ratio * mass)}*({' + '.join(terms)})"

    def gain(self, speed: str, thrust: str) -> str:
        """Return the largest acceleration towards the obstacle [m/s²] at a thrust, from a measured speed on."""
        claim = self.claim
        astern = f"max({_text(self.through)}, {_text(claim.current)} + min({_text(claim.speed_error)} - ({speed}), "
        astern += f"{_text(claim.fastest)}))"
        return f"({thrust} + {disturbance(claim, astern)} + {_drag(claim, astern)})/{_text(claim.mass[0])}"

    def stale(self, since: Fraction) -> Fraction:
        """Return by how much a measured range can exceed the true clearance [m] because of its error and its age."""
        claim = self.claim
        return claim.range_error + max(since + claim.speed_error + self.obstacle, Fraction(0)) * claim.age

    def after(self, speed: str, rise: str, mass: Fraction) -> str:
        """Return what a period without braking takes [m], and the braking distance after it.

        `speed` is the measured speed at its start, and `rise` by how much z rises [m/s].
        """
        claim, period = self.claim, _text(self.claim.period)
        closing = f"({speed} + {_text(claim.speed_error + self.obstacle)})"
        ahead = self.gain(speed, _text(thrust_ahead(claim)))
        travelled = f"max({closing}*{period} + {ahead}*{_text(claim.period**2 / 2)}, 0)"
        most = _text(claim.fastest + self.obstacle)
        return f"{travelled} + {self.length(f'min({closing} + {rise}, {most})', mass)}"

    def needed(self, speed: Fraction) -> Fraction:
        """Return the range [m] that suffices at a measured own speed, if no speed since the last echo was higher.

        While the vehicle moves backward faster than the obstacle approaches, drag accelerates it towards the obstacle.
        """
        gain = upper(self.gain(_text(speed), _text(thrust_ahead(self.claim))))
        rise = _text(gain * self.claim.period)
        clearance = max(upper(self.after(_text(speed), rise, m)) for m in self.claim.mass)
        exact = self.stale(speed) + clearance
        return Fraction(-(-exact.numerator * _FIGURE // exact.denominator), _FIGURE)

    def obligations(self) -> list[Obligation]:
        """Return the inequalities 1 to 3 of the module."""
        claim, swing, through = self.claim, self.swing, _text(self.through)
        (low, high), (low2, high2) = drag_ranges(claim)
        f = upper(disturbance(claim, through))
        least = low2 if claim.drag == "along" else low2 * Fraction(70710678, 10**8)  # at 45° to the axes of the hull
        needed = list[Obligation]()
        for start, width, first, rise in self._pieces():
            ahead = start >= self.through
            if not ahead and start + width > self.through:
                raise Rejected("the speed through the water changes sign inside a piece: put a knot there")
            x, y = (low, least) if ahead else (high, -high2)
            v = f"(y + {_text(start)} - {through})"
            force = f"({_text(claim.brake - f)} + {v}*({_text(x)} + {_text(y)}*{v}))"
            closing, slope = f"y + {_text(start)}", f"({_text(first)} + {_text(rise)}*y)"
            if not start and not first:  # both sides are multiples of y
                closing, slope = "1", _text(rise)
            needed.append(Obligation(("y",), [_span(Fraction(0), width)], closing, f"{slope}*{force}"))
        if self.retreats:
            most = upper(_text(swing / claim.mass[0]))
            widest = max(min(most, claim.fastest - self.obstacle), Fraction(0))
            astern, own = f"{through} + r", f"{_text(self.obstacle)} + r"
            over = f"({_drag(claim, astern)} + {disturbance(claim, astern, own)} - {_text(claim.brake)})"
            slope = self.slope(f"({_text(most)} - r)")
            left = f"{_text(claim.ratio)}*{slope}*{over}"
            needed.append(Obligation(("r",), [_span(Fraction(0), widest)], left, "r"))
        return needed if claim.law is None else [*needed, self._of_law(claim.law)]

    def _of_law(self, law: GuardedLaw) -> Obligation:
        """Return inequality 3, for both ends of the range of masses."""
        claim = self.claim
        if claim.brake > law.limit:
            raise Rejected("the law's thrust limit is below brake_n, the guaranteed braking force")
        if claim.fastest < law.cap:
            raise Rejected("the law wants a higher speed than fastest_m_per_s")
        loop = min(law.mass) * law.k_v * (1 + law.gain)
        over = "max(v - b, 0)"
        command = f"{_forward(claim, law, f'b - {_text(law.gain)}*{over}')} - {_text(loop)}*{over}"
        command = f"({command} + {_text(max(law.mass) * law.k_v)}*({over} - v + b))"
        aside = claim.ratio * claim.turn * claim.lag * _across(claim)
        turned = claim.turn * claim.period  # the command is held in axes of the hull, which turns during the period
        aside += turned * claim.most / 2 + turned**2 * claim.brake / 6
        short = claim.period * (_steepest(claim) + max(law.mass) * law.k_v) <= claim.mass[0]
        thrust = f"max({command}, {_text(-claim.brake)}) + {_text(aside)}" if short else _text(thrust_ahead(claim))
        rise = f"max({self.gain('v', thrust)}*{_text(claim.period)}, 0)"
        # at a lower bound, the law brakes at every speed
        low = -claim.fastest - (claim.brake + upper(_forward(claim, law, _text(claim.fastest)))) / loop
        box = [_span(low, claim.fastest), _span(-claim.fastest, claim.fastest)]
        clear = bound_distance(law, self.obstacle, claim.period)
        clear = f"max({clear} + {_text(law.margin - self.stale(claim.fastest))}, 0)"  # the clearance is never negative
        lengths = [self.after("v", rise, m) for m in sorted(set(claim.mass))]
        longest = lengths[0] if len(lengths) == 1 else f"max({', '.join(lengths)})"
        return Obligation(("b", "v"), box, longest, clear, [f"-({command}) - {_text(claim.brake)}"])


def _span(low: Fraction, high: Fraction) -> tuple[float, float]:
    """Return doubles whose decimals enclose a range; both are the same number if its ends are."""
    if low == high and Fraction(repr(float(low))) == low:
        return float(low), float(high)
    down, up = float(low), float(high)
    return (
        down if Fraction(repr(down)) <= low else nextafter(down, -1e300),
        up if Fraction(repr(up)) >= high else nextafter(up, 1e300),
    )


def _forward(claim: BrakingClaim, law: GuardedLaw, desired: str) -> str:
    """Return the largest force along n [N] of the loop's drag model at a desired speed along n, and of errors across n.

    The law's drag model computes the drag of each axis separately and includes the sideways speed; at a speed astern it
    brakes. If the masses of the law's model differ, an error of up to 2 w across adds a force along.
    """
    (low, high), (low2, high2), (light, heavy) = (sorted(pair) for pair in (law.linear, law.quadratic, law.mass))
    w, v = claim.sideways, f"max({desired}, 0)"
    side = f"{_text(high2 * w)}*sqrt(2)*{v} + {_text((2 * high2 - low2) * w**2)}*sqrt(1/27)"
    if low == high and low2 == high2:
        side = f"min({side}, {_text(high2 * w)}*({v}*0.385 + {_text(w)}*0.7072))"
    aside = _text((high - low) * w / 2 + (heavy - light) * law.k_v * w)
    along = f"{_text(high)}*{v} + {_text(high2)}*{v}^2 + {side} + {aside}"
    return f"({along} - {_text(low)}*({v} - ({desired})) - {_text(low2)}*sqrt(1/2)*({v} - ({desired}))^2)"


def bound_distance(law: GuardedLaw, obstacle: Fraction, period: Fraction) -> str:
    """Return K(b) [m], the distance at which the law's speed bound is b; for b far below 0, K is linear in b."""
    force = law.brake * law.limit
    if law.barrier == "simple":
        c, t = f"(b + {_text(obstacle)})", law.reaction
        return f"({c}*{_text(t)} + max({c}, 0)^2*{_text(max(law.mass) / (2 * force))} + {_text(t * obstacle)})"
    lightest, heaviest, most, lag, linear, quadratic = law.stopping.values()
    dragged = linear * obstacle + quadratic * obstacle**2
    left = force - dragged
    if left * 50 < force:
        raise Rejected("the law's speed bound assumes too little braking force at the speed of the obstacle")
    gain, swing = (most + dragged) / lightest, lag * (most + force)
    c, distances = f"(b + {_text(obstacle + gain * period)})", []
    for m in (lightest, heaviest):
        k, lost = m / (2 * left), swing / m
        distances.append(
            f"{_text(k)}*max({c}, 0)^2 + {_text(period + 2 * k * lost)}*{c} + "
            f"{_text(k * lost**2 - gain * period**2 / 2)}"
        )
    return f"max({', '.join(distances)})"


def check(document: Mapping[str, Any]) -> None:
    """Check a braking certificate whose format and hash are verified.

    Raises:
        Rejected: the certificate does not prove its claim; the message names the first failure.
    """
    record(document, ("format", "version", "kind", "claim", "distances", "proofs", "sha256"), "the certificate")
    claim = read_claim(document["claim"])
    if claim.period * _steepest(claim) > claim.mass[0]:  # else the needed range rises with the speed
        raise Rejected("the control period is too long for the mass and drag of the vehicle")
    if left_at(claim, claim.limit) < 0:
        raise Rejected("an obstacle as fast as table.limit_obstacle_m_per_s uses up the braking force")
    stated, obligations = listed(document["distances"]), list[Obligation]()
    if len(stated) != len(claim.obstacles):
        raise Rejected("there must be one braking distance for each obstacle")
    for column, obstacle in enumerate(claim.obstacles):
        distance = read_distance(claim, obstacle, stated[column])
        for speed, ranges in zip(claim.speeds, claim.needed, strict=True):
            if ranges[column] < (figure := distance.needed(speed)):
                raise Rejected(
                    f"table.needed_m at {float(speed):g} m/s towards an obstacle of {float(obstacle):g} m/s must be "
                    f"at least {float(figure):g} m, not {float(ranges[column]):g} m"
                )
        obligations += distance.obligations()
    check_all(obligations, document["proofs"], Exact(ExpressionTable(("y",))))


def read_distance(claim: BrakingClaim, obstacle: Fraction, stated: Any) -> Distance:
    """Return the braking distance before one obstacle from its entry in the certificate."""
    entry = record(stated, ("knots", "slopes", "retreats"), "distances")
    if type(entry["retreats"]) is not bool:
        raise Rejected("distances: 'retreats' must be true or false")
    knots, slopes = (row(entry[key], f"distances: {key}") for key in ("knots", "slopes"))
    return Distance(claim, obstacle, knots, slopes, entry["retreats"])
