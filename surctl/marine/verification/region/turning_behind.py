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
    """What thrust lag adds to the vertices.

    Attributes:
        k_v: gain of the law [1/s].
        lag: time constant [s]; 0 with held commands.
        fall: rate φ of the decay of |E|² [1/s].
        split: multiplier λ [1/s].
        acts: whether E acts on the vehicle.
        light: inverse factors of the masses (masses, 2).
        rates: yaw rate r of each Coriolis term (terms,) [rad/s].
        spread: weight c²/λ of q |δU|² (headings,) [1/s³]; with held commands, twice as much.
        swing: weight of q |δW|² (headings,) [1/s³], with held commands.
        late: bound on w_2 along each axis (headings, 2) [m/s³].
    """

    k_v: float
    lag: float
    fall: float
    split: float
    light: Array
    rates: Array
    spread: Array
    swing: Array
    late: Array
    acts: bool = True

    def phases(self) -> tuple[Behind, ...]:
        """Return the forms that decide: one with thrust lag; with held commands, those at both ends of a period."""
        if self.lag:
            return (self,)
        nothing = np.zeros_like(self.spread)
        end = replace(self, k_v=0.0, split=0.0, spread=nothing, swing=nothing, late=0 * self.late)
        return replace(self, acts=False), end

    def extended(
        self, A: Array, factor: Array, inner: Array, h: Numbers, t: Numbers, plans: Array, turn: Array, moves: Array
    ) -> tuple[Array, Array, Array]:
        """Return A, the factor of W and the weights of the squared states (k, 4) with the entries of E.

        `inner` (k, 2, 2) is ∂U̇/∂E, and `turn` (k, 2, 2) the rotation from the body. The weights of the disturbances
        depend on V, and are those of a typical V here.
        """
        whole, more = np.zeros((len(h), 6, 6)), np.zeros((len(h), 6, 4))
        whole[:, :4, :4], whole[:, 2:4, 4:] = A, inner * self.acts
        whole[:, 4:] = self.k_v * moves @ whole[:, 2:4]
        swung = self.k_v * self.rates[t][:, None, None] * (moves @ _TWIST)
        whole[:, 4:, 2:4] += swung
        whole[:, 4:, :2] += swung * plans[:, None, :]
        whole[:, 4:, 4:] -= (self.fall - self.split) / 2 * np.eye(2)
        more[:, :4, :2] = (_OTHERS if self.k_v else 1.0) * factor
        more[:, 4:, :2] = self.k_v * moves @ more[:, 2:4, :2]
        more[:, 4:, 2:] = _OWN * turn * self.late[h][:, None, :]
        weights = np.repeat(self.spread[h][:, None], 4, axis=1)
        weights[:, :2] = self.swing[h][:, None] * plans**2
        return whole, more, weights

    def added(self, change: Array, P: Array, bodies: Array, plans: Array, side: Array, moves: Array) -> tuple[Array, Array]:
        """Return what E adds to the matrices of V: (6, 6, headings, 1, terms, 1, 1, laws) and (headings, masses, 1, 6,
        6)."""
        place, speed, rear = change[:, :2].T, change[:, 2:4].T, change[:, 4:].T
        q, pull = P[4, 4], change @ P[:, 4:]
        swung = np.array([pull @ moves @ _TWIST @ (speed + plan[:, None] * place) * self.k_v for plan in plans])
        swung = swung + swung.swapaxes(-1, -2)
        led = np.einsum("h,pk,ki,kj->ijhp", q * self.swing, plans**2, place, place)
        away = np.einsum("t,phij->ijhtp", self.rates, swung)[:, :, :, None, :, None, None, :]
        away = away + led[:, :, :, None, None, None, None, :]
        more = side[:, None] @ np.einsum("mi,hijk->hmjk", self.light * self.acts, bodies) @ rear
        more = more + more.swapaxes(-1, -2) - (self.fall - self.split) * q * (rear.T @ rear)
        more = more + (self.spread * q)[:, None, None, None] * (speed.T @ speed)
        return away, more[:, :, None]


