"""The heading loop of a craft without sway force as a linear inclusion ξ̇ = A(θ) ξ with parameters θ in intervals.

ξ = (y_e, ψ, v, r, c, s): cross-track error, heading to the path, sway speed, yaw rate, crab filter and modelled sway
speed. With surge speed u, e = −atan(y_e/Δ) − c − ψ and r_d = k_ψ e, law and vehicle are

    ẏ_e = u sin ψ + v cos ψ,   ψ̇ = r,   ċ = (atan(v/u) − c)/T_c,   ṡ = −(m_c/m̂22) u r − (Ŷ_v + Ŷ_vv |s|) s/m̂22,
    N = φ ((N̂_r + N̂_rr |r_d|) r_d + m̂44 k_r (r_d − r) + μ u k s),
    [[m22, m24], [m24, m44]] (v̇, ṙ) = (b N − C_vv v − C_vr r, N − C_rv v − C_rr r).

C_vv = Y_v + Y_vv |v| + Y_uv u + …, C_vr = m11 u + Y_r + …, C_rv = (m22 − m11) u + N_v + …, C_rr = m24 u + N_r + …
contain all drag by v and r. b N is the side force of fins (b = `side`). μ and m_c are numbers of the law, and k ≤ 1
is the share that the speed cap leaves of the modelled sway speed. Where the law limits the yaw rate, r_d is a share
of k_ψ e. φ is the share of the yaw moment that thrusters or fins deliver. The surge speed of a law for fins in ṡ is
that of its own model. Each secant slope (sin ψ/ψ, cos ψ, atan(y_e/Δ)/y_e, atan(v/u)/(v/u), |r_d|, |s|, …) lies in an
interval for ξ in V ≤ 1, and A is affine in each of them and in (u, 1/u), which lies in a triangle: the matrices at the
ends of all intervals and at the corners (`nodes`) enclose A. Intervals are exact fractions, rounded outward.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import product

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.region_exact import root_down, root_up
from surctl.certcheck.steering_claim import SteeringClaim

__all__ = [
    "Extent", "Node", "command_rows", "delivered", "lookahead", "moment_rows", "nodes", "parameters", "planned_rate",
    "vertices",
]  # fmt: skip

Array = NDArray[np.float64]
Pair = tuple[Fraction, Fraction]

_UP = 1 + 1e-9  # covers the rounding of an interval's end
_EXACT = 15  # number of the parameters before the share that limits leave, which ends at exactly 1
_SHARE, _MUNK, _SLOWEST = Fraction(85, 100), Fraction(1, 2), Fraction(1, 4)  # constants of the law `steered`


@dataclass(frozen=True)
class Extent:
    """Bounds in the region: |y_e|, |ψ|, |v|, |r|, |s|, and commanded yaw rate and moment before limits; SI units."""

    beside: Fraction
    heading: Fraction
    sway: Fraction
    yaw_rate: Fraction
    model: Fraction
    command: Fraction
    moment: Fraction


@dataclass(frozen=True)
class Node:
    """A surge speed [m/s], the value that stands for its inverse [s/m], and the largest yaw moment there [N m]."""

    speed: Fraction
    inverse: Fraction
    moment: Fraction


def _times(*factors: Pair) -> Pair:
    values = [Fraction(1)]
    for low, high in factors:
        values = [one * end for one in (min(values), max(values)) for end in (low, high)]
    return min(values), max(values)


def _plus(*terms: Pair) -> Pair:
    return sum((low for low, _ in terms), Fraction(0)), sum((high for _, high in terms), Fraction(0))


def _moment(claim: SteeringClaim, u: Fraction) -> Fraction:
    """Return the largest yaw moment at a surge speed; fins need the cruise speed for all of it."""
    return claim.moment * min(u / claim.cruise, Fraction(1)) ** 2 if claim.finned else claim.moment


def _yaw_limit(claim: SteeringClaim, most: Fraction) -> Pair:
    moment, (_, linear), (_, square) = _SHARE * most, claim.linear, claim.quadratic
    under = linear * linear + 4 * square * moment
    return 2 * moment / (linear + root_up(under)), 2 * moment / (linear + root_down(under))


def planned_rate(claim: SteeringClaim, speeds: Pair) -> Pair:
    """Return the range of the largest yaw rate that the law plans at surge speeds [m/s] in an interval."""
    munk, moments = abs(claim.munk), [_moment(claim, u) for u in speeds]
    limits = [_yaw_limit(claim, most) for most in moments]

    def sideways(drift: Fraction, u: Fraction) -> Fraction:
        return (claim.linear[0] * drift + claim.quadratic[0] * drift * drift) / (claim.centripetal * u)

    # the limit by the drift angle grows with u, and that by the Munk moment decreases for a given moment, which grows
    rates = [
        (sideways(claim.sideslip * u, u), sideways(_MUNK * most / (munk * w), w) if munk else limit[1])
        for u, w, most, limit in zip(speeds, speeds[::-1], moments, limits, strict=True)
    ]
    return min(*rates[0], limits[0][0]), min(*rates[1], limits[1][1])


def lookahead(claim: SteeringClaim) -> Pair:
    """Return the range of the look-ahead distance Δ [m]: the gain, or the turning radius if that is larger."""
    low, high = planned_rate(claim, (claim.cruise, claim.cruise))
    return max(claim.lookahead, claim.cruise / high), max(claim.lookahead, claim.cruise / low)


def command_rows(claim: SteeringClaim, beside: Fraction) -> list[list[Fraction]]:
    """Return rows of which the hull contains the slopes of the commanded yaw rate r_d in ξ."""
    return [[-claim.k_psi * n for n in (slope, 1, 0, 0, 1, 0)] for slope in _bearing(claim, beside)]


def moment_rows(claim: SteeringClaim, at: Extent) -> list[list[Fraction]]:
    """Return rows of which the hull contains the slopes of the commanded moment N in ξ, before its limit."""
    k, stiff = claim.k_psi, claim.mass[2] * claim.k_r
    rows = []
    for feed, bearing, cancelled, share in product(
        _feed(claim, at), _bearing(claim, at.beside), _cancelled(claim, at, claim.speed), _limited(claim, at)
    ):
        turn = -k * share * (feed + stiff)
        rows.append([turn * bearing, turn, Fraction(0), -stiff, turn, cancelled])
    return rows


def _limited(claim: SteeringClaim, at: Extent) -> Pair:
    """Return the range of the share that the limits of the commanded yaw rate leave of it."""
    one = Fraction(1)
    if not at.command:
        return one, one
    swing = _moment(claim, claim.speed[0]) / (claim.mass[2] * claim.k_psi * at.command)
    return min(one, planned_rate(claim, claim.speed)[0] / at.command, root_down(swing)), one


def _feed(claim: SteeringClaim, at: Extent) -> Pair:
    most = min(at.command, planned_rate(claim, claim.speed)[1])
    return claim.linear[1], claim.linear[1] + claim.quadratic[1] * most


def _cancelled(claim: SteeringClaim, at: Extent, speed: Pair) -> Pair:
    share = claim.cap / root_up(claim.cap**2 + at.model**2), Fraction(1)
    return _times((claim.munk,) * 2, speed, share)


def _bearing(claim: SteeringClaim, beside: Fraction) -> Pair:
    # atan(t)/t ≥ 1 − t²/3
    low, high = lookahead(claim)
    return (1 - (beside / low) ** 2 / 3) / high, 1 / low


def _drag(claim: SteeringClaim, force: str, last: str, sizes: Mapping[str, Pair]) -> Pair:
    """Return the range of the drag coefficient on `force` (Y or N) by the velocity `last` (v or r)."""
    total: Pair = (Fraction(0), Fraction(0))
    for name, value in claim.terms.items():
        if name[0] == force and name[-1] == last and name[1] != "w":
            size = sizes[name[1]] if len(name) == 3 else (Fraction(1), Fraction(1))
            total = _plus(total, _times((value, value), claim.drag_factor, size))
    return total


def nodes(claim: SteeringClaim) -> list[Node]:
    """Return the corners of a polygon that contains (u, 1/u) and stays below the yaw moment, for all surge speeds u.

    1/u is convex: its chord and the tangents at both ends enclose it. The moment is at least that at the least speed
    plus a slope, which is the smaller of the tangent there and of the chord.
    """
    low, high = claim.speed
    least = _moment(claim, low)
    if low == high:
        return [Node(low, 1 / low, least)]
    slope = min((_moment(claim, high) - least) / (high - low), 2 * least / low)
    inner = 2 * low * high / (low + high)
    corners = (low, 1 / low), (inner, 2 / (low + high)), (high, 1 / high)
    return [Node(u, w, least + slope * (u - low)) for u, w in corners]


def delivered(claim: SteeringClaim, at: Extent) -> Fraction:
    """Return the least share of the commanded yaw moment that thrusters or fins deliver in the region."""
    return min(Fraction(1), _moment(claim, claim.speed[0]) / at.moment) if at.moment else Fraction(1)


def parameters(claim: SteeringClaim, at: Extent, node: Node) -> list[Pair]:
    """Return the intervals of the parameters θ in the region, for the surge speed of a node.

    Raises:
        Rejected: the region is too large for the bounds, or the inertia matrix is not positive definite.
    """
    one, u = Fraction(1), (node.speed, node.speed)
    slowest = claim.speed[0]
    if slowest < _SLOWEST * claim.cruise:
        raise Rejected("the surge speed falls below a quarter of the cruise speed")
    if max(at.heading, at.beside / lookahead(claim)[0], at.sway / slowest) >= 1:
        raise Rejected("the region is too large for the bounds on sine, cosine and arc tangent")
    zero, exact = Fraction(0), claim.mass
    m11, m22, m44 = ((claim.mass_factor[0] * m, claim.mass_factor[1] * m) for m in exact)
    m24 = _times((claim.terms.get("m24", zero),) * 2, claim.mass_factor)
    most, least = max(map(abs, m24)), min(map(abs, m24))
    if m22[0] * m44[0] <= most * most:
        raise Rejected("the inertia matrix of sway and yaw is not positive definite")
    per22 = 1 / (m22[1] - least**2 / m44[1]), 1 / (m22[0] - most**2 / m44[0])
    per44 = 1 / (m44[1] - least**2 / m22[1]), 1 / (m44[0] - most**2 / m22[0])
    per_det = 1 / (m22[1] * m44[1] - least**2), 1 / (m22[0] * m44[0] - most**2)
    sizes = {"u": u, "v": (zero, at.sway), "r": (zero, at.yaw_rate)}
    own = [
        _times(claim.drag_factor, (linear, linear + square * size))
        for linear, square, size in zip(claim.vehicle_linear, claim.quadratic, (at.sway, at.yaw_rate), strict=True)
    ]
    munk = _plus(m22, (-m11[1], -m11[0]))
    c_vv = _plus(own[0], _drag(claim, "Y", "v", sizes))
    c_vr = _plus(_times(m11, u), _drag(claim, "Y", "r", sizes))
    c_rv = _plus(_times(munk, u), _drag(claim, "N", "v", sizes))
    c_rr = _plus(_times(m24, u), own[1], _drag(claim, "N", "r", sizes))
    modelled = claim.speed if claim.finned else u  # a law for fins has its own model of the surge speed
    drift = node.inverse * (1 - (at.sway / slowest) ** 2 / 3), node.inverse
    damped = claim.linear[0] / exact[1], (claim.linear[0] + claim.quadratic[0] * at.model) / exact[1]
    return [
        _times(u, (1 - at.heading**2 / 6, one)), (1 - at.heading**2 / 2, one), _bearing(claim, at.beside), drift,
        _feed(claim, at), _cancelled(claim, at, u), modelled, damped, c_vv, c_vr, c_rv, c_rr, per22,
        _times((-m24[1], -m24[0]), per_det), per44, _limited(claim, at),
    ]  # fmt: skip


def vertices(claim: SteeringClaim, theta: Sequence[Pair], node: Node) -> tuple[Array, Array, Array]:
    """Return the loop at all ends of the intervals, rounded outward: ξ̇ = (A + φ b mᵀ) ξ with the yaw moment φ mᵀ ξ.

    Returns:
        A (n, 6, 6), b (n, 6), m (n, 6); φ is the share of the moment that thrusters or fins deliver.
    """
    ends = [
        [float(low)] if low == high else [float(low) - abs(float(low)) * (_UP - 1),
                                          float(high) + abs(float(high)) * (_UP - 1)]
        for low, high in theta[:_EXACT]
    ]  # fmt: skip
    ends += [sorted({float(low) / _UP if low < 1 else 1.0, 1.0}) for low, _ in theta[_EXACT:]]
    (
        sine, cosine, bearing, drift, feed, cancelled, modelled, damped, c_vv, c_vr, c_rv, c_rr, i_vv, i_vr, i_rr,
        limited,
    ) = (values.ravel() for values in np.meshgrid(*ends, indexing="ij"))  # fmt: skip
    k_psi, k_r, mass = float(claim.k_psi), float(claim.k_r), [float(m) for m in claim.mass]
    A, (b, m) = np.zeros((len(sine), 6, 6)), np.zeros((2, len(sine), 6))
    A[:, 0, 1], A[:, 0, 2], A[:, 1, 3] = sine, cosine, 1.0
    A[:, 4, 2], A[:, 4, 4] = drift / float(claim.crab_time), -1 / float(claim.crab_time)
    A[:, 5, 3], A[:, 5, 5] = -float(claim.centripetal) / mass[1] * modelled, -damped
    turn = -k_psi * limited * (feed + mass[2] * k_r)
    m[:, 0], m[:, 1], m[:, 4], m[:, 5] = turn * bearing, turn, turn, cancelled
    m[:, 3] = -mass[2] * k_r
    b[:, 2], b[:, 3] = i_vv * float(claim.side) + i_vr, i_vr * float(claim.side) + i_rr
    A[:, 2, 2], A[:, 2, 3] = -i_vv * c_vv - i_vr * c_rv, -i_vv * c_vr - i_vr * c_rr
    A[:, 3, 2], A[:, 3, 3] = -i_vr * c_vv - i_rr * c_rv, -i_vr * c_vr - i_rr * c_rr
    return A, b, m
