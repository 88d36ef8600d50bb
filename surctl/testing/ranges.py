"""The symbols of an expression and the ranges from which a check takes their values; a failed check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, SurctlError


class CheckFailed(SurctlError, AssertionError):
    """Raised when a check fails; the message states the object (task, law), the error and the point.

    The class is also an AssertionError, so that test runners count it as a failed test.

    Args:
        what: the object that was checked, for example "task depth" or "law hover".
        problem: how the object fails the check, without a full stop.
        at: the values at which the object fails the check; "" if it fails at all values.
    """

    def __init__(self, what: str, problem: str, *, at: str = "") -> None:
        self.what, self.problem, self.at = what, problem, at
        super().__init__(" ".join(f"{what}: {problem}{f', at {at}' if at else ''}".split()))


Array: TypeAlias = NDArray[np.float64]

Parameter: TypeAlias = tuple[ca.SX, float | Sequence[float], float | Sequence[float]]
"""(symbol (k, 1), lowest, highest); each range end is one number for all entries, or (k,)."""


@dataclass(frozen=True, eq=False)
class SymbolRanges:
    """Symbols and their ranges; low, high (total,) are the lowest and highest values of all entries of the symbols."""

    symbols: tuple[ca.SX, ...]
    low: Array
    high: Array

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Return (count, total) uniform random values within the ranges."""
        return rng.uniform(self.low, self.high, (count, self.low.size))

    def split(self, values: Array) -> list[Array]:
        """Split the flat values (total,) into one array for each symbol."""
        return np.split(values, np.cumsum([s.numel() for s in self.symbols])[:-1]) if self.symbols else []

    def text(self, values: Array) -> str:
        """Return the values as text, for example "eta = [...], echo = [...]"."""
        names = [_name(symbol) for symbol in self.symbols]
        return ", ".join(
            f"{name} = {np.array2string(part, precision=5, separator=', ', max_line_width=10_000)}"
            for name, part in zip(names, self.split(values), strict=True)
        )


class SampledExpressions:
    """Expressions compiled to one numeric function of the values of all symbols, stored in one array."""

    def __init__(self, what: str, ranges: SymbolRanges, expressions: Sequence[ca.SX]) -> None:
        known = ca.vertcat(ca.SX(0, 1), *ranges.symbols)
        for symbol in ca.symvar(ca.veccat(*expressions)):
            if not (known.numel() and ca.depends_on(known, symbol)):
                remedy = "give (symbol, lowest, highest) in parameters"
                raise InputError(f"contains the symbol {symbol.name()}, which has no range", key=what, remedy=remedy)
        self._function = ca.Function("sampled", [known], [ca.densify(e) for e in expressions])

    def __call__(self, values: Array) -> list[Array]:
        """Return the value of each expression, in the shape of the expression."""
        return [part[0] for part in self.many(values[None, :])]

    def many(self, points: Array) -> list[Array]:
        """Return the values at the points (N, total): one array (N, rows, columns) for each expression."""
        results = self._function.map(len(points)).call([ca.DM(np.ascontiguousarray(points.T))])
        return [
            np.array(part, dtype=float).reshape(part.shape[0], len(points), -1).transpose(1, 0, 2) for part in results
        ]


def ranges_of(parameters: Sequence[Parameter]) -> SymbolRanges:
    """Return the parameters; an InputError names a parameter that is not a symbol or has an empty range."""
    low: list[Array] = []
    high: list[Array] = []
    for parameter in parameters:
        if not isinstance(parameter, tuple | list) or len(parameter) != 3:
            raise InputError("is not (symbol, lowest, highest)", key="parameters", value=parameter)
        symbol, lowest, highest = parameter
        if not isinstance(symbol, ca.SX) or symbol.shape[1] != 1 or not symbol.is_valid_input():
            raise InputError("is not an SX symbol of shape (k, 1)", key="parameters", value=symbol)
        for value, ends in ((lowest, low), (highest, high)):
            ends.append(_spread(_name(symbol), value, symbol.numel()))
        if not (low[-1] <= high[-1]).all():
            raise InputError("has no value in its range", key=f"parameter {_name(symbol)}", value=[lowest, highest])
    visited: set[int] = set()
    for symbol, _, _ in parameters:
        hashes = {symbol[i].element_hash() for i in range(symbol.numel())}
        if hashes & visited:
            raise InputError("has two ranges", key=f"parameter {_name(symbol)}", remedy="leave one of them out")
        visited |= hashes
    flat = [np.concatenate([*ends, np.zeros(0)]) for ends in (low, high)]
    return SymbolRanges(tuple(symbol for symbol, _, _ in parameters), *flat)


def checked_count(key: str, value: object, *, least: int = 1) -> None:
    """Raise an InputError unless the value is a whole number of at least `least`, since an empty check would pass."""
    if not isinstance(value, int | np.integer) or value < least:
        raise InputError("is too small", key=key, value=value, remedy=f"give {least} or more")


def checked_type(value: object, kind: type, *, key: str) -> None:
    """Raise an InputError unless the value is an instance of a class; a function in its place is to be called."""
    if not isinstance(value, kind):
        remedy = "give what the function returns" if callable(value) else f"give a surctl {kind.__name__}"
        raise InputError(f"got {type(value).__name__}, not {kind.__name__}", key=key, remedy=remedy)


def _spread(name: str, value: float | Sequence[float], size: int) -> Array:
    try:
        values = np.asarray(value, dtype=float).reshape(-1)
    except (TypeError, ValueError):
        raise InputError("has a range that is not numeric", key=f"parameter {name}", value=value) from None
    if values.size not in (1, size) or not np.isfinite(values).all():
        raise InputError(f"needs finite ranges of 1 or {size} entries", key=f"parameter {name}", value=value)
    return np.broadcast_to(values, size).astype(float)


def _name(symbol: ca.SX) -> str:
    # CasADi names the entries of a vector x_0, x_1, …
    first = symbol[0].name()
    return str(first if symbol.numel() == 1 else first.rsplit("_", 1)[0])
