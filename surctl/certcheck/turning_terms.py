"""Bounds of what acts on a turning cruise: forces beside equation (3) of the paper, inertia, and a current.

Let ν be the horizontal velocity in the body frame, w the heave velocity, r the yaw rate, and S the quarter turn. The
horizontal part of the dynamics with a full inertia matrix is

    M ν̇ = τ − D(ν)ν − r S M ν + d,    M = [[m11, m12], [m12, m22]],
    d = d_0 − M' (ẇ, ṙ) − r S M' (w, r) − Σ coefficient · velocities,    M' = [[m13, m14], [m23, m24]].

d_0 are the constant forces. The claim bounds w, ẇ, r and ṙ, and the region bounds ν, so that each entry of d is
bounded. m12 is part of the proof's matrices (`turning_cells`). Each true term is its value times a factor: that of the
masses for m12 to m24, that of the drag for all others; the bounds take the largest factor.

A constant current changes the trim force, and the steady command shifts with it. Let c be the current, n_i an axis of
the body in the path frame, and δ = −n_i G c the shift of the steady command along it, G = diag(g_x, g_y). The law adds
m_i k_v δ and the change of its feedforward, and the drag at the target's velocity changes by the current. With α =
m_i k_v + â + b̂ S_w and β = f a + g b S_u, the error on axis i changes by n_i (β − α G) c. S_w is the secant slope of
|w| w from w = n_i (v + ω, 0) to w + δ, and S_u that of |u| u from u = n_i (v, 0) to u − n_i c, both between
max(2 (√2 − 1) |u|, 2 |u| − change) and 2 |u| + change. For given slopes, β − α g_k is affine in the drag factors, and
for given factors in the slopes, so that their vertices decide.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import product

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.fields import Pair
from surctl.certcheck.turning_claim import TurningClaim, axis_pairs, drag_factors

__all__ = [
    "STILL",
    "UP",
    "Coupling",
    "Turn",
    "coupled_mass",
    "coupling_of",
    "flow_error",
    "flow_gains",
    "inverse_masses",
    "other_forces",
    "other_moment",
    "outer_force",
    "turn_points",
]  # fmt: skip

_FORCES, _VELOCITIES = "XY", "uvwr"


def _size(claim: TurningClaim, name: str) -> Fraction:
    """Return the largest size of a term; 0 if the vehicle does not have it."""
    factor = claim.mass_factor if name[0] == "m" else claim.drag_factor
    return abs(claim.terms.get(name, Fraction(0))) * max(factor[1], Fraction(1))


def coupled_mass(claim: TurningClaim) -> Fraction:
    """Return the largest |m12| [kg].

    Raises:
        Rejected: the horizontal inertia matrix is not positive definite for every mass in its range.
    """
    size = _size(claim, "m12")
    if size * size >= claim.mass_factor[0] ** 2 * claim.mass[0] * claim.mass[1] / 4:
        raise Rejected("m12 is not small against m11 and m22")
    return size


def _carried(claim: TurningClaim) -> tuple[Fraction, Fraction]:
    """Return bounds on the two entries of M' (w, r) [kg m/s]."""
    first, second = (_size(claim, f"m{i}3") * claim.heave + _size(claim, f"m{i}4") * claim.yaw_rate for i in (1, 2))
    return first, second


def other_forces(claim: TurningClaim, fastest: Fraction) -> tuple[Fraction, Fraction]:
    """Return bounds on both entries of d [N] where the horizontal speed is at most `fastest` [m/s]."""
    most: Mapping[str, Fraction] = {"u": fastest, "v": fastest, "w": claim.heave, "r": claim.yaw_rate}
    carried = _carried(claim)
    bounds = []
    for axis, letter in enumerate(_FORCES):
        force = _size(claim, f"{letter}0") + claim.yaw_rate * carried[1 - axis]
        force += _size(claim, f"m{axis + 1}3") * claim.heave_rate + _size(claim, f"m{axis + 1}4") * claim.turn_rate
        for name in claim.terms:
            if name[0] == letter and name[1] in _VELOCITIES:
                force += _size(claim, name) * math.prod((most[velocity] for velocity in name[1:]), start=Fraction(1))
        bounds.append(force)
    return bounds[0], bounds[1]


