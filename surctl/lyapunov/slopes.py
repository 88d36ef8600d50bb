"""Dynamics as x' = A(θ)(x − x*) on {V ≤ level}, with a matrix that has degree at most 1 in each slope θ.

The slopes are those of `surctl.certcheck.slope_rows`, with sampled ranges of functions: they only serve to propose V
and level, and the checker encloses the ranges itself. With feedbacks, the output of each limit lies between its operand
and a variable of its own, beside ξ: the value G·ξ of its feedback.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from itertools import product

import numpy as np
from mpmath import libmp
from numpy.typing import NDArray

from surctl.certcheck import Rejected
from surctl.certcheck.enclosure import Interval, Undefined, span
from surctl.certcheck.slope_rows import Number, Rows
from surctl.errors import UnsupportedOperation
from surctl.lyapunov.dynamics import Dynamics
from surctl.verification.formula import Node, text_of, values_of, variable

__all__ = ["Embedding"]

Array = NDArray[np.float64]

_POINTS = 65  # samples of a range
_FEW = 6  # slopes of a row whose vertices are tried
_WIDER = 1e-3  # by which sampled ranges are widened, relative to their width


class Embedding(Rows):
    """The slopes of dynamics where |c·ξ|² ≤ c Q c', ξ = x − x*, for all rows c and one of the covers Q.

    The entries of `rows` after those of the n states are those of the values of the k feedbacks.

    Attributes:
        covers: Q of the states and of the values of the feedbacks (K, n + k, n + k).
        inner: rows (M, n + k) of each expression whose range decides a slope, at vertices of the slopes.

    Args:
        dynamics: the dynamics.
        covers: the covers (K, n, n).
        rates: expressions in place of the rates of the dynamics.
        feedbacks: G (k, n) of the limits; more rows than there are limits have no effect.

    Raises:
        UnsupportedOperation: the slope rule does not cover the expressions.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        covers: Array,
        *,
        rates: Sequence[Node] | None = None,
        feedbacks: Array | None = None,
    ) -> None:
        d, n = dynamics, len(dynamics.names)
        gains = np.zeros((0, n)) if feedbacks is None else feedbacks
        wide = np.vstack([np.eye(n), gains])
        self.covers, self.inner = np.asarray(wide @ covers @ wide.T), list[Array]()
        values = [f"feedback {k}" for k in range(len(gains))]  # no expression has a variable with such a name
        try:
            super().__init__(
                [*(v.name for v in d.variables), *values],
                [*(span(v.lower, v.upper) for v in d.variables), *[span(0.0, 0.0)] * len(values)],
                [text_of(rate) for rate in (d.rates if rates is None else rates)],
                [[[Fraction(x) for x in row] for row in cover.tolist()] for cover in covers],
                [s.rest for s in d.states],
                Fraction(1),
                values,
                gains.tolist(),
            )
        except (Rejected, Undefined) as reason:
            raise UnsupportedOperation(str(reason), key="slopes") from None

    def ends(self, k: int) -> tuple[float, float]:
        """Return the range of a rate on the region."""
        whole = [*_ends(self.range[self.roots[k]]), *_ends(self.rest[self.roots[k]])]
        return min(whole), max(whole)

    def _limit_row(self, at: int) -> list[Number]:
        share = self._slope((libmp.fzero, libmp.fone))
        row = self._scaled(share, self.row(self.limits[at][0]))
        rest = self.plus(Number({(): Fraction(1)}), self.times(Number({(): Fraction(-1)}), share))
        row[self.states + list(self.limits).index(at)] = rest
        return row

    def _image(self, at: int) -> tuple[Interval, Interval]:
        base = self.base[at]
        values = self._along(at, np.linspace(*_ends(self.range[base]), _POINTS))
        return _interval(values), _interval(self._along(at, np.array(_ends(self.rest[base]))))

    def _along(self, at: int, values: Array) -> Array:
        """Return the values of a function of its base."""
        new = {self.base[at]: variable("t")}
        for k in self.table.needed([at]):
            entry = self.table.entries[k]
            if k not in new and all(a in new for a in entry.args) and entry.op != "var":
                new[k] = Node(entry.op, tuple(new[a] for a in entry.args), entry.value)
        out: Array = values_of([new[at]], {"t": values})[0]
        return out

    def _secant(self, at: int) -> Interval:
        base = self.base[at]
        rest, (low, high) = _ends(self.rest[base]), _ends(self.range[base])
        t, slopes = np.linspace(low, high, _POINTS), []
        for c in dict.fromkeys((*rest, sum(rest) / 2)):
            near = max(high - low, 1e-9) * 1e-5
            apart = np.where(np.abs(t - c) < near, near, t - c)
            value = self._along(at, np.array([c, c - near]))
            slopes += [(self._along(at, c + apart) - value[0]) / apart, np.array([(value[0] - value[1]) / near])]
        every = np.concatenate(slopes)
        every = every[np.isfinite(every)]
        if not every.size:
            raise Undefined("an expression that is not finite on the region")
        if self.table.entries[base].op != "var":
            self.inner.append(self._vertices_of(self.row(base), most=2))
        if np.ptp(every) <= 1e-6 * np.abs(every).max():
            return _interval(every.mean())
        return _interval(every + _WIDER * np.ptp(every) * np.sign(every - every.mean()))

    def _vertices_of(self, row: list[Number], most: int = _FEW) -> Array:
        used = sorted({k for entry in row for term in entry.poly for k in term})[:most]
        ends = np.array(self.slopes, dtype=float).reshape(-1, 2)
        rows = []
        for vertex in product(*ends[used]):
            value = ends.mean(axis=1)
            value[used] = vertex
            rows.append([sum(float(x) * value[list(t)].prod() for t, x in entry.poly.items()) for entry in row])
        return np.array(rows, dtype=float)

    def _support(self, row: list[Number]) -> Fraction:
        at = self._vertices_of(row)
        return Fraction(float(np.sqrt(np.einsum("ki,cij,kj->ck", at, self.covers, at).clip(0).max())))


def _ends(a: Interval) -> tuple[float, float]:
    return float(libmp.to_float(a[0])), float(libmp.to_float(a[1]))


def _interval(values: Array) -> Interval:
    if not np.all(np.isfinite(values)):
        raise Undefined("an expression that is not finite on the region")
    return libmp.from_float(float(np.min(values))), libmp.from_float(float(np.max(values)))
