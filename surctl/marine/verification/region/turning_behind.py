"""Thrust that lags behind its command, or follows a held one, in the search for V of a turning cruise.

The quantities are those of `certcheck.turning_form`, on a grid of headings and in floating point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.turning_form import lipschitz, stir
from surctl.marine.verification.region.turning import TurningClaim

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]

_TWIST = np.array([[0.0, 1.0], [-1.0, 0.0]])
_OTHERS, _OWN = np.sqrt(1.5), np.sqrt(4.5)  # weights of the disturbances of U̇, and of those of Ė alone
_SPLIT = 0.6  # of the decay of E that serves as multiplier λ


@dataclass(frozen=True)
class Behind:
    """What thrust lag and held commands add to the vertices: the entries F of the thrust, and then ε of a held command.

    Attributes:
        k_v: gain of the law [1/s].
        lag: time constant [s]; 0 for thrust without lag, and then no F.
        held: whether there is ε.
        driven: whether the rate of the commands counts in this form; else the held command acts in it.
        fall: rate φ of the decay of |ε|² [1/s].
        split: multiplier λ [1/s].
        light: inverse factors of the masses (masses, 2).
        rates: yaw rate r of each Coriolis term (terms,) [rad/s].
        spread: weight of |δU|² (headings,) [1/s³].
        swing: weight of |δW|² (headings,) [1/s³].
        late: bound on w_2 along each axis (headings, 2) [m/s³].
    """

    k_v: float
    lag: float
    held: bool
    driven: bool
    fall: float
    split: float
    light: Array
    rates: Array
    spread: Array
    swing: Array
    late: Array

    def phases(self) -> tuple[Behind, ...]:
        """Return the forms that decide: with held commands those at both ends of a period, else one."""
        if not self.held:
            return (self,)
        nothing = np.zeros_like(self.spread)
        return self, replace(self, driven=False, split=0.0, spread=nothing, swing=nothing)

    @property
    def error(self) -> int:
        """Number of the first entry of ε."""
        return 6 if self.lag else 4

    def entry(self, n: int) -> Array:
        """Return what w_2 changes (n, 2)."""
        entry = np.zeros((n, 2))
        if self.lag:
            entry[4:6] = np.eye(2)
        if self.held and self.driven:
            entry[-2:] = np.eye(2)
        return entry

    def extended(
        self,
        A: Array,
        factor: Array,
        inner: Array,
        h: Numbers,
        t: Numbers,
        plans: Array,
        turn: Array,
        moves: Array,
        led: Array,
    ) -> tuple[Array, Array, Array]:
        """Return A, the factor of W and the weights of the squared states (k, 4) with the entries of F and ε.

        `inner` (k, 2, 2) is ∂U̇/∂F, `turn` (k, 2, 2) the rotation from the body, `moves` (k, 2, 2) the matrix S, and
        `led` (k, 2, 4) the command divided by the mass. The weights of the disturbances depend on V, and are those of a
        typical V here.
        """
        n = self.error + 2 * self.held
        whole, more = np.zeros((len(h), n, n)), np.zeros((len(h), n, 4))
        whole[:, :4, :4] = A
        late = np.any(self.entry(n))
        more[:, :4, :2] = (_OTHERS if late else 1.0) * factor
        weights = np.zeros((len(h), 4))
        if self.lag:
            whole[:, 2:4, 4:6] = inner
            whole[:, 4:6, :4] = led / self.lag
            whole[:, 4:6, 4:6] = -np.eye(2) / self.lag - self.rates[t][:, None, None] * _TWIST
        if self.held and not self.driven:
            if self.lag:
                whole[:, 4:6, 6:] = np.eye(2) / self.lag
            else:
                whole[:, 2:4, 4:] = inner
        if self.held and self.driven:
            swung = self.k_v * self.rates[t][:, None, None] * (moves @ _TWIST)
            whole[:, -2:] = self.k_v * moves @ whole[:, 2:4]
            whole[:, -2:, 2:4] += swung
            whole[:, -2:, :2] += swung * plans[:, None, :]
            more[:, -2:, :2] = self.k_v * moves @ more[:, 2:4, :2]
            weights = np.repeat(self.spread[h][:, None], 4, axis=1)
            weights[:, :2] = self.swing[h][:, None] * plans**2
        if self.held:
            whole[:, -2:, -2:] -= (self.fall - self.split) / 2 * np.eye(2)
        more[:, :, 2:] = _OWN * self.entry(n) @ (turn * self.late[h][:, None, :])
        return whole, more, weights

    def added(
        self, change: Array, P: Array, bodies: Array, plans: Array, side: Array, moves: Array
    ) -> tuple[Array, Array]:
        """Return what F and ε add to the matrices of V: (n, n, headings, 1, terms, 1, 1, laws) and (headings, masses,
        1, n, n)."""
        place, speed = change[:, :2].T, change[:, 2:4].T
        away = np.zeros((len(P), len(P), 1, 1, len(self.rates), 1, 1, 1))
        more = np.zeros((len(bodies), len(self.light), len(P), len(P)))
        acting = side[:, None] @ np.einsum("mi,hijk->hmjk", self.light, bodies)
        if self.lag:
            thrust, rear = change @ P[:, 4:6], change[:, 4:6].T
            one = acting @ rear - thrust @ rear / self.lag
            more = more + one + one.swapaxes(-1, -2)
            turned = thrust @ _TWIST @ rear
            away = away - np.einsum("t,ij->ijt", self.rates, turned + turned.T)[:, :, None, None, :, None, None, None]
        if self.held:
            q, rear = P[-1, -1], change[:, -2:].T
            more = more - (self.fall - self.split) * q * (rear.T @ rear)
            if not self.driven:
                one = change @ P[:, 4:6] @ rear / self.lag if self.lag else acting @ rear
                more = more + one + one.swapaxes(-1, -2)
            else:
                pull = change @ P[:, -2:]
                swung = np.array([pull @ moves @ _TWIST @ (speed + plan[:, None] * place) * self.k_v for plan in plans])
                swung = swung + swung.swapaxes(-1, -2)
                away = away + np.einsum("t,phij->ijhtp", self.rates, swung)[:, :, :, None, :, None, None, :]
                led = np.einsum("h,pk,ki,kj->ijhp", self.swing * q, plans**2, place, place)
                away = away + led[:, :, :, None, None, None, None, :]
                more = more + (self.spread * q)[:, None, None, None] * (speed.T @ speed)
        return away, more[:, :, None]


def fall_of(claim: TurningClaim) -> float:
    """Return φ [1/s] of a claim with held commands."""
    return 1 / claim.period - claim.gains["k_v"] / claim.mass_factor[0] / 2 if claim.period else 0.0


def split_of(claim: TurningClaim) -> float:
    """Return the multiplier λ [1/s] of a claim with held commands."""
    half = fall_of(claim) / 2
    return float(f"{_SPLIT * max(half - claim.gains['k_v'], half / 2):.4g}")


def behind_of(
    claim: TurningClaim,
    omegas: tuple[float, float],
    fastest: float,
    covariance: Array,
    high: float,
    turn: Array,
    plans: Array,
    masses: Array,
    turns: Array,
) -> Behind:
    """Return what thrust lag or held commands add.

    Args:
        claim: the claim.
        omegas: range of ω [m/s].
        fastest: largest commanded speed along the path [m/s].
        covariance: P⁻¹ (n, n).
        high: level of V.
        turn: rotation matrices (headings, 2, 2) of the grid.
        plans, masses, turns: the vertices, see `Vertices`.
    """
    k_v, model = claim.gains["k_v"], np.array(claim.mass)
    omega, fast, whole = max(map(abs, omegas)), claim.cruise + omegas[1], covariance[:2, :2] * high
    limit = lipschitz(claim.stated, fastest, float(np.sqrt(whole[1, 1])))

    def largest(n: Array) -> Array:
        return np.asarray(np.sqrt(np.einsum("hi,ij,hj->h", n, whole, n)))

    led = np.stack([np.max([largest(turn[:, :, i] * plan) for plan in plans], axis=0) for i in (0, 1)], 1)
    step = np.pi / 2 / max(len(turn) - 1, 1) / 2
    share = np.clip(np.abs(turn[:, 0, :]) + step, 0, 1)
    every = [stir(claim.stated, omega, fast, limit, one, two) for one, two in zip(share, led, strict=True)]
    light, late = masses[:, :2] * model, np.array([one.ahead for one in every])
    spread, swing, split = np.zeros(len(every)), np.zeros(len(every)), split_of(claim)
    if claim.period:
        spread = 2 * np.array([one.spread for one in every]) ** 2 / split
        swing = 2 * np.array([one.swing for one in every]) ** 2 / split
    held = claim.period > 0
    return Behind(k_v, claim.lag, held, held, fall_of(claim), split, light, turns[:, 3], spread, swing, late)
