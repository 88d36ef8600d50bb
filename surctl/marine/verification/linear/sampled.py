"""The control periods and the delays up to which the loop of a law about a cruise is stable."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.ir.cache import stored_numbers
from surctl.marine.verification.cruise_loop import CruiseLoop
from surctl.verification.linear import eigenvalues

__all__ = [
    "SampledLimits",
    "sampled_limits",
]

Array = NDArray[np.float64]

_SHORTEST, _LONGEST = 1e-3, 20.0  # [s]
_GROWTH = 1.06  # ratio of a tried period to the previous period
_HALVINGS = 24
_MOST = 400  # largest delay that is tried, in periods
_EDGE = 1e-9  # a pole this close to the unit circle counts as lying on the circle
_DELAYS = (0, 1, 2)


@dataclass(frozen=True)
class SampledLimits:
    """Limits of the control period and of the delay up to which the sampled loop is stable.

    Attributes:
        period_s: control period [s].
        radius: largest |z| of the poles at the control period `period_s` with one period of delay.
        largest_period_s: largest control periods [s] up to which the loop is stable, for a delay of 0, 1 and 2 periods.
            Periods are tried in steps of 6 % and refined by bisection; inf if the loop is stable up to 20 s, 0 if it is
            unstable at all periods.
        delay_periods: largest delay, in whole periods, up to which the loop is stable at the period `period_s`; −1 if
            the loop is unstable without delay.
    """

    period_s: float
    radius: float
    largest_period_s: tuple[float, float, float]
    delay_periods: int

    def to_dict(self) -> dict[str, Any]:
        """The limits as plain data for JSON."""
        return {**asdict(self), "largest_period_s": dict(zip(map(str, _DELAYS), self.largest_period_s, strict=True))}


def sampled_limits(loop: CruiseLoop) -> SampledLimits:
    """Return the sampling limits of a loop.

    If it has a leading axis with several loops, each limit is the worst over these loops, and the result is cached on
    disk: for the corners of a vehicle's ranges it takes seconds.
    """
    if loop.plant[0].ndim == 2:
        return _sampled_limits(loop)
    matrices = [np.asarray(matrix, dtype=float) for matrix in (*loop.plant, *loop.law)]
    values = stored_numbers(
        ("surctl.marine.verification.linear.sampled", "surctl.marine.verification.cruise_loop"),
        (loop.dt, loop.states, *((matrix.shape, matrix.tobytes()) for matrix in matrices)),
        lambda: asdict(_sampled_limits(loop)),
        suffix=".sampled",
    )
    return SampledLimits(**{**values, "largest_period_s": tuple(values["largest_period_s"])})


def _sampled_limits(loop: CruiseLoop) -> SampledLimits:
    period, borne = float(np.max(loop.dt)), -1
    for delay in range(_MOST + 1):
        if np.max(_radius(loop.resampled(period, delay))) >= 1 - _EDGE:
            break
        borne = delay
    one, two, three = (_largest(loop, delay) for delay in _DELAYS)
    return SampledLimits(period, float(np.max(_radius(loop.resampled(period)))), (one, two, three), borne)


def _radius(loop: CruiseLoop) -> Array:
    closed = loop.closed
    poles = np.linalg.eigvals(closed) if closed.ndim == 2 else eigenvalues(closed)
    radius: Array = np.max(np.abs(poles), axis=-1)
    return radius


def _largest(loop: CruiseLoop, delay: int) -> float:
    """Return the largest period up to which all loops are stable; bisection refines the first unstable step."""
    good, bad = 0.0, _SHORTEST
    while True:
        lost = _radius(loop.resampled(bad, delay)) >= 1 - _EDGE * bad
        if np.any(lost):
            break
        good, bad = bad, bad * _GROWTH
        if good >= _LONGEST:
            return float("inf")
    if good == 0.0:
        return 0.0
    first = loop if lost.ndim == 0 else loop[lost]
    low, high = (np.full(first.plant[0].shape[:-2], end) for end in (good, bad))
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        stable = _radius(first.resampled(middle, delay)) < 1 - _EDGE * middle
        low, high = np.where(stable, middle, low), np.where(stable, high, middle)
    return float(np.min(low))
