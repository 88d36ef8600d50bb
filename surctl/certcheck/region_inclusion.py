"""The closed loop in a shell as a linear inclusion, and the matrix M: if M is negative definite, V̇ ≤ −a V.

In a shell, the deviation ξ from the steady cruise satisfies ξ̇ = A ξ + Σ B_j w_j. Each w_j (2,) is a force in the path
frame [N] with a bound; δW, δU and δF_c = C ξ + w_1 are the deviations of the commanded velocity, the velocity and the
commanded force:

- w_1, from the feedforward drag: |w_1| ≤ r_1 |δW|;
- w_2, from the thrust limit: |w_2| ≤ r_2 |δF_c|;
- w_3, from the true drag: |w_3| ≤ r_3 |δU|;
- w_4, from the command that is held since the last control instant;
- w_5, from the trim force, which changes with the heading: |w_5| ≤ κ_5 √V;
- w_6, from the error of the trim force, for thrust with lag: |w_6| ≤ κ_6 √V.

The bounds on w_1 to w_3 hold at every heading: for slopes σ in [low, high] and a rotation R, the matrix R diag(σ) Rᵀ is
(low + high)/2 times the identity plus a matrix of norm ≤ (high − low)/2.

M is the matrix of the quadratic form V̇ + a V + Σ λ_j (bound_j² − |w_j|²) in (ξ, w), with multipliers λ_j ≥ 0. If M is
negative definite, V̇ < −a V for all w_j within their bounds. M is affine in 1/m, 1/T (T is the time constant of the
thrust) and the yaw rate r. M is convex in (s, κ, κ y*) jointly or in each of s, κ, κ y*, where s is the commanded speed
along the path, κ is the slope of s with respect to −x_e, and y* is the steady offset. So it suffices that M < 0 at all
vertices of the ranges of these parameters.

If commands are held for the period h, the proof uses the functional W = V + (h − τ) ρ ∫ |ḟ|² (Fridman 2010). The
integral is over the τ seconds since the last control instant, ρ is a weight, and f is the value of δF_c that the law
would command at the heading of that instant. W ≥ V, and W = V at the control instants. The change e of f since the last
control instant satisfies |e|² ≤ τ ∫ |ḟ|². So Ẇ + g W ≤ V̇ + g V + h ρ |ḟ|² − (1 − g h) (ρ/h) |e|² for a decay rate g.
Here ḟ is −m k_v U̇ plus an effect of the position of at most c |δU|, where c is `Shell.desired_rate`, and
|w_4| ≤ (1 + r h)|e| + r h |δF_c|. The square of each of these sums is bounded by a sum of squares with fixed weights.
The shells are then sets between two levels of W.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import product as combinations

from surctl.certcheck.document import Rejected
from surctl.certcheck.region_bounds import Shell, desired_velocity, force_rows, force_state, velocity
from surctl.certcheck.region_claim import CruiseClaim
from surctl.certcheck.region_exact import Matrix, add, middle, product, scaled, transpose, zeros

__all__ = ["Vertex", "rate_matrix", "vertices"]

MULTIPLIERS = 5
_SPLIT = Fraction(1, 3)  # weight k of the square of a sum: (a + b)² ≤ (1 + k) a² + (1 + 1/k) b²
_TURN_SPLIT = Fraction(1, 5)


@dataclass(frozen=True)
class Vertex:
    """The linear inclusion ξ̇ = A ξ + Σ B_j w_j at one vertex of the parameter ranges.

    Attributes:
        A: system matrix (n, n).
        B: input matrices B_j (n, 2) by the number j of the input w_j.
        desired: matrix C (2, n) with δW = C ξ, the deviation of the commanded velocity.
        force: matrix C (2, n) with δF_c = C ξ + w_1, the deviation of the commanded force.
    """

    A: Matrix
    B: dict[int, Matrix]
    desired: Matrix
    force: Matrix


def vertices(claim: CruiseClaim, at: Shell, size: int, *, aside: Fraction, mirrored: bool) -> Iterator[Vertex]:
    """Yield the inclusions at all vertices of a shell; with `mirrored`, omit those with negative offset or yaw rate."""
    lag = claim.lag[1] > 0
    masses = [1 / m for m in sorted(set(claim.mass))]
    lags = [1 / t for t in sorted(set(claim.lag))] if lag else [Fraction(0)]
    turns = sorted({claim.yaw_rate if mirrored else -claim.yaw_rate, claim.yaw_rate}) if lag else [Fraction(0)]
    asides = sorted({aside if mirrored else -aside, aside})
    for per_mass, per_lag, turn, steer, catch, beside in combinations(
        masses, lags, turns, sorted(set(at.steer)), sorted(set(at.catch)), asides
    ):
        yield vertex(
            claim, at, size, per_mass=per_mass, per_lag=per_lag, turn=turn, steer=steer, catch=catch, aside=beside
        )


def vertex(
    claim: CruiseClaim,
    at: Shell,
    size: int,
    *,
    per_mass: Fraction,
    per_lag: Fraction,
    turn: Fraction,
    steer: Fraction,
    catch: Fraction,
    aside: Fraction,
) -> Vertex:
    """Return the inclusion for the given values of 1/m, 1/T, r, s, κ and y* (see the module's docstring)."""
    share = (1 + at.thrust_share) / 2
    force = force_rows(size, claim, middle(at.model_drag), steer, catch, aside)
    speed = velocity(size)
    drag = scaled(middle(at.drag), speed)
    place, velocity_entry = zeros(size, 2), zeros(size, 2)
    place[0][0] = place[1][1] = velocity_entry[2][0] = velocity_entry[3][1] = Fraction(1)
    A = product(place, speed)
    if claim.lag[1]:
        thrust, entry = force_state(size), zeros(size, 2)
        entry[4][0] = entry[5][1] = Fraction(1)
        turned = [[-entry_ for entry_ in thrust[1]], thrust[0]]  # J δF
        A = add(
            A,
            scaled(per_mass, product(velocity_entry, add(thrust, scaled(Fraction(-1), drag)))),
            scaled(per_lag, product(entry, add(scaled(share, force), scaled(Fraction(-1), thrust)))),
            scaled(turn, product(entry, turned)),
        )
        inner, gain = entry, per_lag
    else:
        A = add(A, scaled(per_mass, product(velocity_entry, add(scaled(share, force), scaled(Fraction(-1), drag)))))
        inner, gain = velocity_entry, per_mass
    B = {1: scaled(gain * share, inner), 3: scaled(-per_mass, velocity_entry), 5: scaled(gain, inner)}
    if at.thrust_share < 1:
        B[2] = scaled(gain, inner)
    if claim.period:
        B[4] = scaled(gain, inner)
    if claim.lag[1]:
        B[6] = scaled(per_mass, velocity_entry)
    return Vertex(A, B, desired_velocity(size, claim, steer, catch, aside), force)


def rate_matrix(
    claim: CruiseClaim, at: Shell, p: Matrix, loop: Vertex, multipliers: Sequence[Fraction], hold: Fraction
) -> Matrix:
    """Return the symmetric matrix M for the multipliers λ_1, λ_2, λ_3, λ_5, λ_6 and the weight ρ = `hold`."""
    size, inputs = len(p), sorted(loop.B)
    factor = dict(zip((1, 2, 3, 5, 6), multipliers, strict=True))
    total = size + 2 * len(inputs)
    start = {j: size + 2 * k for k, j in enumerate(inputs)}
    growth = claim.rate + factor[5] * at.held**2 + (factor[6] * at.disturbance**2 if 6 in start else 0)
    if 4 in start:
        left, turn = 1 - growth * claim.period, claim.yaw_rate * claim.period
        if left <= 0 or hold <= 0:
            raise Rejected("the control period is too long for the claimed rate")
        factor[4] = left * hold / (claim.period * (1 + _TURN_SPLIT) * (1 + turn) ** 2)
    half = product(p, loop.A)
    m = zeros(total, total)
    corner = add(half, transpose(half), scaled(growth, p))
    _place(m, corner, 0, 0)
    for j in inputs:
        block = product(p, loop.B[j])
        _place(m, block, 0, start[j])
        _place(m, transpose(block), start[j], 0)
        for k in (0, 1):
            m[start[j] + k][start[j] + k] -= factor[j]
    r1 = (at.model_drag[1] - at.model_drag[0]) / 2
    r3 = (at.drag[1] - at.drag[0]) / 2
    speed = velocity(size)
    _place(m, scaled(factor[1] * r1 * r1, product(transpose(loop.desired), loop.desired)), 0, 0)
    _place(m, scaled(factor[3] * r3 * r3, product(transpose(speed), speed)), 0, 0)
    whole = [row + [Fraction(0)] * (total - size) for row in loop.force]  # δF_c
    whole[0][start[1]] = whole[1][start[1] + 1] = Fraction(1)
    weight = Fraction(0)
    if 2 in start:
        weight += factor[2] * ((1 - at.thrust_share) / 2) ** 2
    if 4 in start:
        weight += factor[4] * (1 + 1 / _TURN_SPLIT) * turn * turn
        velocity_gain = claim.mass_model * claim.k_v
        braking = [loop.A[k] + [entry for j in inputs for entry in loop.B[j][k]] for k in (2, 3)]  # U̇
        own, others = (1 + _SPLIT) * velocity_gain * velocity_gain, (1 + 1 / _SPLIT) * at.desired_rate**2
        _place(m, scaled(claim.period * hold * own, product(transpose(braking), braking)), 0, 0)
        _place(m, scaled(claim.period * hold * others, product(transpose(speed), speed)), 0, 0)
    _place(m, scaled(weight, product(transpose(whole), whole)), 0, 0)
    return m


def _place(m: Matrix, block: Matrix, row: int, column: int) -> None:
    for i, entries in enumerate(block):
        for j, entry in enumerate(entries):
            m[row + i][column + j] += entry
