"""Delivery of messages: periodic and late, with random losses and scheduled gaps.

Whether a message arrives depends only on the number of the control period and on a random number. Each function exists
in two versions: for the Python loop, and in CasADi symbols for the compiled loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, isfinite
from statistics import NormalDist

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError

__all__ = ["Delivery", "delayed", "delayed_symbols", "whole_steps"]

_ALWAYS = 1e300  # bound that no standard normal number reaches
_ROUNDING = 1e-9  # [1] tolerance of a number of steps


@dataclass(frozen=True, kw_only=True)
class Delivery:
    """Period, latency and losses of one kind of message to the robot.

    Attributes:
        period: time between two measurements [s] (design choice).
        latency: time from a measurement to its arrival [s] (design choice).
        loss: probability that a message is lost, independent for each message.
        gaps: intervals (start, end) [s] of the run without measurements; messages that were measured before still
            arrive.
    """

    period: float = 0.1
    latency: float = 0.1
    loss: float = 0.0
    gaps: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        """Check the values; raise an InputError that names an invalid value."""
        if not (isfinite(self.period) and self.period > 0):
            raise InputError("must be greater than 0", key="delivery.period", value=self.period, remedy="give s")
        if not (isfinite(self.latency) and self.latency >= 0):
            raise InputError("must be at least 0", key="delivery.latency", value=self.latency, remedy="give s")
        if not 0 <= self.loss <= 1:
            raise InputError("must lie between 0 and 1", key="delivery.loss", value=self.loss, remedy="give 0 to 1")
        gaps = tuple(tuple(float(end) for end in gap) for gap in self.gaps)
        for gap in gaps:
            if len(gap) != 2 or not (isfinite(gap[1]) and 0 <= gap[0] < gap[1]):
                raise InputError("is not an interval", key="delivery.gaps", value=gap, remedy="give (start, end) in s")
        object.__setattr__(self, "gaps", gaps)

    @property
    def lost_below(self) -> float:
        """Threshold of loss: a message is lost if the standard normal number drawn for it lies below this value."""
        if self.loss in (0, 1):
            return _ALWAYS if self.loss else -_ALWAYS
        return NormalDist().inv_cdf(self.loss)

    def late(self, dt: float) -> int:
        """Return the number of control periods dt [s] from measurement to arrival; InputError if not a whole number."""
        return whole_steps("delivery.latency", self.latency, dt=dt)

    def every(self, dt: float) -> int:
        """Return the number of control periods dt [s] between two measurements; InputError if not a whole number."""
        return whole_steps("delivery.period", self.period, dt=dt)

    def arrives(self, step: int, *, chance: float, dt: float) -> bool:
        """Return whether a message that was measured `late(dt)` control periods before arrives at period `step`.

        The first measurement takes place at control period 0.

        Args:
            step: number of the control period, from 0.
            chance: a standard normal number that decides the loss, drawn anew for each control period.
            dt: control period [s].

        Raises:
            InputError: if period or latency is not a multiple of dt.
        """
        measured = step - self.late(dt)
        due = measured >= 0 and measured % self.every(dt) == 0
        return due and chance >= self.lost_below and not any(a <= measured < b for a, b in self._blind(dt))

    def arrives_symbols(self, step: ca.SX, *, chance: ca.SX, dt: float) -> ca.SX:
        """Return 1 if a message arrives at control period `step`, else 0, as `arrives` does, in CasADi symbols."""
        measured, every = step - self.late(dt), self.every(dt)
        there = ca.logic_and(measured >= 0, measured - every * ca.floor(measured / every) == 0)
        there = ca.logic_and(there, chance >= self.lost_below)
        for start, end in self._blind(dt):
            there = ca.logic_and(there, ca.logic_or(measured < start, measured >= end))
        return there

    def _blind(self, dt: float) -> list[tuple[int, int]]:
        # for each gap: the first control period in the gap, and the first control period after the gap
        return [(ceil(a / dt - _ROUNDING), ceil(b / dt - _ROUNDING)) for a, b in self.gaps]


def whole_steps(key: str, time: float, *, dt: float) -> int:
    """Return a time [s] as a number of control periods of `dt` [s].

    Raises:
        InputError: if the time is not a multiple of dt; `key` is the name of the time in the error message.
    """
    count = round(time / dt)
    if abs(time / dt - count) > 1e-6:
        raise InputError(f"is not a multiple of the control period of {dt:g} s", key=key, value=time)
    return count


def delayed(ring: NDArray[np.float64], now: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the value (n,) from k steps ago, and the updated ring buffer (k, n) of the last k values.

    Args:
        ring: (k, n) ring buffer of the last k values, newest first; with k = 0 there is no delay.
        now: (n,) present value.

    Example:
        >>> import numpy as np
        >>> from surctl.marine.sensing import delayed
        >>> ring = np.array([[0.2], [0.1]])  # the last two depths, newest first
        >>> then, ring = delayed(ring, np.array([0.3]))
        >>> then.tolist(), ring.tolist()
        ([0.1], [[0.3], [0.2]])
    """
    known = np.vstack([np.reshape(now, (1, -1)), ring])
    return known[-1], known[:-1]


def delayed_symbols(ring: ca.SX, now: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the delayed value (n, 1) and the ring buffer (k, n), as `delayed` does, in CasADi symbols.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.sensing import delayed_symbols
        >>> ring, now = ca.SX.sym("ring", 2, 1), ca.SX.sym("now")
        >>> delayed_symbols(ring, now)
        (SX(ring_1), SX([now, ring_0]))
    """
    known = ca.vertcat(now.T, ring)
    return known[-1, :].T, known[:-1, :]
