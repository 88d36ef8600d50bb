"""Check of a `mission` certificate: a chain of regions V ≤ level along a polyline, from its start to its end.

The certificate contains the claim and the proof of a `turning` certificate, which says: on a straight leg of any
direction, V(t) ≤ max(e^(−a t) V(0), floor) from every state with V ≤ 1, where V = (ξ − ξ*)ᵀ P (ξ − ξ*), ξ = (x_e, y_e,
U_x, U_y) in the frame of the leg, and ξ* = (x*, y*, v, 0) is the steady cruise. With thrust lag, ξ also has the thrust,
whose steady value depends on the heading (`steady_states`). The chain has one level for each leg:

- start: every state with |x_e| and |y_e| up to `within_m`, at rest or with the target's velocity, has V ≤ the level of
  the first leg;
- leg: the target moves at v, so it needs at least T = L/v − h for a leg of length L, where h is the control period (0
  if commands are not held). In this time V falls through the shells of the region, each with its own decay rate;
- corner: the law passes to the next leg at the first control instant at which the target has passed the corner, by a
  distance d in [0, v h]. With the steady cruises ξ* and ξ*' on both legs, the rotation R of each pair of entries into
  the frame of the next leg, and n = (1, 0, …),

      ξ' − ξ*' = R (ξ − ξ*) + R (ξ* + d n) − d n − ξ*'.

  So V ≤ level on one leg implies V' ≤ level' on the next one if a matrix of the S-procedure is positive definite for
  the ends of the ranges of ξ*, ξ*' and d, of which V' is convex. Without a current, x* and y* do not change;
- before a corner, the target could leave out a part of the path if the robot were far from the leg (`places`).

All numbers are exact rational numbers; e^x and ln x are rounded up. R has square roots; `_PRECISION` bounds the errors
of its entries, and the level of the next leg is reduced by their largest effect.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise, product
from typing import Any

from surctl.certcheck import turning
from surctl.certcheck.document import Rejected, record, seal
from surctl.certcheck.fields import Pair, number, two
from surctl.certcheck.patience import go_on
from surctl.certcheck.region_exact import (
    Matrix,
    inverse,
    is_positive_definite,
    quadratic,
    root_down,
    root_up,
    transpose,
)
from surctl.certcheck.region_exact import product as multiplied
from surctl.certcheck.turning_cells import Trim
from surctl.certcheck.turning_claim import EXCLUDES as LOOP_EXCLUDES
from surctl.certcheck.turning_claim import TurningClaim
from surctl.certcheck.turning_claim import read_claim as read_loop
from surctl.certcheck.turning_terms import UP

__all__ = [
    "EXCLUDES", "ON_LEG", "Funnel", "Mission", "check", "decayed", "funnel_of", "leg_length", "places", "read_claim",
    "starts", "steady_states", "turn_of", "turned",
]  # fmt: skip

EXCLUDES = (
    "the path is a polyline whose corners are passed, not visited; the cruise speed and the depth are the same on all "
    "of it, and the target's position on it has no rounding error",
    "the motion after the target has reached the end of the path, where it stops, is not covered",
    "a robot that begins at rest begins without thrust; one with the target's velocity has the thrust of steady cruise",
    *LOOP_EXCLUDES[1:],
)
"""Restrictions of the claim; a certificate repeats the restrictions word for word."""

ON_LEG = Fraction(1, 10)
"""Distance to a leg [m] within which the robot follows the leg to its end (`guidance.next_leg`)."""

_MOST_POINTS = 400
_SCALE = 10**30
_PRECISION = Fraction(1, 10**15)  # error of a cosine and of a sine, for legs of at least 1e-6 m
_SHORTEST = Fraction(1, 10**6)  # m
_GRID = 10**15  # levels are rounded up to multiples of 1/_GRID


@dataclass(frozen=True)
class Mission:
    """Claim about a mission; SI units.

    Attributes:
        path: waypoints (x, y) [m].
        within: largest |x_e| and |y_e| of the robot at the beginning [m].
        at_rest: whether the mission begins at rest; otherwise it begins with the target's velocity on the first leg.
        tube: for each leg, the largest distance of the robot from the path while the target is on the leg [m].
        goal: largest distance of the robot from the end of the path when the target reaches it [m].
        loop: the claim about the robot on one leg.
    """

    path: tuple[Pair, ...]
    within: Pair
    at_rest: bool
    tube: tuple[Fraction, ...]
    goal: Fraction
    loop: TurningClaim

    @property
    def overrun(self) -> Fraction:
        """Largest distance by which the target has passed a corner when the law passes to the next leg [m]."""
        return self.loop.cruise * self.loop.period


@dataclass(frozen=True)
class Funnel:
    """V and its steady cruise: P, the floor, and entries of the covariance P⁻¹.

    `steady` are states ξ*, of which every steady cruise is a convex combination. `spread` are the variances of x_e and
    y_e, which have no covariance; `trace` is the trace of P⁻¹. `shells` has the lower level of each shell and the decay
    rate in it [1/s], the outermost shell first.
    """

    p: Matrix
    floor: Fraction
    steady: list[list[Fraction]]
    spread: Pair
    trace: Fraction
    shells: list[Pair]

    @property
    def away(self) -> Pair:
        """Return the largest |x*| and |y*| [m]."""
        return max(abs(e[0]) for e in self.steady), max(abs(e[1]) for e in self.steady)

    def extent(self, level: Fraction) -> Fraction:
        """Return the largest distance of the robot from the target in V ≤ level [m].

        With A and B the variances of x_e and y_e, (δx + x*)² ≤ (1 + t) δx² + (1 + 1/t) x*² for t = B/A − 1 > 0.
        """
        (a, b), (away, beside) = self.spread, self.away
        far = root_up(max(a, b) * level) + away
        return (min(far, root_up(b * level + away * away * b / (b - a))) if b > a else far) + beside


def read_claim(value: Any) -> Mission:
    """Return the claim of a certificate.

    Raises:
        Rejected: a key is missing or unknown, a number has the wrong type or sign, a leg has no length, or the stated
            restrictions are not those of this kind of claim.
    """
    top = record(value, ("system", "name", "excludes", "path_m", "start", "motion", "loop"), "claim")
    if top["system"] != "mission" or not isinstance(top["name"], str):
        raise Rejected("claim.system must be 'mission', and claim.name a text")
    if top["excludes"] != list(EXCLUDES):
        raise Rejected("claim.excludes differs from the text that this checker expects")
    start = record(top["start"], ("within_m", "at_rest"), "claim.start")
    motion = record(top["motion"], ("tube_m", "goal_m"), "claim.motion")
    points, tube, loop = top["path_m"], motion["tube_m"], read_loop(top["loop"])
    if not isinstance(points, list) or not 2 <= len(points) <= _MOST_POINTS:
        raise Rejected(f"claim.path_m must have 2 to {_MOST_POINTS} points")
    if not isinstance(tube, list) or len(tube) != len(points) - 1:
        raise Rejected("claim.motion.tube_m must have one number for each leg")
    if type(start["at_rest"]) is not bool:
        raise Rejected("claim.start.at_rest must be true or false")
    mission = Mission(
        tuple(_point(point) for point in points),
        two(start["within_m"], "claim.start.within_m"),
        start["at_rest"],
        tuple(number(one, "claim.motion.tube_m", above=True) for one in tube),
        number(motion["goal_m"], "claim.motion.goal_m", above=True),
        loop,
    )
    for a, b in pairwise(mission.path):
        if leg_length(a, b) <= max(mission.overrun, _SHORTEST):
            raise Rejected("a leg of the path is shorter than the target moves in one control period")
    return mission


def _point(value: Any) -> Pair:
    if not isinstance(value, list) or len(value) != 2:
        raise Rejected("a point of claim.path_m must have two coordinates")
    x, y = (number(entry, "claim.path_m", least=-(10**9)) for entry in value)
    return x, y


def check(document: Mapping[str, Any]) -> None:
    """Check a `mission` certificate whose format and hash are verified.

    Raises:
        Rejected: the certificate does not prove its claim; the message names the first failure.
    """
    record(document, ("format", "version", "kind", "claim", "proof", "sha256"), "the certificate")
    mission = read_claim(document.get("claim"))
    proof = record(document.get("proof"), ("loop", "levels", "multipliers"), "proof")
    turning.check(seal("turning", document["claim"]["loop"], {"proof": proof["loop"]}))
    legs = len(mission.path) - 1
    for key, count in (("levels", legs), ("multipliers", legs - 1)):
        if not isinstance(proof[key], list) or len(proof[key]) != count:
            raise Rejected(f"proof.{key} must have {count} entries for this path")
    levels = [number(level, "proof.levels", above=True) for level in proof["levels"]]
    multipliers = [number(factor, "proof.multipliers", above=True) for factor in proof["multipliers"]]
    if max(levels) > 1:
        raise Rejected("the level of a leg is above 1, outside the region")
    funnel = funnel_of(mission.loop, proof["loop"])
    if any(quadratic(funnel.p, start) > levels[0] for start in starts(mission, funnel)):
        raise Rejected("the states at the start are not in the region of leg 1")
    for k, level in enumerate(levels):
        go_on()
        reached = max(level, funnel.floor)
        if funnel.extent(reached) + mission.overrun > mission.tube[k]:
            raise Rejected(f"the region of leg {k + 1} is wider than the claimed tube")
        length = leg_length(mission.path[k], mission.path[k + 1])
        after = decayed(mission.loop, funnel, level, length)
        if k == legs - 1:
            if funnel.extent(after) + mission.overrun > mission.goal:
                raise Rejected("the robot may be further from the goal than claimed")
            return
        if any(distance > bound for _, distance, bound in places(mission, funnel, k, level)):
            raise Rejected(f"the robot may leave out the corner at the end of leg {k + 1}")
        if not _turns(mission, funnel, k, after, levels[k + 1], multipliers[k]):
            raise Rejected(f"the states at the end of leg {k + 1} are not in the region of leg {k + 2}")


def funnel_of(claim: TurningClaim, proof: Mapping[str, Any]) -> Funnel:
    """Return V and its steady cruise from a proof that the check of a `turning` certificate accepts."""
    p = turning.triangle(proof["P"], 6 if claim.lag[1] else 4, "proof.P")
    covariance, shells = inverse(p), turning.shells_of(claim, proof)
    return Funnel(
        p,
        shells[0][0],
        steady_states(claim, turning.cruise_of(claim, proof)),
        (covariance[0][0], covariance[1][1]),
        sum((covariance[i][i] for i in range(len(p))), Fraction(0)),
        [(low, rate) for low, _, _, rate in reversed(shells)],
    )


def steady_states(claim: TurningClaim, trim: Trim) -> list[list[Fraction]]:
    """Return states ξ* = (x*, y*, v, 0), with thrust lag also q, of which every steady cruise is a convex combination.

    Here ξ has the thrust in place of F, and q is the thrust of the steady cruise, each divided by the mass in the law's
    model, in the frame of the leg. On axis i of the body, with the direction cosine n_i, it is a_i n_i + b_i n_i |n_i|.
    So q_x = Σ a_i n_i² + Σ b_i |n_i|³, where Σ |n_i|³ is from 1/√2 to 1, and |q_y| ≤ |a_1 − a_2|/2 + 2/5 max b_i.
    The lower bound is concave in the command of the steady cruise, and the upper ones are convex.
    """
    v, states = claim.cruise, []
    for moved, beside in product(sorted(set(trim.moved)), sorted({trim.beside, -trim.beside})):
        state = [-moved / claim.k1, beside, v, Fraction(0)]
        if not claim.lag[1]:
            states.append(state)
            continue
        a = [claim.k_v * moved + linear / m * (v + moved) for linear, m in zip(claim.linear, claim.mass, strict=True)]
        b = [square / m for square, m in zip(claim.quadratic, claim.mass, strict=True)]
        least = min(a) + min(b) * v * (v + 2 * moved) * Fraction(7, 10)
        aside = (max(a) - min(a)) / 2 + max(b) * (v + moved) ** 2 * Fraction(2, 5)
        states += [[*state, q, side * aside] for q in (least, max(a) + max(b) * (v + moved) ** 2) for side in (1, -1)]
    return states


def decayed(claim: TurningClaim, funnel: Funnel, level: Fraction, length: Fraction) -> Fraction:
    """Return a bound on V, from V ≤ level at the begin of a leg on, once the target has moved at least `length` [m]."""
    left = length / claim.cruise - claim.period
    for low, rate in funnel.shells:
        if level > low and left > 0:
            within = _fall(level, low, rate)
            level, left = max(level * Fraction(math.exp(-rate * left) * UP), low), left - within
    return max(Fraction(-(-level.numerator * _GRID // level.denominator), _GRID), funnel.floor)


def _fall(level: Fraction, low: Fraction, rate: Fraction) -> Fraction:
    """Return the time in which V falls from `level` to `low` [s], rounded up."""
    return Fraction(math.log(level / low) + 1e-12) / rate


def _bends(claim: TurningClaim, funnel: Funnel, level: Fraction) -> list[Fraction]:
    """Return how far the target has moved on a leg [m] when the bound on V enters a shell with a higher rate."""
    time, distances = claim.period, list[Fraction]()
    for (low, rate), (_, inner) in pairwise(funnel.shells):
        if level > low:
            time, level = time + _fall(level, low, rate), low
            distances += [claim.cruise * time] * (inner > rate)
    return distances


def starts(mission: Mission, funnel: Funnel) -> list[list[Fraction]]:
    """Return all extreme ξ − ξ* at the start."""
    x, y = mission.within
    return [
        [side * x - e[0], end * y - e[1], *(-entry if mission.at_rest else Fraction(0) for entry in e[2:])]
        for side in (1, -1)
        for end in (1, -1)
        for e in funnel.steady
    ]


def places(mission: Mission, funnel: Funnel, k: int, level: Fraction) -> list[tuple[Fraction, Fraction, Fraction]]:
    """Return (u, distance, bound) [m] for the places u before the corner at the end of leg k that decide.

    If each distance of the robot from the target is within its bound, the robot follows leg k up to the corner: it
    leaves the leg only if its measured position is more than 0.1 m from the leg and nearer to the next one. The next
    leg is at least σ u from the target, with σ = 1 for turns of up to 90 degrees, and the sine of the turn for others;
    so a distance of at most σ u/2 suffices. The distance, of the measured position, is a convex function of u except
    where V begins to fall faster (`_bends`), so these u and the ends of the range of u decide.
    """
    c, s = turn_of(*mission.path[k : k + 3])
    share = Fraction(1) if c > _PRECISION else max(abs(s) - _PRECISION, Fraction(0))
    length = leg_length(mission.path[k], mission.path[k + 1])
    first = min(mission.loop.wait, length - mission.overrun)  # V has not fallen where the target is further away

    def place(u: Fraction, bound: Fraction) -> tuple[Fraction, Fraction, Fraction]:
        return u, funnel.extent(decayed(mission.loop, funnel, level, length - u)) + mission.loop.place_error, bound

    if share * first <= 2 * ON_LEG:
        return [place(first, ON_LEG)]
    last = 2 * ON_LEG / share
    between = (u for u in (length - moved for moved in _bends(mission.loop, funnel, level)) if last < u < first)
    return [*(place(u, share * u / 2) for u in (first, *between)), place(last, ON_LEG)]


def _turns(mission: Mission, funnel: Funnel, k: int, before: Fraction, after: Fraction, multiplier: Fraction) -> bool:
    """Return whether V ≤ before at the end of leg k implies V ≤ after on the next leg."""
    rotation, moved = turned(mission, funnel, *turn_of(*mission.path[k : k + 3]))
    size = root_up(funnel.trace * before) + max(sum(map(abs, e)) for e in funnel.steady) + mission.overrun
    whole = sum((funnel.p[i][i] for i in range(len(funnel.p))), Fraction(0))
    left = root_down(after) - 2 * _PRECISION * size * root_up(whole)
    return left > 0 and all(_inside(funnel.p, before, rotation, offset, left * left, multiplier) for offset in moved)


def turned(mission: Mission, funnel: Funnel, c: Fraction, s: Fraction) -> tuple[Matrix, list[list[Fraction]]]:
    """Return M and all extreme w of ξ' − ξ*' = M (ξ − ξ*) + w at a corner, for the cosine and sine of its turn."""
    size, late = len(funnel.p), mission.overrun
    rotation = [[Fraction(0)] * size for _ in range(size)]
    for k in range(0, size, 2):
        rotation[k][k : k + 2], rotation[k + 1][k : k + 2] = [c, s], [-s, c]
    moved = []
    for e, after, d in product(funnel.steady, funnel.steady, sorted({Fraction(0), late})):
        if mission.loop.current or e[:2] == after[:2]:  # without a current, the steady position is the same on each leg
            state = multiplied([[e[0] + d, *e[1:]]], transpose(rotation))[0]
            moved.append([state[0] - d - after[0], *(x - y for x, y in zip(state[1:], after[1:], strict=True))])
    return rotation, moved


def _inside(
    p: Matrix, before: Fraction, m: Matrix, w: Sequence[Fraction], after: Fraction, multiplier: Fraction
) -> bool:
    """Return whether the S-procedure shows (M z + w)ᵀ P (M z + w) ≤ after for all z with zᵀ P z ≤ before."""
    go_on()
    size = range(len(p))
    image = multiplied(p, m)
    own, pulled = multiplied(transpose(m), image), multiplied([list(w)], image)[0]
    rows = [[multiplier * p[i][j] - own[i][j] for j in size] + [-pulled[i]] for i in size]
    return is_positive_definite([*rows, [*(-entry for entry in pulled), after - multiplier * before - quadratic(p, w)]])


def turn_of(a: Pair, b: Pair, c: Pair) -> Pair:
    """Return cosine and sine of the angle from leg ab to leg bc, each off by at most `_PRECISION`."""
    (x, y), (u, w) = (b[0] - a[0], b[1] - a[1]), (c[0] - b[0], c[1] - b[1])
    size = _root((x * x + y * y) * (u * u + w * w))
    return (x * u + y * w) / size, (x * w - y * u) / size


def leg_length(a: Pair, b: Pair) -> Fraction:
    """Return the length of a leg [m], rounded down."""
    return _root((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2)


def _root(value: Fraction) -> Fraction:
    """Return √value, rounded down by less than 1e-30."""
    return Fraction(math.isqrt(value.numerator * _SCALE**2 // value.denominator), _SCALE)
