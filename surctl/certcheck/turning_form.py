"""The form V of a turning cruise in double precision, with thrust that follows the law late.

With thrust lag, the state has the entries F beside ξ; with held commands, the entries ε. Without ε, V = zᵀ P z with z =
ξ or z = (ξ, F). Let f_i be the command that the law computes at present for axis i, limited as the law limits it, u_i
the command of the last control instant, and m_i the mass in the law's model.

With lag, F = Σ n_i F_i/m_i, where F_i is the thrust minus the trim force f_i* at the present heading. T times the rate
of the thrust is u_i minus the thrust. With the quarter turn S and D = Σ n_i (u_i − f_i)/m_i,

    Ḟ = Σ n_i φ_i ((g_i + h_i) n_iᵀ δW − g_i n_iᵀ δU)/(T m_i) − F/T + r S F + D/T + w_2.

w_2 is −r ∂f_i*/∂ψ/m_i on axis i, and F accelerates the vehicle: thrust − drag = m_i n_iᵀ F − t_i n_iᵀ δU + l_i.

A command that is held for the period p is constant, and D is 0 at each control instant. D changes only by the present
command: Ḋ = −Σ n_i ḟ_i/m_i + r J' D, where J' D does not change |D|. A command at its limit does not move. So on each
axis ḟ_i is either 0, or that of a command without a limit, and with s_i = 0 or 1, and J = n_1 n_2ᵀ − n_2 n_1ᵀ,

    Ḋ = Σ s_i n_i n_iᵀ (k_v U̇ + r J (k_v δU − k_v δW) + w_1 + w_2 + w_3) + r J' D,

because f_i/m_i = k_v (n_i W − n_i U) + feedforward without a limit. If s_i = 1, no limit is active, and φ_i = 1. With
h_i the slope of the feedforward divided by m_i, w_1 = −Σ n_i (k_v + h_i) n_i Ẇ, and |Ẇ| ≤ L |δU| with the Lipschitz
constant L of the commanded velocity. w_3 is the part r h_i of δW on the other axis. With lag, w_2 also moves F, by the
slope of the feedforward at the steady command W*; so w_3 has the rest, r (h_i − h_i*) of W* on the other axis, which is
at most r e_i |n_i δW| with e_i = 2 b̂_i |n_j W*|/m_i. With c the largest (k_v + h_i) L and H the norm of [[e_1, h_1],
[h_2, e_2]], e_i = 0 without lag, 2 q εᵀ (w_1 + w_3) ≤ λ q |ε|² + (2/λ) q (c² |δU|² + (r H)² |δW|²).

At the time σ p after a control instant, D = σ ε, and ε is bounded by the largest rate of the commands since. With V = W
+ q σ (1 − σ) |ε|², W = zᵀ P z, V is continuous, and V = W at the control instants (a looped functional: Fridman 2010,
Seuret 2012). As d(σ (1 − σ) |ε|²)/dt = 2 (1 − σ) εᵀ Ḋ − |ε|²/p,

    V̇ + (a + η) V = Ẇ + (a + η) W − q |ε|²/p + 2 q (1 − σ) εᵀ Ḋ + (a + η) q σ (1 − σ) |ε|².

With lag, D acts on Ḟ. Without lag, thrust − drag has m_i n_iᵀ D in place of m_i n_iᵀ F, and so has U̇ in Ḋ. Ẇ is affine
in D = σ ε. For given z, ε and w, all this is affine in σ but for σ (1 − σ) q εᵀ (2 k_v Σ n_i μ_i n_i + a + η) ε, with
μ_i the mass in the model over the true one, which is at most q (k_v max μ_i/2 + (a + η)/4) |ε|². So the two ends
decide: at σ = 0, D does not act, and at σ = 1, Ḋ does not count. The matrices of `turning_matrix` prove V̇ + (a + η) V <
η low at both, and so between.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.region_exact import Matrix, root_up
from surctl.certcheck.turning_claim import TurningClaim
from surctl.certcheck.turning_terms import UP

__all__ = ["TWIST", "Extent", "Form", "Phase", "Stir", "axes_of", "lipschitz", "stir"]

Array = NDArray[np.float64]

TWIST = np.array([[0.0, 1.0], [-1.0, 0.0]])
"""J = n_1 n_2ᵀ − n_2 n_1ᵀ; the quarter turn S is Jᵀ."""

_WORST = 1e4  # largest condition of the scaled matrix of V


class Form:
    """V in double precision, with the matrices T and T P (n, n), T P Tᵀ ≈ I.

    Args:
        p: matrix P (n, n), with the weight q of each entry of ε if there is one.
    """

    def __init__(self, p: Array) -> None:
        self.p = p
        self.change = np.tril(np.linalg.inv(np.linalg.cholesky(p)))
        self.left = self.change @ p

    @classmethod
    def of(cls, p: Matrix, weight: Fraction | None = None) -> Form:
        """Return V for the matrix P without ε, and the weight q [s⁴/m²], None for commands that are not held.

        Raises:
            Rejected: P is too ill-conditioned for double precision.
        """
        own = len(p)
        whole = np.eye(own + (0 if weight is None else 2)) * float(weight or 0)
        whole[:own, :own] = [[float(entry) for entry in row] for row in p]
        form = cls(whole)
        scale = np.abs(form.change) @ np.abs(form.p) @ np.abs(form.change).T
        if not (scale.max() <= _WORST and np.all(np.diag(form.change) > 0)):  # a NaN fails this test too
            raise Rejected("P is too ill-conditioned for double precision")
        return form


class Extent:
    """Extent of the set V ≤ level about the steady cruise.

    Args:
        variances: those of x and y, entries of P⁻¹ [m²].
        covariance: the entries (4, 4) of P⁻¹ for positions and velocities.
    """

    def __init__(self, variances: Sequence[Fraction], covariance: Array) -> None:
        self.variances, self.covariance = variances, covariance

    @classmethod
    def of(cls, covariance: Matrix) -> Extent:
        """Return the extent for an exact P⁻¹."""
        block = np.array([[float(x) for x in row[:4]] for row in covariance[:4]])
        return cls([covariance[k][k] for k in (0, 1)], block)

    def size(self, k: int, high: Fraction) -> Fraction:
        """Return a bound on the deviation of x (k = 0) or y (k = 1) in V ≤ high [m]."""
        return root_up(self.variances[k] * high)

    def largest(self, place: Array, speed: Array, axes: Array, high: float) -> Array:
        """Return bounds (h,) on |n · rows ξ| over V ≤ high and unit vectors n with n nᵀ in the hull of `axes`.

        Args:
            place, speed: the blocks (rows, 2, 2) or (h, rows, 2, 2) of several matrices; the largest bound counts.
            axes: matrices (h, z, 2, 2) of each of h cells.
            high: the level.
        """
        rows = np.concatenate(np.broadcast_arrays(place, speed), axis=-1)
        gram = rows @ self.covariance @ rows.swapaxes(-1, -2)
        size = np.abs(rows) @ np.abs(self.covariance) @ np.abs(rows).swapaxes(-1, -2)
        flat = axes.reshape(*axes.shape[:2], 4).swapaxes(-1, -2)  # (h, 4, z)
        at = gram.reshape(*gram.shape[:-2], 4) @ flat + 1e-12 * (size.reshape(*size.shape[:-2], 4) @ np.abs(flat))
        return np.asarray(np.sqrt(np.maximum(at.max(axis=(-1, -2)), 0.0) * high) * UP + 1e-12)


def axes_of(z: Array) -> tuple[Array, Array]:
    """Return n_i n_iᵀ and n_j n_iᵀ (2, ..., 2, 2) of both body axes i, for points (cos 2ψ, sin 2ψ) (..., 2)."""
    turned = z @ np.array([[1.0, 0.0, 0.0, -1.0], [0.0, 1.0, 1.0, 0.0]])
    mirror = z @ np.array([[0.0, 1.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 1.0]])  # n_1 n_2ᵀ + n_2 n_1ᵀ
    turned, mirror = (rows.reshape(*z.shape, 2) for rows in (turned, mirror))
    axes, crossed = (np.eye(2) + turned, np.eye(2) - turned), (mirror - TWIST, mirror + TWIST)
    return np.stack(axes) / 2, np.stack(crossed) / 2


class Phase(NamedTuple):
    """One of the forms that decide: the time constant T [s] (0 without lag), λ and φ [1/s], and whether σ is 0.

    φ is what remains of 1/p. There are two forms for held commands, else one.
    """

    lag: float = 0.0
    split: float = 0.0
    fall: float = 0.0
    begins: bool = True


class Stir(NamedTuple):
    """What moves the commands in each cell of headings, in a level of V.

    `spread` (h,) is c [1/s²], `ahead` (h, 2) the rate at which the heading turns the command of the steady cruise
    [m/s³], and `swing` (h,) the largest r H [1/s²].
    """

    spread: Array
    ahead: Array
    swing: Array


def lipschitz(claim: TurningClaim, fast: float, beside: float) -> float:
    """Return L [1/s] for a commanded speed of at most `fast` [m/s] along the path and |y_e| ≤ `beside` [m]."""
    k1, ahead = float(claim.k1), float(claim.lookahead)
    free = np.sqrt(k1**2 * (1 + (beside / ahead) ** 2) + (fast / ahead) ** 2)
    return float(max(free, float(claim.cap) / ahead) * UP)


def stir(claim: TurningClaim, omega: float, fast: float, limit: float, share: Array, led: Array) -> Stir:
    """Return what moves the commands.

    Args:
        claim: the claim.
        omega, fast: largest |ω| and W* [m/s].
        limit: L [1/s].
        share: largest |cosine| (h, 2) between the path and each axis of the body.
        led: largest |n_i δW| (h, 2) [m/s].
    """
    k_v, r, cap = float(claim.k_v), float(claim.yaw_rate), float(claim.cap)
    model = np.array([[float(n) for n in pair] for pair in (claim.mass, claim.linear, claim.quadratic)])
    slope = (model[1] + 2 * model[2] * np.minimum(fast * share + led, cap)) / model[0]
    ahead = r * (k_v * omega + slope * fast) * share[..., ::-1]
    bent = 2 * model[2] / model[0] * fast * share[..., ::-1] * bool(claim.lag[1])
    rows = np.stack([bent[..., 0], slope[..., 0], slope[..., 1], bent[..., 1]], -1)
    turned = np.linalg.norm(rows.reshape(*share.shape, 2), 2, axis=(-2, -1))
    return Stir((k_v + slope.max(axis=-1)) * limit * UP, ahead * UP, np.asarray(r * turned * UP))
