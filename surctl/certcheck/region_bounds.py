"""Bounds within one shell of V: drag slopes, thrust limits, effect of held commands, and disturbances.

ξ = (x, y, U_x, U_y) denotes the deviations of position and velocity from the steady cruise, in the path frame. With
thrust lag, ξ also contains (F_x, F_y), the thrust minus the trim force at the current heading. On V = ξᵀPξ ≤ ℓ every
linear function C ξ satisfies |C ξ|² ≤ ℓ λ_max(C P⁻¹ Cᵀ).
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