def other_moment(claim: TurningClaim, fastest: Fraction) -> Fraction:
    """Return a bound on the yaw moment u p_y − v p_x beside (m22 − m11) u v, with (p_x, p_y) the momentum [N m]."""
    return fastest * (fastest * coupled_mass(claim) + sum(_carried(claim)))


def outer_force(claim: TurningClaim, beside: float) -> float:
    """Return the largest norm [N] of the disturbance force and of the thrust that errors of measurement cause.

    `beside` is the largest |y_e| [m]. A thrust limit does not enlarge a change of thrust. A change of position (x, y)
    by 1 m changes the commanded velocity along the path by at most k1 (for x) or k1 y_e/Δ (for y), and across the path
    by less than cap/Δ; Δ is the lookahead distance. This holds below the law's speed cap, at the cap, and when the law
    commands rest.
    """
    gain = max(float(mass * claim.k_v) for mass in claim.mass)
    steep = gain + max(float(a + 2 * b * claim.cap) for a, b in zip(claim.linear, claim.quadratic, strict=True))
    far, error = float(claim.lookahead), float(claim.place_error)
    slant = np.hypot(float(claim.k1) * np.hypot(1, (beside + error) / far), float(claim.cap) / far)
    return float((float(claim.force) + steep * slant * error + gain * float(claim.velocity_error)) * UP)


UP = 1 + 1e-9
"""Factor that covers the rounding of a bound."""

Turn = tuple[float, float, float, float]
"""The numbers r e1, r e2, turn rate of the path frame, and r; r is 0 in claims whose thrust is the present command."""


@dataclass(frozen=True)
class Coupling:
    """Bounds of what m12 changes: 1 − ρ², the largest |β| [1/kg], and the norm `loose` [1/s] of the loose terms."""

    remaining: Fraction
    cross: Fraction
    loose: Fraction


def coupling_of(claim: TurningClaim) -> Coupling:
    """Return the bounds of what m12 changes for all masses."""
    c = coupled_mass(claim)
    first, second = (claim.mass_factor[0] * m for m in claim.mass)
    rho = c * c / (first * second)
    ratio = _ratio(claim) * max(claim.mass[0] / claim.mass[1], claim.mass[1] / claim.mass[0])
    loose = claim.yaw_rate * (c * (1 / first + 1 / second) + rho * (1 + ratio)) / (1 - rho)
    return Coupling(1 - rho, c / (first * second * (1 - rho)), loose)


def inverse_masses(claim: TurningClaim, coupling: Coupling) -> list[tuple[float, float, float]]:
    """Return the vertices of the diagonal of M⁻¹ and of its other entry."""
    ends = claim.mass_factor[0] * coupling.remaining, claim.mass_factor[1]
    pairs = axis_pairs(ends, claim.mass_asymmetry)
    cross = float(coupling.cross) * UP
    signs = sorted({cross, -cross})
    first, second = claim.mass
    return [(float(1 / (f * first)), float(1 / (g * second)), b) for f, g in pairs for b in signs]


def _ratio(claim: TurningClaim) -> Fraction:
    """Return the largest ratio of the factors of the two masses."""
    ratio = (2 + claim.mass_asymmetry) / (2 - claim.mass_asymmetry)
    return min(ratio, claim.mass_factor[1] / claim.mass_factor[0])


