"""The form V of a turning cruise in double precision, with thrust that follows the law late.

If the thrust is the present command, V = ξᵀ P ξ. With lag, V = ξᵀ P ξ + q |E|². On axis i, E = n_i · E is the thrust
minus its command, divided by the mass in the law's model. With held commands, V = ξᵀ P ξ + q σ (1 − σ) |E/σ|² at the
share σ of a period.

Let F_i be the thrust on axis i, f_i the command that the law computes at present, and u_i the command of the last
control instant: T Ḟ_i = u_i − F_i, or F_i = u_i without lag. With m_i of the law's model and E = Σ n_i (F_i − f_i)/m_i,

    Ė = −E/T + k_v U̇ + r J (k_v δU − k_v δW) + w_1 + w_2 + r J' E,    J = n_1 n_2ᵀ − n_2 n_1ᵀ,

because f_i/m_i = k_v (n_i W − n_i U) + feedforward, if no thrust limit is active in the region. J' E does not change
|E|. With h_i the slope of the feedforward divided by m_i, w_1 = −Σ n_i (k_v + h_i) n_i Ẇ, and |Ẇ| ≤ L |δU| with the
Lipschitz constant L of the commanded velocity. So 2 q Eᵀ w_1 ≤ λ q |E|² + (c²/λ) q |δU|², where c is the largest
(k_v + h_i) L. On each axis, w_2 holds the commands that turn with the heading, r (k_v ω + h_i W) on the other axis, and
(u_i − f_i)/(T m_i).

Without lag, a command that is held for the period p is a constant F_i: the equation holds without −E/T, and E is 0 at
each control instant. At the time σ p after it, E = σ ε, and ε is bounded by the largest rate of the commands since.
With V = W + q σ (1 − σ) |ε|², W = ξᵀ P ξ, V is continuous, and V = W at the control instants (a looped functional:
Fridman 2010, Seuret 2012). As d(σ (1 − σ) |ε|²)/dt = 2 (1 − σ) εᵀ Ė − |ε|²/p,

    V̇ + (a + η) V = Ẇ + (a + η) W − q |ε|²/p + 2 q (1 − σ) εᵀ Ė + (a + η) q σ (1 − σ) |ε|².

Ẇ is affine in E = σ ε, and Ė in σ ε as well, by the term k_v Σ n_i μ_i n_i E of k_v U̇, with μ_i the mass in the model
over the true one. For given ξ, ε and w, all this is affine in σ but for σ (1 − σ) q εᵀ (2 k_v Σ n_i μ_i n_i + a + η) ε,
which is at most q (k_v max μ_i/2 + (a + η)/4) |ε|². So the two ends decide: at σ = 0, E does not act, and at σ = 1, Ė
does not count. The matrices of `turning_cells` prove V̇ + (a + η) V < η low at both, and so between.

The part r h_i of δW in w_2 is w_3 here: 2 q εᵀ (w_1 + w_3) ≤ λ q |ε|² + (2/λ) q (c² |δU|² + (r h)² |δW|²).

With lag and held commands: if V(t) is the first to exceed max(e^(−a t), floor), then V(t − s) ≤ e^(a s) V(t)
for all s before. |ḟ_i|/m_i ≤ G_i √V + g_i holds in the whole region, so that |u_i − f_i|/m_i ≤ p (e^(a p/2) G_i √V +
g_i).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.region_exact import Matrix, inverse
from surctl.certcheck.turning_claim import TurningClaim
from surctl.certcheck.turning_terms import UP, Turn

__all__ = ["Form", "Late", "Phase", "Stir", "axes_of", "held", "stir"]

Array = NDArray[np.float64]

_WORST = 1e4  # largest condition of the scaled matrix of V


class Form:
    """V in double precision, with the exact P⁻¹ rounded to doubles.

    Args:
        p: matrix P (4, 4).
        weight: the weight q [s⁴/m²]; None for thrust that is the present command.
        k_v: the law's gain k_v [1/s], by which an acceleration changes the command.
    """

    def __init__(self, p: Matrix, weight: Fraction | None = None, k_v: Fraction = Fraction(0)) -> None:
        self.exact = inverse(p)
        size = 4 if weight is None else 6
        self.p, self.covariance, self.change = np.zeros((3, size, size))
        for whole, part in ((self.p, p), (self.covariance, self.exact)):
            whole[:4, :4] = [[float(entry) for entry in row] for row in part]
        self.change[:4, :4] = np.tril(np.linalg.inv(np.linalg.cholesky(self.p[:4, :4])))  # T with T P Tᵀ ≈ I
        for k in range(4, size):
            self.p[k, k], self.covariance[k, k] = float(weight or 0), 1 / float(weight or 0)
            self.change[k, k] = 1 / np.sqrt(self.p[k, k])
        scale = np.abs(self.change) @ np.abs(self.p) @ np.abs(self.change).T
        if not (scale.max() <= _WORST and np.all(np.diag(self.change) > 0)):  # a NaN fails this test too
            raise Rejected("P is too ill-conditioned for double precision")
        entry = np.zeros((size, 2))  # what an acceleration of the vehicle changes: velocity, and thrust behind command
        entry[2:4] = np.eye(2)
        entry[4:] = float(k_v) * np.eye(2)[: size - 4]
        self.entry = entry
        self.lever = self.change @ self.p @ entry
        self._at = np.eye(4, size)[:2], np.eye(4, size)[2:]
        self.place, self.speed, self.error = self.change[:, :2], self.change[:, 2:4], self.change[:, 4:]

    def rows(self, place: Array, speed: Array) -> Array:
        """Return the matrices (…, 2, n) of functions of position and velocity from their blocks (…, 2, 2)."""
        return place @ self._at[0] + speed @ self._at[1]

    def largest(self, rows: Array, axes: Array, high: float) -> float:
        """Return a bound on |n · rows ξ| over V ≤ high and unit vectors n with n nᵀ in the hull of `axes` (k, 2, 2).

        Of several matrices `rows` (…, 2, n), the largest bound is returned.
        """
        gram = rows @ self.covariance @ rows.swapaxes(-1, -2)
        size = np.abs(rows) @ np.abs(self.covariance) @ np.abs(rows).swapaxes(-1, -2)
        flat = axes.reshape(-1, 4).T
        at = gram.reshape(-1, 4) @ flat + 1e-12 * (size.reshape(-1, 4) @ np.abs(flat))
        return float(np.sqrt(max(at.max(), 0.0) * high) * UP + 1e-12)


def axes_of(z: Array) -> tuple[Array, Array]:
    """Return n_1 n_1ᵀ and n_2 n_2ᵀ (k, 2, 2) for points (cos 2ψ, sin 2ψ) (k, 2)."""
    turned = np.stack([np.stack([z[:, 0], z[:, 1]], 1), np.stack([z[:, 1], -z[:, 0]], 1)], 1)
    return (np.eye(2) + turned) / 2, (np.eye(2) - turned) / 2


class Phase(NamedTuple):
    """One of the forms that decide: λ and φ [1/s], whether Ė counts, and whether E acts on the vehicle.

    φ is 2/T with lag, and with held commands what remains of 1/p. There is one form with lag, and two for held
    commands.
    """

    split: float = 0.0
    fall: float = 0.0
    drive: bool = True
    acts: bool = True


@dataclass(frozen=True)
class Stir:
    """What moves the commands in a cell of headings and a level of V.

    `share` (2,) is the largest |cosine| between the path and each axis, `led` (2,) the largest |n_i δW| [m/s], `slope`
    (2,) the largest h_i [1/s], `spread` c [1/s²], and `turned` (2,) the rate at which the heading turns the command of
    the steady cruise and of δW [m/s³]; `ahead` (2,) is the part of the steady cruise, and `swing` the largest |r h_i|
    [1/s²].
    """

    share: Array
    led: Array
    slope: Array
    spread: float
    turned: Array
    ahead: Array
    swing: float


@dataclass(frozen=True)
class Late:
    """The bound p (e^(a p/2) G_i √V + g_i) on |u_i − f_i|/m_i: its two parts (2,) [m/s²]."""

    growing: Array
    fixed: Array

    def at(self, level: float) -> Array:
        """Return the bound (2,) [m/s²], divided by √(V/level), for V ≥ level."""
        return np.asarray((self.growing * np.sqrt(level) + self.fixed) * UP)


def lipschitz(claim: TurningClaim, fast: float, beside: float) -> float:
    """Return L [1/s] for a commanded speed of at most `fast` [m/s] along the path and |y_e| ≤ `beside` [m]."""
    k1, ahead = float(claim.k1), float(claim.lookahead)
    free = np.sqrt(k1**2 * (1 + (beside / ahead) ** 2) + (fast / ahead) ** 2)
    return float(max(free, float(claim.cap) / ahead) * UP)


def stir(claim: TurningClaim, omega: float, fast: float, limit: float, share: Array, led: Array) -> Stir:
    """Return what moves the commands; `omega` and `fast` are the largest |ω| and W* [m/s], `limit` is L [1/s]."""
    k_v, r, cap = float(claim.k_v), float(claim.yaw_rate), float(claim.cap)
    model = np.array([[float(n) for n in pair] for pair in (claim.mass, claim.linear, claim.quadratic)])
    reached = np.minimum(fast * share + led, cap)
    slope = (model[1] + 2 * model[2] * reached) / model[0]
    turned = r * (k_v * omega * share[::-1] + slope * reached[::-1])
    ahead = r * (k_v * omega + slope * fast) * share[::-1]
    return Stir(
        share,
        led,
        slope * UP,
        float((k_v + slope.max()) * limit * UP),
        turned * UP,
        ahead * UP,
        float(r * slope.max()) * UP,
    )


def held(
    claim: TurningClaim,
    form: Form,
    cells: list[tuple[Stir, list[Array], tuple[Array, Array], Array]],
    plans: list[Array],
    heavy: Array,
    turns: list[Turn],
    limit: float,
) -> Late:
    """Return the bound on the change of the commands in a period, over all cells of headings, with thrust lag.

    Args:
        claim: the claim.
        form: V.
        cells: of each cell at level 1, what moves the commands, the pairs of stiffness and damping (k, 2) of each axis,
            the axes (k, 2, 2), and the largest |l_i| (2,) [N].
        plans: the slopes of the commanded velocity.
        heavy: vertices of 1/m (k, 3).
        turns: vertices of the Coriolis terms.
        limit: L [1/s].

    Raises:
        Rejected: the period is too long for the claimed rate.
    """
    period, k_v, r = float(claim.period), float(claim.k_v), float(claim.yaw_rate)
    late = 1 - float(claim.rate) * period / 2
    if late <= 0:
        raise Rejected("the control period is too long for the claimed rate")
    eye, none, slopes = np.eye(2), np.zeros((2, 2)), np.array(plans)
    crossed, v = float(np.abs(np.array(turns)[:, :2]).max()), float(claim.cruise)
    fastest = np.sqrt(np.linalg.eigvalsh(form.covariance[2:4, 2:4])[-1]) * UP
    growing, fixed = np.zeros(2), np.zeros(2)
    for at, loops, axes, lack in cells:
        for i, j in ((0, 1), (1, 0)):
            per, mass = heavy[:, i].max(), float(claim.mass[i])
            stiff, damped = loops[i].T[:, :, None, None, None]
            pushed = form.largest(per * form.rows(stiff * slopes, damped * eye), axes[i], 1.0)
            behind = per * mass / np.sqrt(form.p[4, 4])  # F_i − f_i is a state
            moved = form.largest(form.rows(none, eye), axes[j], 1.0)
            swung = form.largest(form.rows(k_v * slopes, k_v * eye), axes[j], 1.0)
            growth = (k_v + at.slope[i]) * limit * fastest + k_v * (pushed + behind + crossed * moved)
            growth += r * (swung + at.slope[i] * at.led[j])
            own = k_v * (lack[i] * per + crossed * (v * at.share[j] + float(claim.current))) + at.ahead[i]
            growing[i], fixed[i] = max(growing[i], growth), max(fixed[i], own)
    return Late(growing * period / late * UP, fixed * period * UP)
