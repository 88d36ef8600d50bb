"""Search for points at which a polynomial that is not negative is 0: a sum of squares is 0 at all of them."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from surctl.sos.polynomial import Polynomial

__all__ = ["zeros_of"]

_STARTS, _MOST_VARIABLES = 40, 4
_SMALL, _DENOMINATOR = 1e-7, 24
_STEPS, _CLEAR, _APART = 8, 1e-13, 1e-6  # Newton steps; relative value at, and distance between, irrational zeros


def zeros_of(
    target: Polynomial,
    box: Sequence[tuple[Fraction, Fraction]],
    sides: Sequence[Polynomial],
    *,
    scales: Sequence[Fraction],
) -> list[tuple[Fraction | float, ...]]:
    """Return the zeros, other than 0, of a polynomial in a box where all `sides` are not negative.

    A rational zero is exact; an irrational one has floats.

    Args:
        target: the polynomial.
        box: lower and upper end of each variable.
        sides: polynomials of the constraints.
        scales: unit of each variable; zeros are sought whose coordinates in these units have small denominators.
    """
    if len(box) > _MOST_VARIABLES:
        return []
    from scipy.optimize import minimize

    box = _within(box, sides)
    ends = np.array([[float(low), float(high)] for low, high in box])
    if np.any(ends[:, 0] > ends[:, 1]):
        return []
    slopes = [target.derivative(k) for k in range(len(box))]
    size = max(abs(float(c)) for c in target.terms.values())
    rng = np.random.default_rng(0)
    zeros: dict[tuple[Fraction, ...], None] = {}
    others: list[np.ndarray] = []
    for start in rng.uniform(ends[:, 0], ends[:, 1], size=(_STARTS, len(box))):
        best = minimize(
            lambda x: float(target.value(x.tolist())),
            start,
            jac=lambda x: np.array([float(s.value(x.tolist())) for s in slopes]),
            method="L-BFGS-B",
            bounds=ends,
            options={"maxiter": 60},
        )
        if best.fun > _SMALL * size:
            continue
        # the zero itself has a smaller error than the square root of the value
        point = tuple(
            Fraction(float(x * float(s))).limit_denominator(_DENOMINATOR) / s
            for x, s in zip(best.x, scales, strict=True)
        )
        inside = all(low <= x <= high for x, (low, high) in zip(point, box, strict=True))
        if any(point) and inside and target.value(point) == 0 and all(side.value(point) >= 0 for side in sides):
            zeros[point] = None
            continue
        near = _polished(best.x, slopes)
        new = all(np.abs(near - other).max() > _APART for other in others)
        inside = bool(np.all((ends[:, 0] <= near) & (near <= ends[:, 1]))) and np.abs(near).max() > _APART
        value = abs(float(target.value(near.tolist())))
        if new and inside and value <= _CLEAR * size and all(float(s.value(near.tolist())) > 0 for s in sides):
            others.append(near)
    return [*zeros, *(tuple(map(float, near)) for near in others)]


def _polished(point: np.ndarray, slopes: Sequence[Polynomial]) -> np.ndarray:
    """Return the stationary point near a point, by Newton's method."""
    bends = [[slope.derivative(k) for k in range(len(slopes))] for slope in slopes]
    for _ in range(_STEPS):
        at = point.tolist()
        slope = np.array([float(s.value(at)) for s in slopes])
        bend = np.array([[float(b.value(at)) for b in row] for row in bends])
        if not (np.all(np.isfinite(slope)) and np.all(np.isfinite(bend))):
            break
        point = point - np.linalg.lstsq(bend, slope, rcond=None)[0]
    return point


def _within(box: Sequence[tuple[Fraction, Fraction]], sides: Sequence[Polynomial]) -> list[tuple[Fraction, Fraction]]:
    """Return the box without the part where a bound of one variable, given as polynomial, is negative."""
    ends = [list(pair) for pair in box]
    for side in sides:
        among = {k for m in side.terms for k, _ in m}
        if side.degree != 1 or len(among) != 1:
            continue
        (k,) = among
        slope, offset = Fraction(side.terms[((k, 1),)]), Fraction(side.terms.get((), 0))
        if slope > 0:
            ends[k][0] = max(ends[k][0], -offset / slope)
        else:
            ends[k][1] = min(ends[k][1], -offset / slope)
    return [(low, high) for low, high in ends]
