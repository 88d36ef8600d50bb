"""What may happen within one shell of the region: gains of the secants, share of the thrust, forces held too long.

Path frame, deviations from the steady cruise: ξ = (x, y, U_x, U_y) and, with thrust lag, the force (F_x, F_y)
less the trim force of the heading at hand.
On V = ξᵀPξ ≤ ℓ every linear C ξ obeys |C ξ|² ≤ ℓ λ_max(C P⁻¹ Cᵀ).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise, product

from surctl.certcheck.document import Rejected
from surctl.certcheck.region_claim import CruiseClaim
from surctl.certcheck.region_exact import (
    Matrix,
    add,
    congruence,
    largest_eigenvalue,
    root_down,
    root_up,
    rounded_up,
    scaled,
    zeros,
)
from surctl.certcheck.region_trim import Trim, quarter

__all__ = ["Shell", "desired_velocity", "force_rows", "force_state", "shell", "velocity"]

_ARCS = 64


@dataclass(frozen=True)
class Shell:
    """Bounds for ℓ_low ≤ V ≤ ℓ_high.

    Attributes:
        steer: values of s, the commanded speed along the path [m/s].
        catch: values of κ, the slope of that speed in −x_e [1/s].
        model_drag, drag: least and largest secant slope of the drag that is fed forward, and of the true one [N s/m].
        thrust_share: φ: what is left of a command's deviation after the thrust limit lies in [φ, 1] times it.
        held: κ_5: force that is not the command of this instant, |w_5| ≤ κ_5 √V [N]; without lag, w_6 with it.
        disturbance: κ_6: with lag, the trim force's lack and what pushes from outside, |w_6| ≤ κ_6 √V [N]; else 0.
        desired_rate: |d/dt of the commanded force by the place alone| ≤ this |δU| [N s/m/s].
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
    """δW = this ξ (2, n): the commanded velocity, about a y* of `aside`."""
    rows = zeros(2, size)
    rows[0][0], rows[1][1] = -catch, -steer / claim.lookahead
    rows[1][0] = catch * aside / claim.lookahead
    return rows


def velocity(size: int) -> Matrix:
    """δU = this ξ (2, n)."""
    rows = zeros(2, size)
    rows[0][2] = rows[1][3] = Fraction(1)
    return rows


def force_state(size: int) -> Matrix:
    """δF = this ξ (2, n), with thrust lag."""
    rows = zeros(2, size)
    rows[0][4] = rows[1][5] = Fraction(1)
    return rows


def force_rows(
    size: int, claim: CruiseClaim, slope: Fraction, steer: Fraction, catch: Fraction, aside: Fraction
) -> Matrix:
    """Deviation of the commanded force (2, n) [N], with this secant slope of the drag that is fed forward."""
    velocity_gain = claim.mass_model * claim.k_v
    return add(
        scaled(velocity_gain + slope, desired_velocity(size, claim, steer, catch, aside)),
        scaled(-velocity_gain, velocity(size)),
    )


def shell(claim: CruiseClaim, steady: Trim, covariance: Matrix, low: Fraction, high: Fraction) -> Shell:
    """The bounds for low ≤ V ≤ high.

    Args:
        claim: what is claimed.
        steady: its steady cruise.
        covariance: P⁻¹.
        low, high: levels.

    Raises:
        Rejected: the region reaches where the law is another one: backwards, past the speed cap, or behind the
            point from which the target waits; or the steady cruise itself needs more thrust than there is.
    """
    size = len(covariance)
    radius = root_up(high)
    x, y = (root_up(covariance[k][k]) * radius for k in (0, 1))
    steer, catch, slant = _commanded(claim, steady, x, y)
    corners = sorted(set(product(steer, catch, (steady.aside, -steady.aside))))

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
        raise Rejected("a shell begins at level 0")
    # the trim turns with {B}: the held one trails behind, and with lag the delivered one too
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
    """Speeds s, slopes κ, and the largest slope of the commanded velocity with the place, for |x|, |y| ≤ these."""
    k1, ahead = claim.k1, claim.lookahead
    # the cap bounds s q/Δ, q = √(y² + Δ²): the speed along the path stays above the steady one
    wide = y + steady.aside
    most = claim.cap * ahead / root_up(ahead * ahead + wide * wide)
    if most < steady.command[1]:
        raise Rejected("the region reaches where the speed cap is below the steady command")
    if k1 * x > steady.command[0]:
        raise Rejected("the region reaches where the law would go backwards")
    if x + max(abs(w) for w in steady.omega) / k1 + claim.place_error > claim.wait / 2:
        raise Rejected("the region reaches where the path's target waits")
    steer = (steady.command[0] - k1 * x, min(steady.command[1] + k1 * x, claim.cap))
    catch = (min(k1, (most - steady.command[1]) / x), k1)
    free = root_up(k1 * k1 * (1 + (wide / ahead) ** 2) + (steer[1] / ahead) ** 2)
    return steer, catch, max(free, claim.cap / ahead)


def _misled(claim: CruiseClaim, steady: Trim, y: Fraction, slope: Fraction) -> Fraction:
    """Largest change [N] of the thrust by the errors of what is measured, within |y| of V ≤ 1.

    Thrust limits do not enlarge a change. The commanded velocity changes with the place by k1 (1, y_e/Δ) along and by
    less than cap/Δ across, in the free law, under the cap and at rest alike; an earlier instant's is no larger.
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
    """φ: on an axis along n the trim |f| ≤ F and a deviation |δ| ≤ d leave at least (F − |f|)/d of δ.

    n runs over arcs; an arc lies in the triangle of its ends and the point where their tangents meet, and √(nᵀGn)
    is convex: its largest value there is taken at a corner.
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
