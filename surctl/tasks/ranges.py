"""The symbols of expressions with the ranges from which a check or a diagnosis takes their values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError

Array: TypeAlias = NDArray[np.float64]

Parameter: TypeAlias = tuple[ca.SX, ArrayLike, ArrayLike]
"""(symbol (k, 1), lowest, highest); each range end is one number for all entries, or (k,)."""


@dataclass(frozen=True, eq=False)
class SymbolRanges:
    """Symbols and their ranges; low, high (total,) are the lowest and highest values of all entries of the symbols."""

    symbols: tuple[ca.SX, ...]
    low: Array
    high: Array

    @property
    def vector(self) -> ca.SX:
        """Return the symbols as one column (total, 1)."""
        return ca.vertcat(ca.SX(0, 1), *self.symbols)

    def check(self, what: str, expressions: Sequence[ca.SX]) -> None:
        """Raise InputError if an expression of `what` contains another symbol."""
        for symbol in ca.symvar(ca.veccat(*expressions)):
            if not (self.low.size and ca.depends_on(self.vector, symbol)):
                remedy = "give (symbol, lowest, highest) in parameters"
                raise InputError(f"contains the symbol {symbol.name()}, which has no range", key=what, remedy=remedy)

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
        ranges.check(what, expressions)
        self._function = ca.Function("sampled", [ranges.vector], [ca.densify(e) for e in expressions])

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


def _spread(name: str, value: ArrayLike, size: int) -> Array:
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