def _fall(claim: TurningClaim) -> float:
    """Return φ [1/s] of a claim with thrust lag or held commands."""
    return 2 / claim.lag if claim.lag else 1 / claim.period - claim.gains["k_v"] / claim.mass_factor[0] / 2


def split_of(claim: TurningClaim) -> float:
    """Return the multiplier λ [1/s] of a claim with thrust lag or held commands."""
    half = _fall(claim) / 2
    return float(f"{_SPLIT * max(half - claim.gains['k_v'], half / 2):.4g}")


def behind_of(
    claim: TurningClaim,
    omegas: tuple[float, float],
    forces: Array,
    covariance: Array,
    high: float,
    turn: Array,
    plans: Array,
    loops: Array,
    masses: Array,
    turns: Array,
) -> Behind:
    """Return what thrust lag or held commands add.

    Args:
        claim: the claim.
        omegas: range of ω [m/s].
        forces: largest |l_i| (headings, 2) [N].
        covariance: P⁻¹ (n, n).
        high: level of V.
        turn: rotation matrices (headings, 2, 2) of the grid.
        plans, loops, masses, turns: the vertices, see `Vertices`.
    """
    k_v, r, v, model = claim.gains["k_v"], claim.yaw_rate, claim.cruise, np.array(claim.mass)
    omega, fast = max(map(abs, omegas)), v + omegas[1]
    whole = covariance * high
    limit = lipschitz(claim.stated, fast, float(np.sqrt(whole[1, 1])))
    place, speed = whole[:2, :2], whole[2:4, 2:4]

    def largest(n: Array, matrix: Array) -> Array:
        return np.asarray(np.sqrt(np.einsum("hi,ij,hj->h", n, matrix, n)))

    def rows(n: Array, plan: Array, first: Array | float, second: Array | float) -> Array:
        row = np.hstack([n * plan * np.reshape(first, (-1, 1)), n * np.reshape(second, (-1, 1))])
        return np.asarray(np.sqrt(np.einsum("hi,ij,hj->h", row, whole[:4, :4], row)))

    axes = [turn[:, :, i] for i in (0, 1)]
    led = np.stack([np.max([largest(n * plan, place) for plan in plans], axis=0) for n in axes], 1)
    step = np.pi / 2 / max(len(turn) - 1, 1) / 2
    share = np.clip(np.abs(turn[:, 0, :]) + step, 0, 1)
    every = [stir(claim.stated, omega, fast, limit, one, two) for one, two in zip(share, led, strict=True)]
    slope, light = np.array([one.slope for one in every]), masses[:, :2] * model
    error = light.max(axis=0) * np.sqrt(whole[4, 4])
    crossed, moving = float(np.abs(turns[:, :2]).max()), np.zeros(2)
    for i, j in ((0, 1), (1, 0)):
        per = masses[:, i].max()
        pushed = np.max([per * rows(axes[i], plan, *pair) for plan in plans for pair in
                         np.moveaxis(loops[:, i], 1, 0).swapaxes(1, 2)], axis=0)  # fmt: skip
        swung = np.max([rows(axes[j], plan, k_v, k_v) for plan in plans], axis=0)
        own = k_v * (forces[:, i] * per + crossed * (v * share[:, j] + claim.current))
        own += np.array([one.ahead[i] for one in every])
        ahead = (k_v + slope[:, i]) * limit * np.sqrt(np.linalg.eigvalsh(speed)[-1])
        growth = ahead + k_v * (pushed + error[i] + crossed * largest(axes[j], speed)) + r * swung
        moving[i] = float((growth + r * slope[:, i] * led[:, j] + own).max())
    split = split_of(claim)
    spread = np.array([one.spread for one in every]) ** 2 / split
    if claim.lag:
        late = np.array([one.turned for one in every]) + claim.period * moving / claim.lag
        swing = np.zeros(len(every))
    else:
        late = np.array([one.ahead for one in every])
        spread, swing = 2 * spread, 2 * np.array([one.swing for one in every]) ** 2 / split
    return Behind(k_v, claim.lag, _fall(claim), split, light, turns[:, 3], spread, swing, late)
