"""Numbers with derivatives, with which a procedure is executed to differentiate it (forward mode)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["Dual"]

_Slope: TypeAlias = NDArray[np.float64]


def _parts(number: Dual | float) -> tuple[float, _Slope | float]:
    return (number.value, number.slope) if isinstance(number, Dual) else (float(number), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Dual:
    """A real with its derivatives (d,); comparisons are those of the values, so branches have no derivative."""

    value: float
    slope: _Slope

    def __add__(self, other: Dual | float) -> Dual:
        value, slope = _parts(other)
        return Dual(self.value + value, self.slope + slope)

    def __sub__(self, other: Dual | float) -> Dual:
        value, slope = _parts(other)
        return Dual(self.value - value, self.slope - slope)

    def __rsub__(self, other: float) -> Dual:
        return Dual(other - self.value, -self.slope)

    def __mul__(self, other: Dual | float) -> Dual:
        value, slope = _parts(other)
        return Dual(self.value * value, self.slope * value + self.value * slope)

    __radd__, __rmul__ = __add__, __mul__

    def __truediv__(self, other: Dual | float) -> Dual:
        value, slope = _parts(other)
        ratio = float(np.float64(self.value) / np.float64(value))
        return Dual(ratio, (self.slope - ratio * slope) / np.float64(value))

    def __rtruediv__(self, other: float) -> Dual:
        return Dual(other, 0.0 * self.slope) / self

    def __neg__(self) -> Dual:
        return Dual(-self.value, -self.slope)

    def __abs__(self) -> Dual:
        return -self if self.value < 0.0 else self

    def __lt__(self, other: Dual | float) -> bool:
        return self.value < _parts(other)[0]

    def __le__(self, other: Dual | float) -> bool:
        return self.value <= _parts(other)[0]

    def __gt__(self, other: Dual | float) -> bool:
        return self.value > _parts(other)[0]

    def __ge__(self, other: Dual | float) -> bool:
        return self.value >= _parts(other)[0]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Dual | float | int) and self.value == _parts(other)[0]

    __hash__: Any = None

    def root(self) -> Dual:
        """Return the square root."""
        root = math.sqrt(self.value) if self.value >= 0.0 else math.nan
        return Dual(root, 0.5 * self.slope / np.float64(root))
