"""The closed loop in a shell of V as a linear inclusion, and the matrix M: if M is negative definite, V̇ ≤ −a V.

ξ = (x, y, U_x, U_y) denotes the deviations of position and velocity from the steady cruise, in the path frame. With
thrust lag, ξ also contains (F_x, F_y), the thrust minus the trim force at the current heading. On V = ξᵀPξ ≤ ℓ every
linear function C ξ satisfies |C ξ|² ≤ ℓ λ_max(C P⁻¹ Cᵀ).

In a shell, ξ satisfies ξ̇ = A ξ + Σ B_j w_j. Each w_j (2,) is a force in the path
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
from itertools import pairwise
from itertools import product as combinations

from surctl.certcheck.document import Rejected
from surctl.certcheck.region_claim import CruiseClaim
from surctl.certcheck.region_exact import (
    Matrix,
    add,
    congruence,
    largest_eigenvalue,
    middle,
    product,
    root_down,
    root_up,
    rounded_up,
    scaled,
    transpose,
    zeros,
)
from surctl.certcheck.region_trim import Trim, quarter

__all__ = ["Shell", "Vertex", "rate_matrix", "shell", "vertices"]

_ARCS = 64


@dataclass(frozen=True)
class Shell:
    """Bounds in the shell ℓ_low ≤ V ≤ ℓ_high.

    Attributes:
        steer: least and largest commanded speed s along the path [m/s].
        catch: least and largest value of κ, the derivative of the commanded speed along the path with respect to −x_e
            [1/s].
        model_drag, drag: least and largest secant slope of the feedforward drag (`model_drag`) and of the true drag
            (`drag`) [N s/m].
        thrust_share: φ; the thrust limit multiplies the deviation of a commanded force by a factor in [φ, 1].
        held: κ_5 [N] in the bound |w_5| ≤ κ_5 √V, where w_5 is the difference between the acting force and the present
            command; without lag, w_5 includes the forces of w_6.
        disturbance: κ_6 [N] in the bound |w_6| ≤ κ_6 √V, where w_6 is the error of the trim force plus external forces,
            for thrust with lag; 0 without lag.
        desired_rate: largest rate of change of the commanded force that the change of position causes, divided by |δU|,
            the deviation of the velocity [N s/m/s].
    """

    steer: tuple[Fraction, Fraction]
    catch: tuple[Fraction, Fraction]
    model_drag: tuple[Fraction, Fraction]
    drag: tuple[Fraction, Fraction]
    thrust_share: Fraction
    held: Fraction
    disturbance: Fraction
    desired_rate: Fraction


def desired_velocity(size: int, claim: CruiseClaim, steer: Fraction, catch: Fraction, aside: Fraction) -> Matrix:
    """Return C (2, n), where C ξ is the deviation of the commanded velocity, for a steady offset y* = `aside`."""
    rows = zeros(2, size)
    rows[0][0], rows[1][1] = -catch, -steer / claim.lookahead
    rows[1][0] = catch * aside / claim.lookahead
    return rows


def velocity(size: int) -> Matrix:
    """Return C (2, n), where C ξ is the deviation of the velocity."""
    rows = zeros(2, size)
    rows[0][2] = rows[1][3] = Fraction(1)
    return rows


def force_state(size: int) -> Matrix:
    """Return C (2, n), where C ξ is the deviation of the lagged thrust."""
    rows = zeros(2, size)
    rows[0][4] = rows[1][5] = Fraction(1)
    return rows


def force_rows(
    size: int, claim: CruiseClaim, slope: Fraction, steer: Fraction, catch: Fraction, aside: Fraction
) -> Matrix:
    """Return C (2, n), where C ξ is the deviation of the commanded force [N] for a feedforward drag of this slope."""
    velocity_gain = claim.mass_model * claim.k_v
    return add(
        scaled(velocity_gain + slope, desired_velocity(size, claim, steer, catch, aside)),
        scaled(-velocity_gain, velocity(size)),
    )


def shell(claim: CruiseClaim, steady: Trim, covariance: Matrix, low: Fraction, high: Fraction) -> Shell:
    """Return the bounds in the shell low ≤ V ≤ high.

    Args:
        claim: the claim.
        steady: the steady cruise of the claim.
        covariance: P⁻¹, the inverse of the matrix of V.
        low, high: levels of V.

    Raises:
        Rejected: in some points of the region the law commands backward motion, reaches its speed cap or lets the
            target wait; or the steady cruise alone reaches a thrust limit.
    """
    size = len(covariance)
    radius = root_up(high)
    x, y = (root_up(covariance[k][k]) * radius for k in (0, 1))
    steer, catch, slant = _commanded(claim, steady, x, y)
    corners = sorted(set(combinations(steer, catch, (steady.aside, -steady.aside))))

    def gain(rows: Matrix) -> Fraction:
        return root_up(largest_eigenvalue(congruence(rows, covariance)))

    e_desired = max(gain(desired_velocity(size, claim, s, k, b)) for s, k, b in corners)
    e_velocity = gain(velocity(size))
    model_low = claim.linear_model
    desired_speed = steady.command[1] + steady.drift
    spread = claim.quadratic_model * (desired_speed + min(claim.cap, desired_speed + e_desired * radius))
    model_drag = (model_low, model_low + spread)
    drag = (
        claim.linear[0],
        claim.linear[1] + claim.quadratic[1] * (2 * (claim.cruise + claim.current) + e_velocity * radius),
    )
    velocity_gain = claim.mass_model * claim.k_v
    floor = root_down(low)
    if floor <= 0:
        raise Rejected("a shell must begin above level 0")
    # the trim force turns with {B}: a held command lags behind it, and so does thrust with lag
    late = claim.period + claim.lag[1]
    still = claim.yaw_rate * late * steady.turning
    outside = steady.total + claim.force
    disturbance = outside if claim.lag[1] else Fraction(0)
    still += outside - disturbance
    steepest = claim.linear_model + 2 * claim.quadratic_model * claim.cap
    still += _misled(claim, steady, root_up(covariance[1][1]), velocity_gain + steepest)
    return Shell(
        steer,
        catch,
        model_drag,
        drag,
        _thrust_share(claim, steady, covariance, corners, model_drag, radius),
        still / floor,
        disturbance / floor,
        (velocity_gain + steepest) * slant,
    )


def _commanded(
    claim: CruiseClaim, steady: Trim, x: Fraction, y: Fraction
) -> tuple[tuple[Fraction, Fraction], tuple[Fraction, Fraction], Fraction]:
    """Return the ranges of `steer` and `catch` and the largest slope of the commanded velocity, for |x|, |y| ≤ x, y."""
    k1, ahead = claim.k1, claim.lookahead
    # the cap limits s q/Δ, q = √(y² + Δ²); it must not bring s below the steady command
    wide = y + steady.aside
    most = claim.cap * ahead / root_up(ahead * ahead + wide * wide)
    if most < steady.command[1]:
        raise Rejected("the region contains points where the speed cap is below the steady command")
    if k1 * x > steady.command[0]:
        raise Rejected("the region contains points where the law would command backward motion")
    if x + max(abs(w) for w in steady.omega) / k1 + claim.place_error > claim.wait / 2:
        raise Rejected("the region contains points where the path's target waits")
    steer = (steady.command[0] - k1 * x, min(steady.command[1] + k1 * x, claim.cap))
    catch = (min(k1, (most - steady.command[1]) / x), k1)
    free = root_up(k1 * k1 * (1 + (wide / ahead) ** 2) + (steer[1] / ahead) ** 2)
    return steer, catch, max(free, claim.cap / ahead)


def _misled(claim: CruiseClaim, steady: Trim, y: Fraction, slope: Fraction) -> Fraction:
    """Return the largest change of thrust that measurement errors cause [N]; y is the largest |y| on V ≤ 1.

    Thrust limits do not enlarge a change of thrust. A change of position (x, y) by 1 m changes the commanded velocity
    along the path by at most k1 (for x) or k1 y_e/Δ (for y), and across the path by less than cap/Δ; Δ is the lookahead
    distance. This holds below the law's speed cap, at the cap, and when the law commands rest. This bound also holds
    for a command of an earlier instant.
    """
    wide = (y + steady.aside + claim.place_error) / claim.lookahead
    slant = root_up(claim.k1**2 * (1 + wide**2) + (claim.cap / claim.lookahead) ** 2)
    return slope * slant * claim.place_error + claim.mass_model * claim.k_v * claim.velocity_error


def _thrust_share(
    claim: CruiseClaim,
    steady: Trim,
    covariance: Matrix,
    corners: list[tuple[Fraction, Fraction, Fraction]],
    model_drag: tuple[Fraction, Fraction],
    radius: Fraction,
) -> Fraction:
    """Return φ = min (F − |f|)/d over all axes n: thrust limit F, trim force f, largest deviation d of the command.

    The unit vectors n are divided into arcs. Each arc lies in the triangle of its two ends and the intersection of the
    tangents there. d = √(nᵀGn) is convex, so its largest value on the triangle is at a corner.
    """
    share = Fraction(1)
    size = len(covariance)
    grams = [
        rounded_up(congruence(force_rows(size, claim, slope, s, k, b), covariance))
        for slope in model_drag
        for s, k, b in corners
    ]
    points = quarter(_ARCS)
    mirrored = all(g[0][1] == 0 for g in grams)
    for flip in (1,) if mirrored else (1, -1):
        for (c1, s1), (c2, s2) in pairwise(points):
            meet = 1 + c1 * c2 + s1 * s2
            ends = [(c1, flip * s1), (c2, flip * s2), ((c1 + c2) / meet, flip * (s1 + s2) / meet)]
            left = claim.thrust - steady.along(c1, s2)
            if left <= 0:
                raise Rejected("the steady cruise needs all the thrust")
            worst = max(c * c * g[0][0] + 2 * c * s * g[0][1] + s * s * g[1][1] for g in grams for c, s in ends)
            deviation = root_up(worst) * radius
            if deviation > left:
                share = min(share, Fraction(int(left / deviation * 10**9), 10**9))
    return share


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
