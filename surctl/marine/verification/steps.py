"""Step responses of many cascades at once: settling time and overshoot as defined by python-control's `step_info`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.marine.verification.cascade import Cascade
from surctl.system.exponential import expm
from surctl.verification.loops import state_blocks

__all__ = ["STEP_NAMES", "step_figures", "step_system"]

STEP_NAMES = ("cross_track", "heading", "surge_speed")
_BAND = 0.02  # half-width of the settling band, as a share of the final value
_DECAYS = 10.0  # duration of the response, in time constants of the slowest pole
_LEVELS, _RATIO, _SAMPLES = 4, 8, 512  # number of time grids, each `_RATIO` times longer than the one before; samples


def step_system(cascade: Cascade, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the systems (A, b, c) from a reference to the controlled variable; a leading axis holds the cascades.

    `cross_track`: the path is displaced to one side by a step; all loops are closed. `heading`: the desired heading
    changes by a step, and the path does not change; all loops are closed. `surge_speed`: the desired surge speed
    changes by a step; the along-track loop is open, and the response is correct up to a constant factor.
    """
    B, K = cascade.B, cascade.K
    if name == "cross_track":
        return cascade.closed, B @ K[..., [1]], cascade.C[..., [1], :]
    if name == "heading":
        drive = np.zeros_like(K[..., [3]])
        drive[..., 3::4, :] = K[..., 3::4, [3]]  # only rows of yaw: in sway, ψ enters by the rotation of ν_c into {B}
        return cascade.closed, B @ drive, cascade.C[..., [3], :]
    opened, b, _ = cascade.at_output(0)
    # k1 x takes the place of the desired speed, up to a factor that does not change the metrics; x is then unused
    return opened[..., 1:, 1:], b[..., 1:, :], cascade.C[..., [4], 1:]


def step_figures(
    cascade: Cascade, stable: NDArray[np.bool_]
) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Return settling time [s] and overshoot of n cascades for each step response; inf if unstable.

    The overshoot is a share of the step.
    """
    figures = {}
    for name in STEP_NAMES:
        settling, overshoot = (np.full(len(stable), np.inf) for _ in range(2))
        if stable.any():
            A, b, c = (m[stable] for m in step_system(cascade, name))
            block = next(s for s in state_blocks(A) if np.any(b[:, s] != 0))
            A, b, c = A[:, block[:, None], block], b[:, block], c[:, :, block]
            settling[stable], overshoot[stable] = _figures(A, b, c)
        figures[name] = (settling, overshoot)
    return figures


def _figures(
    A: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return settling time and overshoot of stable systems A (n, k, k), b (n, k, 1), c (n, 1, k), by exact sampling.

    The response is 1 − d(t) with the remaining error d(t) = c e^(At) x_∞/(c x_∞) and the final state x_∞ = −A⁻¹ b. The
    response is sampled on four time grids, each eight times longer than the previous grid; together they resolve both
    an early peak and a late end. Between samples the response is interpolated.
    """
    rest = -np.linalg.solve(A, b)
    final = (c @ rest)[:, :, 0]
    slowest = np.min(-np.linalg.eigvals(A).real, axis=1)
    step = _DECAYS / slowest / (_SAMPLES * _RATIO ** (_LEVELS - 1))
    power = expm(A * step[:, None, None])
    settling, peak, overshoot = np.zeros(len(A)), np.zeros(len(A)), np.zeros(len(A))
    for level in range(_LEVELS):
        rows, power = _sampled(power, c)
        d = (rows @ rest)[:, :, 0] / final
        later = _last_outside(d)
        # where a finer grid covers the time, the more exact result of the finer grid is kept
        newer = later >= (_SAMPLES // _RATIO if level else 0)
        settling = np.where(newer, later * step, settling)
        highest, refined = _peak(-d)
        higher = highest > peak + 1e-12
        peak, overshoot = np.where(higher, highest, peak), np.where(higher, refined, overshoot)
        step = step * _RATIO
    return settling, overshoot


def _sampled(power: NDArray[np.float64], c: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return c Φ^j (n, `_SAMPLES` + 1, k) for j = 0 … `_SAMPLES`, and the matrix Φ^`_RATIO`; Φ is `power`."""
    rows, following = c, power
    while rows.shape[1] < _SAMPLES:
        rows = np.concatenate([rows, rows @ power], axis=1)
        power = power @ power
        if rows.shape[1] == _RATIO:
            following = power
    return np.concatenate([rows, c @ power], axis=1), following


def _last_outside(d: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sample after which d (n, m) stays within the settling band; 0 if d never leaves this band."""
    outside = np.abs(d) >= _BAND
    last = d.shape[1] - 1 - np.argmax(outside[:, ::-1], axis=1)
    here = np.minimum(last, d.shape[1] - 2)
    point = np.arange(len(d))
    before, after = np.abs(d[point, here]), np.abs(d[point, here + 1])
    share = np.where(before > after, (before - _BAND) / np.where(before > after, before - after, 1), 1.0)
    return np.where(outside.any(axis=1), here + np.clip(share, 0, 1), 0.0)


def _peak(y: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the largest sample of y (n, m), at least 0, and the peak of the parabola through its neighbourhood."""
    at = np.clip(np.argmax(y, axis=1), 1, y.shape[1] - 2)
    point = np.arange(len(y))
    left, middle, right = y[point, at - 1], y[point, at], y[point, at + 1]
    bend = left - 2 * middle + right
    top = middle - np.where(bend < 0, (left - right) ** 2 / (8 * np.where(bend < 0, bend, -1)), 0)
    highest = np.maximum(y.max(axis=1), 0)
    return highest, np.maximum(np.where(middle >= np.maximum(left, right), top, highest), 0)
