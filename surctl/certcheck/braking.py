"""Check of a braking certificate: a vehicle with inertia, lag and sampling never touches what it brakes for.

The claim: under its assumptions, clearance ≥ m G(z) ≥ 0 for ever once it was so, z = s + (what the lag leaves)/m; the
proof is that of `surctl.guidance.braking`, and here each of its inequalities is checked for the numbers at hand, in
exact rational numbers, every figure rounded to the safe side:

- the table of G is a convex super-solution, before every obstacle of the claim, in retreat too;
- the range needed, at the speeds of the claim's table, is what the table says;
- with a law: wherever its bound does not make it brake with the force that is counted on, the range needed is there.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from surctl.certcheck.braking_claim import BrakingClaim, GuardedLaw, read_claim
from surctl.certcheck.braking_distance import (
    BrakingDistance,
    Forces,
    drag,
    forces,
    largest_disturbance,
    read_distance,
    rounded,
)
from surctl.certcheck.document import Rejected
from surctl.certcheck.patience import go_on
from surctl.certcheck.region_claim import record

__all__ = ["check"]

_FIGURE = 10**4  # figures of the table are rounded up to 0.1 mm
_FIRST, _FINEST = Fraction(1, 100), Fraction(1, 10**6)  # [m/s] cells of the law's bound


def check(document: Mapping[str, Any]) -> None:
    """Check a braking certificate whose format and hash are in order.

    Raises:
        Rejected: with the first thing that is not proved.
    """
    record(document, ("format", "version", "kind", "claim", "proof", "sha256"), "the certificate")
    claim = read_claim(document.get("claim"))
    tables = record(document.get("proof"), ("distances",), "proof")["distances"]
    if not isinstance(tables, list) or len(tables) != len(claim.obstacles):
        raise Rejected("proof.distances must have a table for each obstacle")
    _check_steady(claim)
    _check_limit(claim)
    for column, obstacle in enumerate(claim.obstacles):
        at = forces(claim, obstacle)
        distance = read_distance(claim, at, tables[column])
        _check_figures(claim, at, distance, column)
        if claim.law is not None:
            _check_law(claim, claim.law, at, distance)


def _check_steady(claim: BrakingClaim) -> None:
    """Over one period a higher speed at its start stays the higher one, so that the range needed rises with it."""
    fastest = claim.fastest + claim.speed_error + claim.current
    steepest = claim.linear[1] + 2 * claim.quadratic[1] * (fastest + claim.sideways)
    if claim.period * steepest > claim.mass[0]:
        raise Rejected("the period is too long for so light a vehicle")


def _check_limit(claim: BrakingClaim) -> None:
    """The braking force is used up by the largest drag at the stated speed, to 0.1 mm/s."""

    def left(obstacle: Fraction) -> Fraction:
        through = obstacle + claim.current
        return claim.brake - largest_disturbance(claim, through) - drag(claim, through)

    if not left(claim.limit + Fraction(1, _FIGURE)) < 0 <= left(claim.limit):
        raise Rejected("the limit speed of an obstacle is another one")


def needed(
    claim: BrakingClaim, at: Forces, distance: BrakingDistance, low: Fraction, high: Fraction, since: Fraction
) -> Fraction:
    """Range [m] that is enough for a period without braking at any measured speed from low to high [m/s].

    `since` is the largest speed since the echo, as measured.

    Going back faster than the obstacle comes on, drag pushes more, and what it gains meanwhile counts.
    """
    closing, period = high + claim.speed_error + at.obstacle, claim.period
    astern = max(at.through, claim.current + claim.speed_error - low)
    gain = (claim.most + largest_disturbance(claim, astern) + drag(claim, astern)) / claim.mass[0]
    travelled = max(closing * period + gain * period**2 / 2, Fraction(0))
    return _stale(claim, at, since) + travelled + distance.worst(claim, at, closing + gain * period, at.swing)


def _stale(claim: BrakingClaim, at: Forces, since: Fraction) -> Fraction:
    """By how much the clearance may be less than the range that was read [m]."""
    return claim.range_error + max(since + claim.speed_error + at.obstacle, Fraction(0)) * claim.age


def _check_figures(claim: BrakingClaim, at: Forces, distance: BrakingDistance, column: int) -> None:
    """The table: closed form without the help of drag, way with it, range needed."""
    left = claim.brake - at.disturbance - drag(claim, at.through)
    for row, speed in enumerate(claim.speeds):
        closing = speed + at.obstacle
        closed = max(m * (closing + at.swing / m) ** 2 / (2 * left) for m in claim.mass)
        for name, stated, computed in (
            ("closed_m", claim.closed, closed),
            ("distance_m", claim.distance, distance.worst(claim, at, closing, at.swing)),
            ("needed_m", claim.needed, needed(claim, at, distance, speed, speed, speed)),
        ):
            up = Fraction(-(-computed.numerator * _FIGURE // computed.denominator), _FIGURE)
            if stated[row][column] != up:
                raise Rejected(
                    f"table.{name} at {float(speed):g} m/s before {float(at.obstacle):g} m/s is {float(up):g}, "
                    f"not {float(stated[row][column]):g}"
                )


def _check_law(claim: BrakingClaim, law: GuardedLaw, at: Forces, distance: BrakingDistance) -> None:
    """margin + K(b) ≥ range needed at b + x(b), for every bound b: where the law does not brake, the range is there.

    K(b) is the distance at which the law's bound is b, and x the excess over it at which the velocity loop asks for
    F_b. K rises, and so do the range needed and x: cells of b, halved as far as need be, from where the range that is
    read would be of a negative clearance.
    """
    if claim.brake > law.limit:
        raise Rejected("the law's thrust limit is below the force that is counted on")
    top = claim.fastest  # the vehicle is never faster: above, the bound is out of reach
    start = _no_clearance(law, at, claim)
    cells, least = [(start, start + _FIRST)], _stale(claim, at, claim.fastest)
    while cells:
        go_on()
        low, high = cells.pop()
        held = max(law.margin + _bound_distance(law, at, claim.period, low), least)  # the clearance is never negative
        fast = min(high + _excess(claim, law, high), claim.fastest)
        enough = needed(claim, at, distance, low + _excess(claim, law, low), fast, claim.fastest)
        if held < enough:
            if high - low < _FINEST:
                raise Rejected(
                    f"the law's margin is too small: bound to {float(low):.4f} m/s before an obstacle of "
                    f"{float(at.obstacle):g} m/s it keeps {float(held):.4f} m, and {float(enough):.4f} m are needed"
                )
            middle = (low + high) / 2
            cells += [(middle, high), (low, middle)]
            continue
        if not cells and high < top:
            cells.append((high, high + _FIRST))


def _excess(claim: BrakingClaim, law: GuardedLaw, bound: Fraction) -> Fraction:
    """x [m/s]: the loop asks for drag(v_d) + m k_v (v_d − v), v_d = b − gain x at most, drag by axis, sideways too."""
    v, w = max(bound, Fraction(0)), claim.sideways
    square = v**2 + Fraction(385, 1000) * v * w + Fraction(7072, 10**4) * w**2
    forward = law.linear * v + law.quadratic * square
    return rounded((claim.brake + forward) / (law.mass * law.k_v * (1 + law.gain)))


def _bound_distance(law: GuardedLaw, at: Forces, period: Fraction, bound: Fraction) -> Fraction:
    """K(b) [m]: the inverse of the law's bound, which goes on with its slope where that asks for a retreat."""
    force = law.brake * law.limit
    if law.barrier == "simple":
        c, t = bound + at.obstacle, law.reaction
        return c * t + max(c, Fraction(0)) ** 2 * law.mass / (2 * force) + t * at.obstacle
    lightest, heaviest, most, lag, linear, quadratic = law.stopping
    dragged = linear * at.obstacle + quadratic * at.obstacle**2
    left = force - dragged
    if left * 50 < force:
        raise Rejected("the law's own bound counts on too little before that obstacle")
    gain, swing = (most + dragged) / lightest, lag * (most + force)
    c = bound + at.obstacle + gain * period
    distances = []
    for m in (lightest, heaviest):
        k, lost = m / (2 * left), swing / m
        distances.append(
            k * max(c, Fraction(0)) ** 2 + (period + 2 * k * lost) * c + k * lost**2 - gain * period**2 / 2
        )
    return max(distances)


def _no_clearance(law: GuardedLaw, at: Forces, claim: BrakingClaim) -> Fraction:
    """A bound [m/s] that no range that can be read asks for: margin + K below 0 by the error of a range."""
    bound = -at.obstacle
    for _ in range(10_000):
        if law.margin + _bound_distance(law, at, claim.period, bound) <= -claim.range_error:
            return bound
        bound -= _FINEST * 1000
    raise Rejected("the law's bound does not reach the obstacle")