def turn_points(claim: TurningClaim) -> list[Turn]:
    """Return points whose hull contains (r e1, r e2, σ, r) for all masses, |r| ≤ r_max and all curvatures.

    With q = m11/m22, (1 − e1)(1 + e2) = 1/q · q = 1 is a hyperbola, which lies in the triangle of its ends and of the
    intersection of the tangents there.
    """
    ratio = _ratio(claim)
    low, high = claim.mass[0] / claim.mass[1] / ratio, claim.mass[0] / claim.mass[1] * ratio
    points = {(1 - 1 / q, q - 1) for q in (low, high)} | {(1 - 2 / (low + high), 2 * low * high / (low + high) - 1)}
    turn = claim.yaw_rate if claim.behind else Fraction(0)
    ends = {(sign * claim.yaw_rate * a, sign * claim.yaw_rate * b, sign * turn) for a, b in points for sign in (1, -1)}
    bend = float(claim.curvature * claim.cruise) * UP
    return [(float(a) * UP, float(b) * UP, c, float(r) * UP) for a, b, r in sorted(ends) for c in sorted({bend, -bend})]


Array = NDArray[np.float64]

STILL: tuple[Pair, Pair, Pair] = ((Fraction(0), Fraction(0)),) * 3
"""Coefficients of the gains of a steady command that does not shift."""

_FIRST = 2 * (np.sqrt(2) - 1)  # least secant slope of |u| u from v, divided by v


def flow_gains(flow: tuple[Pair, Pair, Pair], f: tuple[Fraction, ...]) -> Pair:
    """Return (g_x, g_y) for the drag factors (linear surge, linear sway, quadratic surge, quadratic sway)."""
    means = Fraction(1), (f[0] + f[1]) / 2 - 1, (f[2] + f[3]) / 2 - 1
    along, across = (sum((row[k] * mean for row, mean in zip(flow, means, strict=True)), Fraction(0)) for k in (0, 1))
    return along, across


def flow_error(claim: TurningClaim, flow: tuple[Pair, Pair, Pair], omega: tuple[float, float], share: Array) -> Array:
    """Return the largest norm (cells,) [N] of the error by the current; arguments as in `turning_cells`.

    For given slopes and drag factors, the errors of both axes are E c with a matrix E that is affine in them, so that
    its norm is largest at a vertex; the heading is that of the middle of the cell, up to a bound.
    """
    v, current = float(claim.cruise), float(claim.current) * UP
    moved = current * max(abs(float(g)) for f in drag_factors(claim) for g in flow_gains(flow, f))
    sides = []  # α and β of each axis (ends, cells)
    for axis in (0, 1):
        gain, square = float(claim.mass[axis] * claim.k_v), float(claim.quadratic[axis])
        low, high = share[:, axis, 0], share[:, axis, 1]
        law = np.array(_slopes((v + omega[0]) * low, (v + omega[1]) * high, moved))
        sides.append((gain + float(claim.linear[axis]) + square * law, np.array(_slopes(v * low, v * high, current))))
    middle, half = share.mean(axis=2), (share[:, :, 1] - share[:, :, 0]) / 2 + 1e-12
    most = np.zeros(len(share))
    for f in drag_factors(claim):
        gains, rows, rounded = np.array([float(g) for g in flow_gains(flow, f)]), [], 0.0
        for axis, (law, drag) in enumerate(sides):
            pulled = float(f[axis] * claim.linear[axis]) + float(f[2 + axis] * claim.quadratic[axis]) * drag
            left = pulled[:, None, :, None] - law[None, :, :, None] * gains  # (β, α, cells, c)
            rows.append(left.reshape(4, len(share), 2))
            rounded += 1e-12 * float(pulled.max() + law.max() * np.abs(gains).sum())
        for one, two in product(*rows):
            error = np.stack([one * middle, two * middle[:, ::-1] * [-1.0, 1.0]], 1)  # n_1 = (cos, sin)
            off = np.hypot(np.linalg.norm(one * half, axis=1), np.linalg.norm(two * half[:, ::-1], axis=1))
            most = np.maximum(most, np.linalg.norm(error, 2, axis=(1, 2)) * UP + off + rounded)
    return np.asarray(most * current * UP)


def _slopes(low: Array, high: Array, change: float) -> tuple[Array, Array]:
    """Return bounds of the secant slopes of |u| u from u in [low, high] to a point at most `change` away."""
    return np.maximum(_FIRST * low, 2 * low - change) / UP, (2 * high + change) * UP
