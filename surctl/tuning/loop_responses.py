"""Frequency responses (dense near resonances and notches) and step responses of a sampled loop as arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from surctl.system import LinearLoop
from surctl.system.linear_loop import held_plant
from surctl.verification.linear import balanced

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Matrices = tuple[Array, Array, Array, Array]

REMAINDER = 1e-4
"""Share of the slowest mode that is left at the end of a step response."""

_POINTS, _DENSE = 160, 27  # least number of frequencies, and number in each decade
_NEAR = np.geomspace(1e-2, 3.0, 7)  # distances from a pole's frequency, in distances of the pole from the unit circle
_DECADES = 2.0  # below the slowest pole
_LEAST, _DOUBLE = 1e-9, 1e-7  # poles nearer to z = 1 count as at 1; several open-loop integrators spread that far
_ZOOMS, _ZOOM = 4, 16  # refinements of the frequencies next to a peak, and frequencies of each
_SHORTEST, _LONGEST = 60, 1 << 14  # samples of a step response


def rates(loop: LinearLoop) -> Complex:
    """Return the poles s = log(z)/dt [rad/s] of the closed loop, without poles at z = 0, which are delays."""
    poles = loop.poles()
    return np.asarray(np.log(poles[np.abs(poles) > 1e-9]) / loop.dt, dtype=np.complex128)


def frequencies(loop: LinearLoop, openings: Sequence[str] = (), *, zeros: bool = False) -> Array:
    """Return frequencies [rad/s] up to the Nyquist frequency, ascending and dense near lightly damped poles.

    They begin two decades below the slowest pole.

    Args:
        loop: the loop.
        openings: signals at which the loop is opened; the frequencies are dense near its open-loop poles too.
        zeros: also near the zeros of the opened loop, where the loop gain has its notches.
    """
    highest, closed = np.pi / loop.dt, loop.poles()
    opened = np.linalg.eigvals(loop.opened(*openings)[0]).astype(complex) if openings else closed[:0]
    slow = [_sizes(closed, _LEAST), _sizes(opened, _DOUBLE)]
    slowest = float(np.min(np.concatenate(slow), initial=np.pi / 10)) / loop.dt
    lowest = slowest / 10**_DECADES
    places = [closed, opened, *([_zeros(loop.opened(*openings))] if zeros else [])]
    special = np.concatenate(places)
    special = special[np.abs(special) > 1e-9]
    width = np.maximum(np.abs(1 - np.abs(special)), 1e-6 * np.abs(np.log(special))) / loop.dt
    centre = np.abs(np.angle(special)) / loop.dt
    near = centre[:, None] + width[:, None] * np.concatenate([-_NEAR, [0.0], _NEAR])
    points = max(_POINTS, int(_DENSE * np.log10(highest / lowest)))
    omega = np.concatenate([np.geomspace(lowest, highest * (1 - 1e-9), points), near.ravel()])
    return np.unique(omega[(omega >= lowest) & (omega < highest)])


def _sizes(poles: Complex, least: float) -> Array:
    # |s| dt of the poles, without delays and integrators
    sizes = np.abs(np.log(poles[np.abs(poles) > 1e-9]))
    return np.asarray(sizes[sizes > least], dtype=float)


def _zeros(matrices: Matrices) -> Complex:
    # transmission zeros z of a square system
    from scipy.linalg import eigvals  # takes a second to import

    A, B, C, D = matrices
    selected = np.zeros((len(A) + len(D), len(A) + len(D)))
    selected[: len(A), : len(A)] = np.eye(len(A))
    with np.errstate(divide="ignore", invalid="ignore"):
        zeros = np.asarray(eigvals(np.block([[A, B], [C, D]]), selected), dtype=np.complex128)
    return zeros[np.isfinite(zeros) & (np.abs(zeros) < 1e6)]


def response(matrices: Matrices, omega: Array, dt: float) -> Complex:
    """Return the frequency response (k, outputs, inputs) of discrete-time matrices (A, B, C, D) at ω (k,) [rad/s]."""
    A, B, C, D = matrices
    pencils = np.exp(1j * omega * dt)[:, None, None] * np.eye(len(A)) - A
    inner = np.linalg.solve(pencils, np.broadcast_to(B, (len(omega), *B.shape)).astype(complex))
    return np.asarray(C @ inner + D, dtype=np.complex128)


def loop_gains(loop: LinearLoop, openings: Sequence[str], omega: Array) -> Array:
    """Return the least and the largest singular value (2, k) of L(e^{jωdt}), opened at several signals, `balanced`."""
    values = np.linalg.svd(balanced(response(loop.opened(*openings), omega, loop.dt)), compute_uv=False)
    return np.stack([values[:, -1], values[:, 0]])


def sensitivities_at(loop: LinearLoop, openings: Sequence[str], omega: Array) -> Array:
    """Return the largest singular values (2, k) of S = (I + L)⁻¹ and T = I - S, opened at several, `balanced`."""
    L = response(loop.opened(*openings), omega, loop.dt)
    eye = np.eye(L.shape[-1])
    S = np.asarray(np.linalg.solve(eye + L, np.broadcast_to(eye, L.shape)), dtype=np.complex128)
    return np.stack([np.linalg.norm(balanced(one), 2, axis=(1, 2)) for one in (S, eye - S)])


def sensitivity_curves(loop: LinearLoop, openings: Sequence[str]) -> tuple[Array, Array, Array]:
    """Return frequencies (k,) [rad/s], and S and T (k,) of `sensitivities_at`, with their peaks to ten digits."""
    omega = frequencies(loop, openings)
    curves = sensitivities_at(loop, openings, omega)
    for _ in range(_ZOOMS):
        places = curves.argmax(axis=1)
        ends = zip(omega[np.maximum(places - 1, 0)], omega[np.minimum(places + 1, len(omega) - 1)], strict=True)
        more = np.concatenate([np.geomspace(*both, _ZOOM)[1:-1] for both in ends])
        omega, order = np.unique(np.concatenate([omega, more]), return_index=True)
        curves = np.hstack([curves, sensitivities_at(loop, openings, more)])[:, order]
    return omega, curves[0], curves[1]


def step_series(loop: LinearLoop, source: str, end: str, *, least_s: float = 0.0) -> tuple[Array, Array, float]:
    """Return times (n,) [s], the response (n,) to a unit step, and the value at which it comes to rest.

    The response ends when the slowest mode of the loop has decayed to 1e-4 of its size, and not before `least_s` [s].
    Up to 16,384 control periods, it has one sample for each of them.
    """
    A, B, C, D = loop.transferred([source], [end])
    size = float(np.abs(loop.poles()).max(initial=0.0))
    needed = max(np.log(REMAINDER) / np.log(size) if 0 < size < 1 else 0, least_s / loop.dt)
    stride = max(1, int(np.ceil(needed / _LONGEST)))
    count = int(np.clip(np.ceil(needed / stride), _SHORTEST, _LONGEST)) + 1
    final = float((D + C @ np.linalg.solve(np.eye(len(A)) - A, B))[0, 0])
    return np.arange(float(count)) * stride * loop.dt, _held_steps((A, B, C, D), stride, count), final


def held_step(model: Matrices, time: Array) -> Array:
    """Return the response (n,) of a continuous-time model (A, B, C, D) to a unit step at evenly spaced times."""
    A, B, C, D = model
    Ad, Bd, _ = held_plant(A, B, np.zeros((len(A), 0)), float(time[1] - time[0]))
    return _held_steps((Ad, Bd, C, D), 1, len(time))


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
