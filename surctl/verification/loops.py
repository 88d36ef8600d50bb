"""Loops and step responses of many cascades at once, from eigenvalues: what margins and tables are read from.

A loop l that leaves the system A_o open and A_c closed is l(s) = det(sI − A_c)/det(sI − A_o) − 1, so that its
frequency response is a product over poles: no linear system is solved at any frequency. The blocks of A that do not
touch each other (surge, heave, sway with yaw) are told apart first, and each loop sees its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.verification.cascade import Cascade

__all__ = [
    "LOOP_NAMES",
    "Crossings",
    "Loop",
    "Shape",
    "broken_loops",
    "crossings_of",
    "shape_of",
    "state_blocks",
]

LOOP_NAMES = ("surge", "sway", "heave", "yaw", "along_track", "cross_track", "depth", "heading")
_LOWEST = 1e-4  # [rad/s]
_POINTS = 800
_SPURIOUS = 1e-6  # a crossing with |L| or 1/|L| below this is one at ω → ∞ or 0
_HALVINGS = 20
_GOLDEN = (np.sqrt(5) - 1) / 2
_SHRINKS = 16


@dataclass(frozen=True, eq=False)
class Loop:
    """One loop of n points, broken at one place, all others closed.

    Attributes:
        closed: (n, k) poles with this loop closed too [rad/s].
        opened: (n, k) poles with this loop open.
    """

    closed: NDArray[np.complex128]
    opened: NDArray[np.complex128]

    def response(self, omega: NDArray[np.float64], points: NDArray[np.intp] | slice) -> NDArray[np.complex128]:
        """L(jω), (p, …), at ω (p, …) or broadcast to it [rad/s], of the p points named."""
        s = 1j * omega
        closed, opened = self.closed[points], self.opened[points]
        shape = (len(closed), *(1,) * (omega.ndim - 1))
        product = np.ones(np.broadcast_shapes(shape, omega.shape), dtype=complex)
        for k in range(closed.shape[1]):
            product *= (s - closed[:, k].reshape(shape)) / (s - opened[:, k].reshape(shape))
        return product - 1


@dataclass(frozen=True, eq=False)
class Crossings:
    """Margins of one loop over n points, each (n,); see `LoopMargins` for what they mean."""

    gain_margin: NDArray[np.float64]
    phase_margin_deg: NDArray[np.float64]
    delay_margin_s: NDArray[np.float64]
    disk_margin: NDArray[np.float64]
    crossover_rad_s: NDArray[np.float64]
    least_gain: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Shape:
    """How one loop answers disturbances over n points, each (n,).

    Attributes:
        sensitivity_peak: largest |S| = |1/(1 + L)| over frequency.
        rejection_rad_per_s: up to where |S| ≤ −3 dB [rad/s], so that disturbances are attenuated; 0 where it never is.
        crossover_rad_per_s: highest frequency with |L| = 1 [rad/s]; 0 when there is none.
    """

    sensitivity_peak: NDArray[np.float64]
    rejection_rad_per_s: NDArray[np.float64]
    crossover_rad_per_s: NDArray[np.float64]


def broken_loops(cascade: Cascade) -> list[Loop]:
    """The eight loops of `LOOP_NAMES` of a batch of cascades."""
    closed = cascade.closed
    blocks = state_blocks(closed)
    poles = [np.linalg.eigvals(closed[:, block[:, None], block]).astype(complex) for block in blocks]
    places = [cascade.at_thrust(k) for k in range(4)] + [cascade.at_output(k) for k in range(4)]
    loops = []
    for A, b, _ in places:
        # the block that this loop acts on
        where = next(k for k, block in enumerate(blocks) if np.any(b[:, block] != 0))
        block = blocks[where]
        loops.append(Loop(poles[where], np.linalg.eigvals(A[:, block[:, None], block]).astype(complex)))
    return loops


def state_blocks(A: NDArray[np.float64]) -> list[NDArray[np.intp]]:
    """Indices of the states that touch each other in any of the points, one array a block."""
    touch = np.any((A != 0) | (A.swapaxes(-1, -2) != 0), axis=0)
    left, blocks = np.arange(len(touch)), []
    while left.size:
        block = np.zeros(len(touch), dtype=bool)
        reached = np.arange(len(touch)) == left[0]
        while np.any(reached & ~block):
            block |= reached
            reached = np.any(touch[block], axis=0)
        blocks.append(np.flatnonzero(block))
        left = np.setdiff1d(left, blocks[-1])
    return blocks


def crossings_of(loop: Loop, *, highest: float) -> Crossings:
    """Margins of one loop of n points, each stable when closed.

    As python-control's `stability_margins` and `disk_margins` define them: crossings are bracketed on a grid of
    frequencies and then halved; the disk margin's frequency is found by golden section.

    Args:
        loop: the loop.
        highest: highest frequency looked at [rad/s].
    """
    count = len(loop.closed)
    grid = np.geomspace(_LOWEST, highest, _POINTS)
    response = loop.response(grid[None], slice(None))
    gain_margin, lag, delay = (np.full(count, np.inf) for _ in range(3))
    crossover, least_gain = np.zeros(count), np.zeros(count)

    def at_phase(value: NDArray[np.complex128]) -> NDArray[np.float64]:
        return np.asarray(np.angle(-value), dtype=float)

    def at_gain(value: NDArray[np.complex128]) -> NDArray[np.float64]:
        return np.asarray(np.abs(value) - 1, dtype=float)

    left = response[:, :-1].real <= 0  # the other crossings of the real axis are no −180°
    points, omega = _zeros(loop, grid, response, at_phase, left)
    gain = 1 / np.abs(loop.response(omega, points))
    still = _still(loop)
    points, gain = np.append(points, still[0]), np.append(gain, still[1])
    more, less = (gain > 1) & (gain < 1 / _SPURIOUS), (gain < 1) & (gain > _SPURIOUS)
    np.minimum.at(gain_margin, points[more], gain[more])
    np.maximum.at(least_gain, points[less], gain[less])

    points, omega = _zeros(loop, grid, response, at_gain, np.ones_like(left))
    # a phase lead is a lag of the rest of the turn
    phase = np.remainder(np.rad2deg(np.angle(-loop.response(omega, points))), 360.0)
    np.minimum.at(lag, points, phase)
    np.minimum.at(delay, points, np.deg2rad(phase) / omega)
    np.maximum.at(crossover, points, omega)
    return Crossings(gain_margin, lag, delay, _disk(loop, grid, response), crossover, least_gain)


def shape_of(loop: Loop, *, highest: float) -> Shape:
    """Sensitivity and crossover of one loop of n points, each stable when closed; `highest` as in `crossings_of`."""
    grid = np.geomspace(_LOWEST, highest, _POINTS)
    response = loop.response(grid[None], slice(None))
    every = np.ones((len(response), _POINTS - 1), dtype=bool)

    def distance(value: NDArray[np.complex128]) -> NDArray[np.float64]:
        return np.asarray(np.abs(1 + value), dtype=float)

    points, omega = _zeros(loop, grid, response, lambda value: distance(value) - np.sqrt(2), every)
    rejection = np.full(len(response), np.inf)
    np.minimum.at(rejection, points, omega)
    rejection[distance(response[:, 0]) < np.sqrt(2)] = 0.0
    points, omega = _zeros(loop, grid, response, lambda value: np.abs(value) - 1, every)
    crossover = np.zeros(len(response))
    np.maximum.at(crossover, points, omega)
    return Shape(1 / _least(loop, grid, response, distance), rejection, crossover)


def _still(loop: Loop) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Points whose loop has the phase −180° at ω = 0, where a real pole crosses the axis, and the factor for that."""
    points = np.flatnonzero(np.all(np.abs(loop.opened) > _SPURIOUS * _LOWEST, axis=1))
    value = loop.response(np.zeros(1), points).real
    return points[value < 0], -1 / value[value < 0]


