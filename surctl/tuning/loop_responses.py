"""Frequency and step responses of a sampled loop as arrays, for goals and pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from surctl.system import LinearLoop

__all__ = ["frequencies", "held_step", "loop_gains", "rates", "response", "sensitivities_at", "stable", "step_series"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Matrices = tuple[Array, Array, Array, Array]

_EDGE = 1e-9  # a pole this near to the unit circle counts as on it
_POINTS = 160
_NEAR = np.geomspace(1e-2, 3.0, 7)  # distances from a pole's frequency, in distances of the pole from the unit circle
_DECADES = 2.0  # below the slowest pole
_LOWEST, _RANGE = 1e-5, 1e6  # [rad/s]; largest ratio of two frequencies
_REMAINDER = 1e-4  # share of the slowest mode that is left at the end of a step response
_SHORTEST, _LONGEST = 60, 1 << 14  # samples of a step response


def stable(loop: LinearLoop) -> bool:
    """Return whether every pole of the closed loop lies inside the unit circle."""
    return bool(np.abs(loop.poles()).max(initial=0.0) < 1 - _EDGE)


def rates(loop: LinearLoop) -> Complex:
    """Return the poles s = log(z)/dt [rad/s] of the closed loop, without poles at z = 0, which are delays."""
    poles = loop.poles()
    return np.asarray(np.log(poles[np.abs(poles) > 1e-9]) / loop.dt, dtype=np.complex128)


def frequencies(loop: LinearLoop, openings: Sequence[str] = (), *, points: int = _POINTS) -> Array:
    """Return frequencies [rad/s] up to the Nyquist frequency, ascending and dense near lightly damped poles."""
    highest = np.pi / loop.dt
    poles = loop.poles()
    if openings:
        poles = np.concatenate([poles, np.linalg.eigvals(loop.opened(*openings)[0]).astype(complex)])
    poles = poles[np.abs(poles) > 1e-9]
    sizes = np.abs(np.log(poles)) / loop.dt
    slowest = float(np.min(sizes[sizes > _LOWEST], initial=highest / 10))
    lowest = max(slowest / 10**_DECADES, highest / _RANGE, _LOWEST)
    width = np.maximum(np.abs(1 - np.abs(poles)), 1e-6) / loop.dt
    centre = np.abs(np.angle(poles)) / loop.dt
    near = centre[:, None] + width[:, None] * np.concatenate([-_NEAR, [0.0], _NEAR])
    omega = np.concatenate([np.geomspace(lowest, highest * (1 - 1e-9), points), near.ravel()])
    return np.unique(omega[(omega >= lowest) & (omega < highest)])


def response(matrices: Matrices, omega: Array, dt: float) -> Complex:
    """Return the frequency response (k, outputs, inputs) of discrete-time matrices (A, B, C, D) at ω (k,) [rad/s]."""
    A, B, C, D = matrices
    pencils = np.exp(1j * omega * dt)[:, None, None] * np.eye(len(A)) - A
    inner = np.linalg.solve(pencils, np.broadcast_to(B, (len(omega), *B.shape)).astype(complex))
    return np.asarray(C @ inner + D, dtype=np.complex128)


def loop_gains(loop: LinearLoop, openings: Sequence[str], omega: Array) -> Array:
    """Return the least and the largest singular value (2, k) of L(e^{jωdt}), opened at several signals at once."""
    values = np.linalg.svd(response(loop.opened(*openings), omega, loop.dt), compute_uv=False)
    return np.stack([values[:, -1], values[:, 0]])


def sensitivities_at(loop: LinearLoop, openings: Sequence[str], omega: Array) -> Array:
    """Return the largest singular values (2, k) of S = (I + L)⁻¹ and T = I - S, opened at several signals."""
    L = response(loop.opened(*openings), omega, loop.dt)
    eye = np.eye(L.shape[-1])
    S = np.linalg.solve(eye + L, np.broadcast_to(eye, L.shape).astype(complex))
    return np.stack([np.linalg.norm(one, 2, axis=(1, 2)) for one in (S, eye - S)])


def step_series(loop: LinearLoop, source: str, end: str) -> tuple[Array, Array, float]:
    """Return times (n,) [s], the response (n,) to a unit step, and the value at which it comes to rest.

    The response ends when the slowest mode of the loop has decayed to 1e-4 of its size. Up to 16,384 control periods,
    it has one sample for each of them.
    """
    A, B, C, D = loop.transferred([source], [end])
    size = float(np.abs(loop.poles()).max(initial=0.0))
    needed = np.log(_REMAINDER) / np.log(size) if 0 < size < 1 else 0
    stride = max(1, int(np.ceil(needed / _LONGEST)))
    count = int(np.clip(np.ceil(needed / stride), _SHORTEST, _LONGEST)) + 1
    final = float((D + C @ np.linalg.solve(np.eye(len(A)) - A, B))[0, 0])
    return np.arange(float(count)) * stride * loop.dt, _held_steps((A, B, C, D), stride, count), final


def held_step(model: Matrices, time: Array) -> Array:
    """Return the response (n,) of a continuous-time model (A, B, C, D) to a unit step at evenly spaced times."""
    from scipy.linalg import expm  # takes a second to import

    A, B, C, D = model
    n = len(A)
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[:n, n:] = A, B
    discrete = expm(whole * float(time[1] - time[0]))
    return _held_steps((discrete[:n, :n], discrete[:n, n:], C, D), 1, len(time))


def _held_steps(matrices: Matrices, stride: int, count: int) -> Array:
    # [C D] M^(stride·k) [0 1]ᵀ, with M = [A B; 0 1], for all k by doubling
    A, B, C, D = matrices
    n = len(A)
    whole = np.eye(n + 1)
    whole[:n, :n], whole[:n, n:] = A, B
    power = np.linalg.matrix_power(whole, stride)
    rows = np.hstack([C, D])
    while len(rows) < count:
        rows = np.vstack([rows, rows @ power])
        power = power @ power
    return np.asarray(rows[:count, n], dtype=float)
