"""Check of a braking certificate, which claims that a vehicle with inertia and thrust lag never touches an obstacle.

The claim states that, under its assumptions, the inequality clearance ≥ m G(z) ≥ 0 holds at all later instants if it
holds at one instant. Here m is the vehicle's mass, m G(z) is its braking distance, z = s + q/m, s is the closing speed,
and q is the impulse that the thrust lag still delivers. The vehicle can start to brake only at sampled instants.
`surctl.marine.guidance.braking` explains the proof. This module checks each inequality of the proof for the numbers of
the certificate, in exact rational arithmetic, with every number rounded to the safe side:

- for every obstacle of the claim, the table of G is convex and satisfies the differential inequality of the braking
  distance, also while the vehicle moves backward;
- the range in the claim's table is sufficient for every own speed in the table;
- if the claim contains a control law, the available range is sufficient in every state in which the law's speed bound
  does not command the guaranteed braking force.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fractions import Fraction
from typing import Any

from surctl.certcheck.braking_claim import BrakingClaim, GuardedLaw, read_claim
from surctl.certcheck.braking_distance import (
    HALF_ROOT2,
    ROOT2,
    ROOT27,
    BrakingDistance,
    Forces,
    across,
    drag,
    forces,
    largest_disturbance,
    read_distance,
    rounded,
    thrust_ahead,
)
from surctl.certcheck.document import Rejected, record
from surctl.certcheck.patience import go_on

__all__ = ["check"]

_FIGURE = 10**4  # distances of the table are rounded up to 0.1 mm
_PARTS, _BISECTIONS = 4, 14
_FIRST, _FINEST = Fraction(1, 100), Fraction(1, 2000)  # [m/s] first and least width of a cell in the bound b


def check(document: Mapping[str, Any]) -> None:
    """Check a braking certificate whose format and hash are verified.

    Raises:
        Rejected: the certificate does not prove its claim; the message names the first failure.
    """
    record(document, ("format", "version", "kind", "claim", "proof", "sha256"), "the certificate")
    claim = read_claim(document.get("claim"))
    tables = record(document.get("proof"), ("distances",), "proof")["distances"]
    if not isinstance(tables, list) or len(tables) != len(claim.obstacles):
        raise Rejected("proof.distances must have one table for each obstacle")
    _check_steady(claim)
    _check_limit(claim)
    for column, obstacle in enumerate(claim.obstacles):
        at = forces(claim, obstacle)
        distance = read_distance(claim, at, tables[column])
        _check_figures(claim, at, distance, column)
        if claim.law is not None:
            _check_law(claim, claim.law, at, distance)


def _check_steady(claim: BrakingClaim) -> None:
    """Check that the period is short enough for the needed range to rise with the speed at the start of the period."""
    if claim.period * _steepest(claim) > claim.mass[0]:
        raise Rejected("the control period is too long for the mass and drag of the vehicle")


def _steepest(claim: BrakingClaim) -> Fraction:
    """Return by how much drag and Coriolis force towards the obstacle can rise with a speed astern [N s/m]."""
    fastest = claim.fastest + claim.speed_error + claim.current
    steepest = claim.linear[1] + 2 * claim.quadratic[1] * (fastest + claim.sideways)
    return claim.ratio * steepest + claim.turn * claim.mass[1] * (claim.ratio**2 - 1)


def _check_limit(claim: BrakingClaim) -> None:
    """Check that disturbance and drag equal the braking force at the claimed limit of obstacle speed, to 0.1 mm/s."""

    def left(obstacle: Fraction) -> Fraction:
        through = obstacle + claim.current
        return claim.brake - largest_disturbance(claim, through) - drag(claim, through)

    if not left(claim.limit + Fraction(1, _FIGURE)) < 0 <= left(claim.limit):
        raise Rejected("claim.limit_obstacle_m_per_s is not the obstacle speed that uses up the braking force")


def needed(
    claim: BrakingClaim, at: Forces, distance: BrakingDistance, low: Fraction, high: Fraction, since: Fraction
) -> Fraction:
    """Return a range [m] that suffices for one period without braking, at any measured speed from low to high [m/s].

    `since` is the largest speed measured since the last echo of the sonar [m/s].

    While the vehicle moves backward faster than the obstacle approaches, drag accelerates the vehicle towards the
    obstacle. The returned range takes this increase of speed into account.
    """
    closing, gain = high + claim.speed_error + at.obstacle, _gain(claim, at, low, thrust_ahead(claim))
    later = min(closing + gain * claim.period, claim.fastest + at.obstacle)
    after = distance.worst(claim, at, later, at.swing)
    return _stale(claim, at, since) + _travelled(claim, closing, gain) + after


def _gain(claim: BrakingClaim, at: Forces, low: Fraction, thrust: Fraction) -> Fraction:
    """Return the largest acceleration towards the obstacle [m/s²] at a thrust and a measured speed ≥ `low`."""
    astern = max(at.through, claim.current + min(claim.speed_error - low, claim.fastest))
    return (thrust + largest_disturbance(claim, astern) + drag(claim, astern)) / claim.mass[0]


def _travelled(claim: BrakingClaim, closing: Fraction, gain: Fraction) -> Fraction:
    return max(closing * claim.period + gain * claim.period**2 / 2, Fraction(0))


def _sufficient(
    claim: BrakingClaim,
    law: GuardedLaw,
    at: Forces,
    distance: BrakingDistance,
    bounds: tuple[Fraction, Fraction],
    *,
    short: bool,
) -> Iterator[Fraction]:
    """Yield ranges [m] each of which suffices for a period without braking while the bound is in `bounds`, dearer last.

    `short` is whether the period is short enough for the range that follows from the loop's own thrust.
    """
    low, high = bounds
    first = tuple(_first_excess(claim, law, bound) for bound in bounds)
    yield needed(claim, at, distance, low + first[0], min(high + first[1], claim.fastest), claim.fastest)
    slow, fast = (_excess(claim, law, bound) for bound in bounds)
    if high + fast < -claim.fastest:  # the vehicle is never slower, so the law brakes at such a bound
        yield Fraction(0)
    yield needed(claim, at, distance, low + slow, min(high + fast, claim.fastest), claim.fastest)
    if short:
        yield _needed_by_loop(claim, law, at, distance, bounds, fast)


def _needed_by_loop(
    claim: BrakingClaim,
    law: GuardedLaw,
    at: Forces,
    distance: BrakingDistance,
    bounds: tuple[Fraction, Fraction],
    spread: Fraction,
) -> Fraction:
    """Return a range [m] that suffices for one period in which the law does not brake, its bound being within `bounds`.

    `spread` is x at the higher bound.

    Without braking, z rises by what the loop commands: m ż ≤ U + f + D for a command u ≤ U, U ≥ −F_b, and by the thrust
    across if the hull turns. If the masses differ, m ≤ μ ≤ ρ m, a thrust F < 0 counts as F/μ to v̇, but as F/m to z. So
    let Z = s + τ (max(F, min(U, 0)) + F_b)/m ≥ z, which begins at s + q/m at most. Where F ≥ 0, m Ż ≤ u + f + D; where
    U ≤ F < 0, m Ż ≤ u − F + max(f + D + F, 0), with u − F ≤ 0; where F < min(U, 0), Z changes with s only. So Z, and
    with it z, never exceeds s + q/m + T max(U + f + D, 0)/m in a period T.

    At a speed v > b the loop commands less and less, at v < b at most k_v m (b − v) more, so that z rises with v there,
    if the period is short enough. So the speeds from b to b + x suffice; they are divided into parts.
    """
    (low, high), most = bounds, Fraction(0)
    aside = claim.ratio * claim.turn * claim.lag * across(claim)
    turned = claim.turn * claim.period  # the command is held in axes of the hull, which turns during the period
    aside += turned * claim.most / 2 + turned**2 * claim.brake / 6
    for part in range(_PARTS):
        slow, fast = (spread * k / _PARTS for k in (part, part + 1))
        speed = min(high + fast, claim.fastest)
        slowest = max(low + slow, -claim.fastest)
        if high + fast < -claim.fastest:
            continue
        thrust = max(_forward(claim, law, high - law.gain * slow) - min(law.mass) * law.k_v * (1 + law.gain) * slow,
                     -claim.brake) + aside  # fmt: skip
        rise = max(_gain(claim, at, slowest, thrust) * claim.period, Fraction(0))
        closing = speed + claim.speed_error + at.obstacle
        after = distance.worst(claim, at, closing, at.swing + rise * claim.mass[0])
        most = max(most, _travelled(claim, closing, _gain(claim, at, slowest, thrust_ahead(claim))) + after)
    return _stale(claim, at, claim.fastest) + most


def _stale(claim: BrakingClaim, at: Forces, since: Fraction) -> Fraction:
    """Return by how much a measured range can exceed the true clearance [m] because of its error and its age."""
    return claim.range_error + max(since + claim.speed_error + at.obstacle, Fraction(0)) * claim.age


def _check_figures(claim: BrakingClaim, at: Forces, distance: BrakingDistance, column: int) -> None:
    """Check the claim's table: closed-form braking distance without drag, braking distance with drag, needed range."""
    left = claim.brake - at.disturbance - drag(claim, at.through)
    for row, speed in enumerate(claim.speeds):
        closing = speed + at.obstacle
        closed = max(claim.ratio * m * (closing + at.swing / m) ** 2 / (2 * left) for m in claim.mass)
        for name, stated, computed in (
            ("closed_m", claim.closed, closed),
            ("distance_m", claim.distance, distance.worst(claim, at, closing, at.swing)),
            ("needed_m", claim.needed, needed(claim, at, distance, speed, speed, speed)),
        ):
            up = Fraction(-(-computed.numerator * _FIGURE // computed.denominator), _FIGURE)
            if stated[row][column] != up:
                raise Rejected(
                    f"table.{name} at {float(speed):g} m/s towards an obstacle of {float(at.obstacle):g} m/s must be "
                    f"{float(up):g} m, not {float(stated[row][column]):g} m"
                )


def _check_law(claim: BrakingClaim, law: GuardedLaw, at: Forces, distance: BrakingDistance) -> None:
    """Check margin + K(b) ≥ needed range at speed b + x(b), for every value b of the law's speed bound.

    At the distance K(b) from the obstacle, the law's speed bound is b. If the speed exceeds the bound by x(b), the
    velocity loop commands the guaranteed braking force F_b. As long as the law does not brake with F_b, the speed is at
    most b + x(b). K, x and the needed range rise with b. So the inequality is checked on intervals of b, which are
    halved where necessary. The first interval starts at a value of b that corresponds to a negative clearance.
    """
    if claim.brake > law.limit:
        raise Rejected("the law's thrust limit is below brake_n, the guaranteed braking force")
    top = claim.fastest  # the vehicle is never faster, so it never exceeds a higher bound
    start = _no_clearance(law, at, claim)
    cells, least = [(start, start + _FIRST)], _stale(claim, at, claim.fastest)
    short = claim.period * (_steepest(claim) + max(law.mass) * law.k_v) <= claim.mass[0]
    while cells:
        go_on()
        low, high = cells.pop()
        held = max(law.margin + bound_distance(law, at, claim.period, low), least)  # the clearance is never negative
        enough = next(
            (enough for enough in _sufficient(claim, law, at, distance, (low, high), short=short) if enough <= held),
            None,
        )
        if enough is None:
            if high - low < _FINEST:
                enough = min(_sufficient(claim, law, at, distance, (low, high), short=short))
                raise Rejected(
                    f"the law's margin is too small: at a speed bound of {float(low):.4f} m/s towards an obstacle of "
                    f"{float(at.obstacle):g} m/s it keeps {float(held):.4f} m, "
                    f"{1000 * float(enough - held):.2g} mm less than needed"
                )
            middle = (low + high) / 2
            cells += [(middle, high), (low, middle)]
            continue
        if not cells and high < top:
            cells.append((high, high + _FIRST))


def _first_excess(claim: BrakingClaim, law: GuardedLaw, bound: Fraction) -> Fraction:
    """Return x [m/s]: if the speed exceeds the bound b by x, the velocity loop commands the braking force F_b.

    At the speed v, the loop commands the force drag(v_d) + m k_v (v_d − v) for a desired speed v_d ≤ b − gain x. This x
    suffices even with the drag at v_d = b.
    """
    loop = min(law.mass) * law.k_v * (1 + law.gain)
    return rounded(max((claim.brake + _forward(claim, law, bound)) / loop, Fraction(0)))


def _excess(claim: BrakingClaim, law: GuardedLaw, bound: Fraction) -> Fraction:
    """Return a smaller x with the drag at v_d = b − gain x, which falls with x; so bisection finds it."""
    loop, low, high = min(law.mass) * law.k_v * (1 + law.gain), Fraction(0), _first_excess(claim, law, bound)
    for _ in range(_BISECTIONS):
        middle = rounded((low + high) / 2)
        if claim.brake + _forward(claim, law, bound - law.gain * middle) <= loop * middle:
            high = middle
        else:
            low = middle
    return high


def _forward(claim: BrakingClaim, law: GuardedLaw, desired: Fraction) -> Fraction:
    """Return the largest force along n [N] of the loop's drag model at a desired speed along n, and of errors across n.

    The law's drag model computes the drag of each axis separately and includes the sideways speed; at a speed astern it
    brakes. If the masses of the law's model differ, an error of up to 2 w across adds a force along.
    """
    v, a, w = max(desired, Fraction(0)), max(-desired, Fraction(0)), claim.sideways
    (low, high), (low2, high2), (light, heavy) = (sorted(pair) for pair in (law.linear, law.quadratic, law.mass))
    aside = (high - low) * w / 2 + (2 * high2 - low2) * w**2 * ROOT27
    if low == high and low2 == high2 and not a:
        forward = high * v + high2 * (v**2 + Fraction(385, 1000) * v * w + Fraction(7072, 10**4) * w**2)
    else:
        forward = high * v + high2 * v**2 + ROOT2[1] * high2 * v * w + aside - low * a - HALF_ROOT2 * low2 * a**2
    return forward + (heavy - light) * law.k_v * w


def bound_distance(law: GuardedLaw, at: Forces, period: Fraction, bound: Fraction) -> Fraction:
    """Return K(b) [m], the distance at which the law's speed bound is b; for b far below 0, K is linear in b."""
    force = law.brake * law.limit
    if law.barrier == "simple":
        c, t = bound + at.obstacle, law.reaction
        return c * t + max(c, Fraction(0)) ** 2 * max(law.mass) / (2 * force) + t * at.obstacle
    lightest, heaviest, most, lag, linear, quadratic = law.stopping
    dragged = linear * at.obstacle + quadratic * at.obstacle**2
    left = force - dragged
    if left * 50 < force:
        raise Rejected("the law's speed bound assumes too little braking force at the speed of the obstacle")
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
    """Return a speed [m/s] below the law's speed bound at every measured range: margin + K(speed) ≤ −range error."""
    bound = -at.obstacle
    for _ in range(10_000):
        if law.margin + bound_distance(law, at, claim.period, bound) <= -claim.range_error:
            return bound
        bound -= Fraction(1, 1000)
    raise Rejected("the law's speed bound stays too high where the clearance is 0")
