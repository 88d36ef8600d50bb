"""When messages arrive: at a period, late, some lost by chance, none during a scheduled gap.

Pure functions of the number of the control period, for the loop in Python and, in symbols, for the compiled one.
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

_ALWAYS = 1e300  # bound of a standard normal number that none reaches
_ROUNDING = 1e-9  # [1] of a count of steps


@dataclass(frozen=True, kw_only=True)
class Delivery:
    """How messages of one kind reach the robot.

    Attributes:
        period: between two measurements [s] (*chosen*).
        latency: from the measurement to the arrival [s] (*chosen*).
        loss: chance that a message never arrives, each by itself.
        gaps: (start, end) [s] of the run in which nothing is measured; what is under way then still arrives.
    """

    period: float = 0.1
    latency: float = 0.1
    loss: float = 0.0
    gaps: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        """Check the values; InputError names the wrong one."""
        if not (isfinite(self.period) and self.period > 0):
            raise InputError("must be greater than 0", key="delivery.period", value=self.period, remedy="give s")
        if not (isfinite(self.latency) and self.latency >= 0):
            raise InputError("must be at least 0", key="delivery.latency", value=self.latency, remedy="give s")
        if not 0 <= self.loss <= 1:
            raise InputError("must lie between 0 and 1", key="delivery.loss", value=self.loss, remedy="give a chance")
        gaps = tuple(tuple(float(end) for end in gap) for gap in self.gaps)
        for gap in gaps:
            if len(gap) != 2 or not (isfinite(gap[1]) and 0 <= gap[0] < gap[1]):
                raise InputError("is no interval", key="delivery.gaps", value=gap, remedy="give (start, end) in s")
        object.__setattr__(self, "gaps", gaps)

    @property
    def lost_below(self) -> float:
        """A message is lost when its standard normal number lies below this."""
        if self.loss in (0, 1):
            return _ALWAYS if self.loss else -_ALWAYS
        return NormalDist().inv_cdf(self.loss)

    def late(self, dt: float) -> int:
        """Control periods of `dt` [s] between measurement and arrival; InputError when they are not whole."""
        return whole_steps("delivery.latency", self.latency, dt=dt)

    def every(self, dt: float) -> int:
        """Control periods of `dt` [s] between two measurements; InputError when they are not whole."""
        return whole_steps("delivery.period", self.period, dt=dt)

    def arrives(self, step: int, *, chance: float, dt: float) -> bool:
        """Whether a message arrives at this control period; it describes the world `late(dt)` periods before.

        The first measurement is that of period 0.

        Args:
            step: number of the control period, from 0.
            chance: a standard normal number, drawn anew for each period.
            dt: control period [s].

        Raises:
            InputError: period or latency is no multiple of dt.
        """
        measured = step - self.late(dt)
        due = measured >= 0 and measured % self.every(dt) == 0
        return due and chance >= self.lost_below and not any(a <= measured < b for a, b in self._blind(dt))

    def arrives_symbols(self, step: ca.SX, *, chance: ca.SX, dt: float) -> ca.SX:
        """`arrives` in symbols, 0 or 1; `step` a whole number."""
        measured, every = step - self.late(dt), self.every(dt)
        there = ca.logic_and(measured >= 0, measured - every * ca.floor(measured / every) == 0)
        there = ca.logic_and(there, chance >= self.lost_below)
        for start, end in self._blind(dt):
            there = ca.logic_and(there, ca.logic_or(measured < start, measured >= end))
        return there

    def _blind(self, dt: float) -> list[tuple[int, int]]:
        """The gaps in control periods: from the first to before the last."""
        return [(ceil(a / dt - _ROUNDING), ceil(b / dt - _ROUNDING)) for a, b in self.gaps]


def whole_steps(key: str, time: float, *, dt: float) -> int:
    """A time [s] in control periods of `dt` [s].

    Raises:
        InputError: it is not a multiple of dt; `key` names it.
    """
    count = round(time / dt)
    if abs(time / dt - count) > 1e-6:
        raise InputError(f"is not a multiple of the control period of {dt:g} s", key=key, value=time)
    return count


def delayed(ring: NDArray[np.float64], now: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What was so many steps ago, (n,), and the ring one step on, (k, n).

    Args:
        ring: (k, n) the last k values, newest first; k is the number of steps, 0 for none.
        now: (n,) this step's.

    Example:
        >>> import numpy as np
        >>> from surctl.sensing import delayed
        >>> ring = np.array([[0.2], [0.1]])  # the last two depths, newest first
        >>> then, ring = delayed(ring, np.array([0.3]))
        >>> then.tolist(), ring.tolist()
        ([0.1], [[0.3], [0.2]])
    """
    known = np.vstack([np.reshape(now, (1, -1)), ring])
    return known[-1], known[:-1]


def delayed_symbols(ring: ca.SX, now: ca.SX) -> tuple[ca.SX, ca.SX]:
    """`delayed` in symbols: (n, 1) and (k, n).

    Example:
        >>> import casadi as ca
        >>> from surctl.sensing import delayed_symbols
        >>> ring, now = ca.SX.sym("ring", 2, 1), ca.SX.sym("now")
        >>> delayed_symbols(ring, now)
        (SX(ring_1), SX([now, ring_0]))
    """
    known = ca.vertcat(now.T, ring)
    return known[-1, :].T, known[:-1, :]
