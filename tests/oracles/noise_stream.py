"""The noise generator of `surctl.noise` in numbers, one after another."""

from __future__ import annotations

from math import cos, log, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from surctl.noise import _M1, _M2, _NORM, noise_states


class NoiseStream:
    """The random numbers of one run, drawn one after another.

    Args:
        seed: seed of the run, 0 to 2^63 − 1.
    """

    def __init__(self, seed: int) -> None:
        first = [int(v) for v in noise_states([seed])[0]]
        self._one, self._two = first[:3], first[3:]

    def uniform(self) -> float:
        """Return the next uniform random number in (0, 1)."""
        one = (1403580 * self._one[1] - 810728 * self._one[0]) % _M1
        two = (527612 * self._two[2] - 1370589 * self._two[0]) % _M2
        self._one, self._two = [*self._one[1:], one], [*self._two[1:], two]
        return (one - two if one > two else one - two + _M1) * _NORM

    def uniforms(self, count: int) -> NDArray[np.float64]:
        """Return the next `count` uniform random numbers in (0, 1)."""
        return np.array([self.uniform() for _ in range(count)])

    def normals(self, count: int) -> NDArray[np.float64]:
        """Return the next `count` standard normal numbers; if `count` is odd, one number of the last pair is unused."""
        out: list[float] = []
        while len(out) < count:
            radius, turn = sqrt(-2.0 * log(self.uniform())), 2.0 * pi * self.uniform()
            out += [radius * cos(turn), radius * sin(turn)]
        return np.array(out[:count])
