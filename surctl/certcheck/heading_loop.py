"""The matrix of the heading-steered loop on cells of (ψ, y_e); its rows are affine in (ψ, y_e) up to an error bound.

If m11 = m22, the Coriolis force vanishes in the path frame. With ξ = (x − x*, y, ψ, U_x − c, U_y, r),

    m U̇ = e1(ψ) (φ_u f_u − σ_u δu) + e2(ψ) (φ_v f_v − σ_v v),   m44 ṙ = φ_r f_r − σ_r r,
    δu = cos ψ δU_x + sin ψ U_y − c κ ψ,  v = −sin ψ δU_x + cos ψ U_y − c ψ sinc ψ,   κ = (1 − cos ψ)/ψ,
    f_u = m̂ k (−k1 (q/Δ) x + u_c* y²/(Δ (q + Δ)) − δu),  f_v = −m̂ k v,  f_r = −m̂44 k_r (r + k_ψ (ψ + atan(y/Δ)))

hold exactly. Here e1 and e2 are the body axes in the path frame, v is the sway velocity, c the cruise speed, Δ the
lookahead distance, and q = √(y² + Δ²). A hat marks a parameter of the law's model; k, k1, k_r and k_ψ are gains. σ is a
secant slope of the drag, and φ is the share of the command that the thrust limits allow. The trim force T* occurs only
in u_c* = c + (T* − T̂)/(m̂ k), the surge command at rest. Every coefficient of ξ is a smooth function of ψ or of y. On
a cell, the tangent of this function and a bound on its second derivative enclose it. All numbers are doubles.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Plane", "Rows", "constant", "rows"]

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