def _zeros(
    loop: Loop,
    grid: NDArray[np.float64],
    response: NDArray[np.complex128],
    value: Callable[[NDArray[np.complex128]], NDArray[np.float64]],
    selected: NDArray[np.bool_],
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Points and frequencies at which a value of the response changes sign, in the wanted intervals of the grid."""
    points, at = np.nonzero((np.diff(np.sign(value(response)), axis=1) != 0) & selected)
    low, high = np.log(grid[at]), np.log(grid[at + 1])
    first, second = value(response[points, at]), value(response[points, at + 1])
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        at_middle = value(loop.response(np.exp(middle), points))
        same = np.sign(at_middle) == np.sign(first)
        low, first = np.where(same, middle, low), np.where(same, at_middle, first)
        high, second = np.where(same, high, middle), np.where(same, second, at_middle)
    # the rest is straight: one secant step
    share = np.where(second != first, first / np.where(second != first, first - second, 1), 0.5)
    return points, np.exp(low + np.clip(share, 0, 1) * (high - low))


def _disk(loop: Loop, grid: NDArray[np.float64], response: NDArray[np.complex128]) -> NDArray[np.float64]:
    """α = min over ω of |2 (1 + L)/(1 − L)|: 1/‖S − T‖·2 of Seiler, Packard and Gahinet (2020), balanced."""

    def radius(value: NDArray[np.complex128]) -> NDArray[np.float64]:
        with np.errstate(divide="ignore"):
            return np.asarray(2 * np.abs(1 + value) / np.abs(1 - value), dtype=float)

    return _least(loop, grid, response, radius)


def _least(
    loop: Loop,
    grid: NDArray[np.float64],
    response: NDArray[np.complex128],
    radius: Callable[[NDArray[np.complex128]], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Least value of each point (n,), from the best one of the grid by golden section."""
    points, log = np.arange(len(response)), np.log(grid)
    coarse = radius(response)
    nearest = np.argmin(coarse, axis=1)
    low, high = log[np.maximum(nearest - 1, 0)], log[np.minimum(nearest + 1, len(grid) - 1)]
    least: NDArray[np.float64] = coarse[points, nearest]
    for _ in range(_SHRINKS):
        one, other = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        first, second = (radius(loop.response(np.exp(at), points)) for at in (one, other))
        least = np.minimum(least, np.minimum(first, second))
        low, high = np.where(first < second, low, one), np.where(first < second, other, high)
    return least
