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
class Block:
    """Two entries of the state that follow the velocity: E, or the change of a held command.

    Attributes:
        at: number of the first entry.
        fall: rate φ of the decay of the square [1/s].
        split: multiplier λ [1/s].
        driven: whether the rate of the command counts in this form.
        acts: whether the entries act on the vehicle.
        feeds: rate at which the entries feed those of E [1/s].
    """

    at: int
    fall: float
    split: float
    driven: bool = True
    acts: bool = False
    feeds: float = 0.0


@dataclass(frozen=True)
class Behind:
    """What thrust lag and held commands add to the vertices.

    Attributes:
        k_v: gain of the law [1/s].
        blocks: the entries of the state that they add.
        light: inverse factors of the masses (masses, 2).
        rates: yaw rate r of each Coriolis term (terms,) [rad/s].
        spread: c² (headings,) [1/s⁴], twice as much without lag.
        swing: weight of |δW|² (headings,) [1/s⁴], without lag.
        late: bound on w_2 along each axis (headings, 2) [m/s³].
    """

    k_v: float
    blocks: tuple[Block, ...]
    light: Array
    rates: Array
    spread: Array
    swing: Array
    late: Array

    def phases(self, lag: float) -> tuple[Behind, ...]:
        """Return the forms that decide: with held commands those at both ends of a period, else one."""
        *first, last = self.blocks
        if not last.acts or lag and len(self.blocks) > 1:
            end = replace(last, driven=False, split=0.0, acts=not first, feeds=1 / lag if first else 0.0)
            return self, replace(self, blocks=(*first, end))
        return (self,)

    def extended(
        self, A: Array, factor: Array, inner: Array, h: Numbers, t: Numbers, plans: Array, turn: Array, moves: Array
    ) -> tuple[Array, Array, Array]:
        n = 4 + 2 * len(self.blocks)
        whole, more = np.zeros((len(h), n, n)), np.zeros((len(h), n, 4))
        whole[:, :4, :4] = A
        driven = any(block.driven for block in self.blocks)
        more[:, :4, :2] = (_OTHERS if driven else 1.0) * factor
        weights = np.zeros((len(h), 4, len(self.blocks)))
        for block in self.blocks:
            if block.acts:
                whole[:, 2:4, block.at : block.at + 2] = inner
        for k, block in enumerate(self.blocks):
            own = slice(block.at, block.at + 2)
            if block.feeds:
                whole[:, 4:6, own] += block.feeds * np.eye(2)
            if block.driven:
                swung = self.k_v * self.rates[t][:, None, None] * (moves @ _TWIST)
                whole[:, own] += self.k_v * moves @ whole[:, 2:4]
                whole[:, own, 2:4] += swung
                whole[:, own, :2] += swung * plans[:, None, :]
                more[:, own, :2] = self.k_v * moves @ more[:, 2:4, :2]
                more[:, own, 2:] = _OWN * turn * self.late[h][:, None, :]
                weights[:, :, k] = self.spread[h][:, None] / block.split
                weights[:, :2, k] = self.swing[h][:, None] / block.split * plans**2
            whole[:, own, own] -= (block.fall - block.split) / 2 * np.eye(2)
        return whole, more, weights

    def pull(self, change: Array, P: Array) -> Array:
        """Return T P of the entries that a command drives (n, 2)."""
        return np.asarray(sum((change @ P[:, b.at : b.at + 2] for b in self.blocks if b.driven), np.zeros((len(P), 2))))

    def added(self, change: Array, P: Array, bodies: Array, plans: Array, side: Array, moves: Array) -> tuple[Array, Array]:
        place, speed, pull = change[:, :2].T, change[:, 2:4].T, self.pull(change, P)
        swung = np.array([pull @ moves @ _TWIST @ (speed + plan[:, None] * place) * self.k_v for plan in plans])
        swung = swung + swung.swapaxes(-1, -2)
        away = np.einsum("t,phij->ijhtp", self.rates, swung)[:, :, :, None, :, None, None, :]
        more = np.zeros((len(bodies), len(self.light), len(P), len(P)))
        for block in self.blocks:
            q, rear = P[block.at, block.at], change[:, block.at : block.at + 2].T
            if block.acts:
                one = side[:, None] @ np.einsum("mi,hijk->hmjk", self.light, bodies) @ rear
                more = more + one + one.swapaxes(-1, -2)
            if block.feeds:
                one = change @ P[:, 4:6] @ rear * block.feeds
                more = more + one + one.T
            if block.driven:
                each = q / block.split
                more = more + (each * self.spread)[:, None, None, None] * (speed.T @ speed)
                led = np.einsum("h,pk,ki,kj->ijhp", each * self.swing, plans**2, place, place)
                away = away + led[:, :, :, None, None, None, None, :]
            more = more - (block.fall - block.split) * q * (rear.T @ rear)
        return away, more[:, :, None]


def blocks_of(claim: TurningClaim) -> tuple[Block, ...]:
    """Return the entries that thrust lag and held commands add to the state."""

    def split(fall: float) -> float:
        return float(f"{_SPLIT * max(fall / 2 - claim.gains['k_v'], fall / 4):.4g}")

    blocks = []
    if claim.lag:
        fall = 2 / claim.lag
        blocks.append(Block(4, fall, split(fall), acts=True))
    if claim.period:
        fall = 1 / claim.period - (0.0 if claim.lag else claim.gains["k_v"] / claim.mass_factor[0] / 2)
        blocks.append(Block(4 + 2 * len(blocks), fall, split(fall)))
    return tuple(blocks)


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
    spread, light = np.array([one.spread for one in every]) ** 2, masses[:, :2] * model
    if claim.lag:
        late, swing = np.array([one.turned for one in every]), np.zeros(len(every))
    else:
        late, spread = np.array([one.ahead for one in every]), 2 * spread
        swing = 2 * np.array([one.swing for one in every]) ** 2
    return Behind(k_v, blocks_of(claim), light, turns[:, 3], spread, swing, late)
