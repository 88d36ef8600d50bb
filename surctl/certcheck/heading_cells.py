"""Proof of V̇ < −a V of the heading-steered loop in cells of (ψ, y_e), for all extreme thrust shares and drag slopes.

The rows of the matrix of the loop are affine in (ψ, y_e) on a cell, up to an error bound. If m11 = m22, the
Coriolis force vanishes in the path frame. With ξ = (x − x*, y, ψ, U_x − c, U_y, r),

    m U̇ = e1(ψ) (φ_u f_u − σ_u δu) + e2(ψ) (φ_v f_v − σ_v v),   m44 ṙ = φ_r f_r − σ_r r,
    δu = cos ψ δU_x + sin ψ U_y − c κ ψ,  v = −sin ψ δU_x + cos ψ U_y − c ψ sinc ψ,   κ = (1 − cos ψ)/ψ,
    f_u = m̂ k (−k1 (q/Δ) x + u_c* y²/(Δ (q + Δ)) − δu),  f_v = −m̂ k v,  f_r = −m̂44 k_r (r + k_ψ (ψ + atan(y/Δ)))

hold exactly. Here e1 and e2 are the body axes in the path frame, v is the sway velocity, c the cruise speed, Δ the
lookahead distance, and q = √(y² + Δ²). A hat marks a parameter of the law's model; k, k1, k_r and k_ψ are gains. σ is a
secant slope of the drag, and φ is the share of the command that the thrust limits allow. The trim force T* occurs only
in u_c* = c + (T* − T̂)/(m̂ k), the surge command at rest. Every coefficient of ξ is a smooth function of ψ or of y. On
a cell, the tangent of this function and a bound on its second derivative enclose it. All numbers are doubles.

A cell in which the proof fails is divided into four. An interval matrix is stored as its midpoint and its radius. The
norm of the radius and a bound on all rounding errors are subtracted from the diagonal of the midpoint; then a Cholesky
factorisation in double precision decides whether the matrix is positive definite (Rump 2006).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.heading_claim import HeadingClaim
from surctl.certcheck.patience import go_on

__all__ = ["Plane", "Rows", "check_cells", "constant", "rows"]

Array = NDArray[np.float64]

_TINY = 1e-12  # above the relative rounding error of every entry of order 1


@dataclass(frozen=True)
class Plane:
    """Array of functions mid + a psi + b y on a cell (a and b from −1 to 1), each with an error of at most `radius`."""

    mid: Array
    psi: Array
    y: Array
    radius: Array

    @property
    def spread(self) -> Array:
        """Return the largest difference between `mid` and a value of the function in the cell."""
        return np.asarray((np.abs(self.psi) + np.abs(self.y) + self.radius) * (1 + _TINY))

    def __add__(self, other: Plane) -> Plane:
        mid = self.mid + other.mid
        radius = self.radius + other.radius + _TINY * (np.abs(self.mid) + np.abs(other.mid))
        return Plane(mid, self.psi + other.psi, self.y + other.y, radius)

    def __mul__(self, other: Plane) -> Plane:
        a, b = np.abs(self.mid), np.abs(other.mid)
        radius = (
            a * other.radius
            + b * self.radius
            + self.spread * other.spread
            + _TINY * (a + self.spread) * (b + other.spread)
        )
        return Plane(
            self.mid * other.mid,
            self.mid * other.psi + other.mid * self.psi,
            self.mid * other.y + other.mid * self.y,
            radius,
        )

    def times(self, factor: float | Array) -> Plane:
        """Return the plane multiplied by a factor that has no error."""
        mid = self.mid * factor
        return Plane(mid, self.psi * factor, self.y * factor, self.radius * np.abs(factor) + _TINY * np.abs(mid))

    def at(self, index: Any) -> Plane:
        """Return the array entries that an index selects."""
        return Plane(self.mid[index], self.psi[index], self.y[index], self.radius[index])


def constant(value: Array) -> Plane:
    """Return a plane with the same value everywhere in the cell."""
    return Plane(value, 0 * value, 0 * value, 0 * value)


@dataclass(frozen=True)
class Rows:
    """Coefficients of ξ (n cells, 6) in δu, v, f_u/(m̂ k) + δu (for both extreme u_c*) and f_r, and axes e1, e2."""

    surge: Plane
    sway: Plane
    place: tuple[Plane, Plane]
    yaw: Plane
    ahead: Plane
    abeam: Plane


def rows(law: Mapping[str, float], commands: tuple[float, float], psi: Array, y: Array, half: Array) -> Rows:
    """Return `Rows` over the cells psi ± half[0], y ± half[1] with centres psi and y (n,), for |ψ| ≤ π/2."""
    n, ahead, v = len(psi), law["lookahead"], law["cruise"]
    zero = np.zeros(n)

    def turning(value: Array, slope: Array, bend: float) -> Plane:
        return Plane(value, slope * half[0], zero, bend / 2 * half[0] ** 2 + _TINY * (1 + np.abs(value)))

    def beside(value: Array, slope: Array, bend: float) -> Plane:
        return Plane(value, zero, slope * half[1], bend / 2 * half[1] ** 2 + _TINY * (1 + np.abs(value)))

    c, s = np.cos(psi), np.sin(psi)
    cos, sin = turning(c, -s, 1.0), turning(s, c, 1.0)
    # ∫ cos(tψ) dt and ∫ sin(tψ) dt over t in [0, 1]: second derivatives ≤ 1/3; their series is used for small ψ
    flat = np.abs(psi) < 1e-4
    by = np.where(flat, 1.0, psi)
    mean = np.where(flat, 1 - psi * psi / 6, s / by)
    lift = np.where(flat, psi / 2, 2 * np.sin(by / 2) ** 2 / by)
    sinc = turning(mean, np.where(flat, -psi / 3, (c - mean) / by), 1 / 3)
    kappa = turning(lift, np.where(flat, 0.5 - psi * psi / 8, (s - lift) / by), 1 / 3)
    q = np.hypot(y, ahead)
    stretch = beside(q / ahead, y / (q * ahead), 1 / ahead**2)
    bend = beside(y / (ahead * (q + ahead)), 1 / (q * (q + ahead)), 0.75 / ahead**3)
    # ∫ dt/(1 + t² z²), z = y/Δ: second derivative ≤ 2/3
    z = y / ahead
    near = np.abs(z) < 1e-4
    by = np.where(near, 1.0, z)
    angle = np.where(near, 1 - z * z / 3, np.arctan(z) / by)
    slope = np.where(near, -2 * z / 3, (1 / (1 + z * z) - angle) / by)
    lead = beside(angle / ahead, slope / ahead**2, 2 / 3 / ahead**3)

    def row(entries: Mapping[int, Plane]) -> Plane:
        parts = [entries.get(k, constant(zero)) for k in range(6)]
        return Plane(*(np.stack([getattr(p, name) for p in parts], 1) for name in ("mid", "psi", "y", "radius")))

    pull, one = law["yaw_inertia_kg_m2"] * law["k_r"], constant(np.ones(n))
    first, second = (row({0: stretch.times(-law["k1"]), 1: bend.times(command)}) for command in commands)
    return Rows(
        surge=row({2: kappa.times(-v), 3: cos, 4: sin}),
        sway=row({2: sinc.times(-v), 3: sin.times(-1.0), 4: cos}),
        place=(first, second),
        yaw=row({1: lead.times(-pull * law["k_psi"]), 2: one.times(-pull * law["k_psi"]), 5: one.times(-pull)}),
        ahead=row({3: cos, 4: sin}),
        abeam=row({3: sin.times(-1.0), 4: cos}),
    )


_MOST, _DEPTH, _CHUNK = 6_000, 5, 512
_UP = 1 + 1e-9  # factor that covers the rounding of a bound
_ROUNDING = 1e-11  # relative rounding error of a 6 × 6 product and its factorisation


@dataclass(frozen=True)
class _Form:
    p: Array  # P
    change: Array  # T with T P Tᵀ ≈ I
    covariance: Array  # P⁻¹
    shape: Array  # S, where S⁻¹ is the (ψ, y) part of P⁻¹
    regression: Array  # of ξ on (ψ, y)
    rest: Array  # covariance of the residual of the regression


def _form(p: Array) -> _Form:
    covariance = np.asarray(np.linalg.inv(p), dtype=np.float64)
    change = np.linalg.inv(np.linalg.cholesky(p))
    terms = np.abs(change) @ np.abs(p) @ np.abs(change).T  # size of the terms that `_part` rounds
    good = np.abs(p @ covariance - np.eye(6)).max() <= 1e-10 and terms.max() <= 1e3
    if not good:  # for a NaN too
        raise Rejected("P is too ill-conditioned for double precision")
    two = np.ix_((2, 1), (2, 1))
    shape = np.asarray(np.linalg.inv(covariance[two]), dtype=np.float64)
    regression = covariance[:, (2, 1)] @ shape
    rest = covariance - regression @ covariance[(2, 1), :]
    return _Form(p, np.tril(change), covariance, shape, regression, (rest + rest.T) / 2)


def _inside(form: _Form, psi: Array, y: Array, half: Array) -> Array:
    """Return for each cell a lower bound on V, whose least value at a given (ψ, y) is (ψ, y) S (ψ, y)ᵀ."""
    s = form.shape
    at = s[0, 0] * psi**2 + 2 * s[0, 1] * psi * y + s[1, 1] * y**2
    slack = half[0] * np.sqrt(s[0, 0]) + half[1] * np.sqrt(s[1, 1])
    return np.asarray(np.maximum(np.sqrt(np.maximum(at, 0)) / _UP - slack * _UP - 1e-9, 0) ** 2)


def _largest(form: _Form, row: Plane, psi: Array, y: Array, half: Array, least: Array) -> Array:
    """Return for each of the n cells an upper bound on |row · ξ| over the points of V ≤ 1 with (ψ, y) in the cell."""
    mean = np.einsum("nk,kj->nj", row.mid, form.regression)
    centre = np.abs(mean[:, 0] * psi + mean[:, 1] * y)
    moved = np.abs(mean[:, 0]) * half[0] + np.abs(mean[:, 1]) * half[1]
    own = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", row.mid, form.rest, row.mid), 0) + 1e-12)
    spread = row.spread @ np.sqrt(np.diag(form.covariance))
    return np.asarray((centre + moved + own * np.sqrt(np.maximum(1 - least, 0)) + spread) * _UP + 1e-9)


def _pair(share: Array) -> list[Array]:
    """Return the values of the thrust share for the proof: its least value and 1, or only 1 if no thrust saturates."""
    return [np.ones_like(share)] if np.all(share >= 1) else [share, np.ones_like(share)]


def _share(left: float, most: Array) -> Array:
    return np.minimum(1.0, left / most / _UP)


def check_cells(claim: HeadingClaim, matrix: Array, *, most: int = _MOST) -> int:
    """Prove V̇ < −a V on V ≤ 1 for the matrix P (6, 6), with at most `most` cells; return the number of cells.

    Raises:
        Rejected: the proof needs smaller cells or more cells than allowed, or the steady cruise alone reaches a thrust
            limit.
    """
    form = _form(matrix)
    law = {key: float(value) for key, value in claim.law.items()}
    extent = np.sqrt(np.diag(form.covariance)) * _UP + 1e-9
    if extent[2] > 1.5:
        raise Rejected("the region extends beyond a heading error of 1.5 rad")
    psi_edges, y_edges = np.linspace(-extent[2], extent[2], 17), np.linspace(0, extent[1], 9)
    cells = [g.ravel() for g in np.meshgrid(
        (psi_edges[1:] + psi_edges[:-1]) / 2, (y_edges[1:] + y_edges[:-1]) / 2)]  # fmt: skip
    psi, y = cells
    # neighbouring cells overlap a little, because their edges are rounded
    half = np.array([(psi_edges[1] - psi_edges[0]) / 2, (y_edges[1] - y_edges[0]) / 2]) * _UP + 1e-12
    count = 0
    for depth in range(_DEPTH + 1):
        least = _inside(form, psi, y, half)
        inside = ~(least > 1)
        psi, y, least = psi[inside], y[inside], least[inside]
        count += len(psi)
        if count > most:
            break
        chunks = [slice(k, k + _CHUNK) for k in range(0, len(psi), _CHUNK)]
        failed = [_fails(claim, law, form, psi[k], y[k], half, least[k]) for k in chunks]
        if not np.any(np.concatenate([[False], *failed])):
            return count
        psi, y = psi[np.concatenate(failed)], y[np.concatenate(failed)]
        if depth < _DEPTH:
            half = half / 2 * _UP + 1e-12
            psi = np.concatenate([psi + i * half[0] for i in (-1, 1) for _ in (0, 1)])
            y = np.concatenate([y + j * half[1] for _ in (0, 1) for j in (-1, 1)])
    raise Rejected(f"V does not decay at the claimed rate near psi = {psi[0]:.4g} rad, y_e = {y[0]:.4g} m")


def _fails(
    claim: HeadingClaim, law: dict[str, float], form: _Form, psi: Array, y: Array, half: Array, least: Array
) -> Array:
    """Return for each cell whether the proof of V̇ + a V < 0 fails for one combination of extreme parameters."""
    go_on()
    ranges = {key: (float(low), float(high)) for key, (low, high) in claim.ranges.items()}
    limits = {key: float(value) for key, value in claim.limits.items()}
    v, velocity_gain = law["cruise"], float(claim.velocity_gain)
    low, high = claim.command
    at = rows(law, (float(low), float(high)), psi, y, half)

    def most(row: Plane) -> Array:
        return _largest(form, row, psi, y, half, least)

    own = constant(np.eye(6)[5] + 0 * at.yaw.mid)  # r
    fast, side, turn = most(at.surge), most(at.sway), most(own)
    left = limits["surge_n"] - float(claim.trim[1])
    if left <= 0:
        raise Rejected("the steady cruise needs all the thrust")
    surge = [p + at.surge.times(-1.0) for p in at.place]
    share_u = _share(left, velocity_gain * np.maximum(most(surge[0]), most(surge[1])))
    share_v, share_r = _share(limits["sway_n"], velocity_gain * side), _share(limits["yaw_nm"], most(at.yaw))
    bound = 2 * (share_u < 1) + (share_r < 1)
    if np.any(bound != bound[0]):  # cells without saturation have fewer vertices: treat them separately
        split = np.empty(len(psi), dtype=bool)
        for kind in np.unique(bound):
            k = bound == kind
            split[k] = _fails(claim, law, form, psi[k], y[k], half, least[k])
        return split
    # secant slopes of |u| u from v: at least 0.828 v for every u, and at least 2 v − |δu|
    slow = ranges["surge_linear"][0] + ranges["surge_quadratic"][0] * np.maximum(0.828 * v, 2 * v - fast) / _UP
    quick = (ranges["surge_linear"][1] + ranges["surge_quadratic"][1] * (2 * v + fast)) * _UP
    sway = [ranges["sway_linear"][0] + 0 * side, (ranges["sway_linear"][1] + ranges["sway_quadratic"][1] * side) * _UP]
    spin = [ranges["yaw_linear"][0] + 0 * turn, (ranges["yaw_linear"][1] + ranges["yaw_quadratic"][1] * turn) * _UP]
    turns = [
        _part(form, _product(own.times(1 / inertia), at.yaw.times(p[:, None]) + own.times(-d[:, None])))
        for inertia, p, d in product(sorted(set(ranges["yaw_inertia_kg_m2"])), _pair(share_r), spin)
    ]
    still = _part(form, constant(np.broadcast_to(_KINEMATIC, (len(psi), 6, 6))))
    own_rate = float(claim.rate) * (form.change @ form.p @ form.change.T)
    failed = np.zeros(len(psi), dtype=bool)
    # sway thrust and sway drag add up to one coefficient: (φ_v m k + σ_v) v
    abeam = [velocity_gain * share_v + sway[0], velocity_gain + sway[1]]
    moves = product(sorted(set(ranges["mass_kg"])), at.place, _pair(share_u), (slow, quick), abeam)
    for mass, place, pu, du, held in moves:
        k = np.flatnonzero(~failed)
        ahead = place.at(k).times((velocity_gain * pu)[k, None]) + at.surge.at(k).times(
            -(velocity_gain * pu + du)[k, None]
        )
        driven = _product(at.ahead.at(k).times(1 / mass), ahead)
        moved = _part(form, driven + _product(at.abeam.at(k).times(1 / mass), at.sway.at(k).times(-held[k, None])))
        for turned in turns:
            mid, tilt, tip = (-(still[n][k] + moved[n] + turned[n][k]) for n in range(3))
            off = still[3][k] + moved[3] + turned[3][k] + _ROUNDING * float(claim.rate)
            mid -= own_rate + off[:, None, None] * np.eye(6)
            # the matrix is affine over the cell, so its corners decide
            for i, j in product((1, -1), (1, -1)):
                failed[k] |= ~_positive(mid + i * tilt + j * tip)
    return failed


def _product(column: Plane, row: Plane) -> Plane:
    return column.at(np.s_[:, :, None]) * row.at(np.s_[:, None, :])


_KINEMATIC = np.zeros((6, 6))
_KINEMATIC[0, 3] = _KINEMATIC[1, 4] = _KINEMATIC[2, 5] = 1


def _part(form: _Form, loop: Plane) -> tuple[Array, Array, Array, Array]:
    """Return T (P A + Aᵀ P) Tᵀ for n cells: mean, slopes in ψ and y (n, 6, 6), and a bound on the error (n,)."""
    t = form.change
    halves = []
    for part in (loop.mid, loop.psi, loop.y):
        half = (t @ form.p) @ part @ t.T
        halves.append(half + half.transpose(0, 2, 1))
    weight, side = np.abs(t) @ np.abs(form.p), np.abs(t).T
    spread = weight @ (loop.radius + _ROUNDING * (np.abs(loop.mid) + loop.spread)) @ side
    # ‖X + Xᵀ‖ is at most the largest row sum plus the largest column sum of |X|
    off = spread.sum(axis=2).max(axis=1) + spread.sum(axis=1).max(axis=1)
    return halves[0], halves[1], halves[2], off * _UP + 1e-12


def _positive(m: Array) -> NDArray[np.bool_]:
    """Return for each of n matrices (k, k) whether all Cholesky pivots are positive."""
    # one array for each matrix entry, so that every step runs over contiguous memory
    n = m.shape[1]
    a = {(i, j): m[:, i, j] for i in range(n) for j in range(i + 1)}
    good = np.ones(len(m), dtype=bool)
    for k in range(n):
        good &= a[k, k] > 0
        if not good.any():
            break
        inverse = 1 / np.where(good, a[k, k], 1.0)
        for i in range(k + 1, n):
            factor = a[i, k] * inverse
            for j in range(k + 1, i + 1):
                a[i, j] = a[i, j] - factor * a[j, k]
    return good
