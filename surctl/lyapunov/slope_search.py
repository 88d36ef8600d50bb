"""Search of quadratic Lyapunov functions by the slope rule: V and level of a large region, proposed by cutting planes.

The dynamics are x' = A(θ)(x − x*) on {V ≤ level}, with a matrix that has degree at most 1 in each slope θ. The slopes
are those of `surctl.certcheck.slope_rows`, with sampled ranges of functions: they only serve to propose V and level,
and the checker encloses the ranges itself. With feedbacks, the output of each limit lies between its operand and a
variable of its own, beside ξ: the value G·ξ of its feedback.

A matrix inequality must hold at every vertex of the ranges of the slopes. The vertices where it is closest to failing
are found by alternating between the worst state for a vertex and the worst vertex for a state; the checker tests all.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import product
from typing import NamedTuple

import casadi as ca
import numpy as np
from mpmath import libmp
from numpy.typing import NDArray

from surctl.certcheck import Rejected
from surctl.certcheck.enclosure import Interval, Undefined, span
from surctl.certcheck.slope_rows import Row, Rows
from surctl.errors import UnsupportedOperation
from surctl.lyapunov.candidates import Candidate
from surctl.lyapunov.dynamics import Dynamics
from surctl.lyapunov.equilibrium import Linear, common_quadratic
from surctl.lyapunov.near import slowest
from surctl.verification.conic import minimise, symmetric_basis
from surctl.verification.formula import Node, number, power, text_of, to_casadi, values_of, variable

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
        self, dynamics: Dynamics, covers: Array, *, rates: Sequence[Node] | None = None, feedbacks: Array | None = None
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
                [Fraction(r) for r in d.radii.tolist()] if d.shifts else (),
            )
        except (Rejected, Undefined) as reason:
            raise UnsupportedOperation(str(reason), key="slopes") from None

    def ends(self, k: int) -> tuple[float, float]:
        """Return the range of a rate on the region."""
        whole = [*_ends(self.range[self.roots[k]]), *_ends(self.rest[self.roots[k]])]
        return min(whole), max(whole)

    def gaps(self) -> Array:
        """Return the least distance of the operand of each limit at x* from it (k,)."""
        return np.array([float(gap) for _, gap, _ in self.limits.values()])

    def operands(self) -> list[Array]:
        """Return the row of the operand of each limit, in the middle of all slopes."""
        return [self._vertices_of(self.row(y), most=0)[0] for y, _, _ in self.limits.values()]

    def _limit_row(self, at: int) -> Row:
        share = self._slope((libmp.fzero, libmp.fone))
        row = self._scaled(share, self.row(self.limits[at][0]))
        rest = -share + Fraction(1)
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

    def _vertices_of(self, row: Row, most: int = _FEW) -> Array:
        used = sorted({k for entry in row for term in entry.poly for k in term})[:most]
        ends = np.array(self.slopes, dtype=float).reshape(-1, 2)
        rows = []
        for vertex in product(*ends[used]):
            value = ends.mean(axis=1)
            value[used] = vertex
            rows.append([sum(float(x) * value[list(t)].prod() for t, x in entry.poly.items()) for entry in row])
        return np.array(rows, dtype=float)

    def _support(self, row: Row) -> Fraction:
        at = self._vertices_of(row)
        return Fraction(float(np.sqrt(np.einsum("ki,cij,kj->ck", at, self.covers, at).clip(0).max())))


def _ends(a: Interval) -> tuple[float, float]:
    return float(libmp.to_float(a[0])), float(libmp.to_float(a[1]))


def _interval(values: Array) -> Interval:
    if not np.all(np.isfinite(values)):
        raise Undefined("an expression that is not finite on the region")
    return libmp.from_float(float(np.min(values))), libmp.from_float(float(np.max(values)))


LABEL = "quadratic by the slope rule"
"""How a function of the slope rule was found, in words."""

Bits = NDArray[np.bool_]

_MOST, _MOST_STATES = 40, 20  # slopes of a matrix; states
_SLOW, _FASTER = 0.02, 1.02  # decay rate relative to that of the linearisation, and to the demanded one
_NEGLIGIBLE, _DIGITS = 1e-5, 6  # coefficients of V: what is left out, and digits after the first
_STARTS, _TURNS, _SWEEPS = 256, 8, 2  # random starts of the search for vertices; its turns; sweeps over all slopes
_HALVINGS, _ROUNDS, _CUTS = 6, 40, 10
_WORST = 6  # vertices that a cut adds
_STRETCH, _LEAST_STRETCH = 1.4, 1.03  # by which the extents that decide slopes may grow in a round
_NEAR = 1e-4  # level near the equilibrium, relative to the level at which V leaves the box
_GROWTH = 1.01  # least growth of the mean extent of the region in a round
_INSIDE = 1e-4  # by which the region stays inside the box, relative to it
_SPARE = 1e-2  # of the rate, so that the checker's wider ranges do not matter


class Family:
    """The matrices A(θ) of an embedding; a vertex (K,) says for each slope whether it has its largest value."""

    def __init__(self, embedding: Embedding) -> None:
        n = len(embedding.rows)
        terms = sorted({term for row in embedding.rows for entry in row for term in entry.poly})
        used = sorted({k for term in terms for k in term})
        if len(used) > _MOST:
            raise UnsupportedOperation(f"{len(used)} slopes", key="slopes")
        self.numbers = np.zeros((len(terms), n, len(embedding.covers[0])))
        place = {term: t for t, term in enumerate(terms)}
        for i, row in enumerate(embedding.rows):
            for j, entry in enumerate(row):
                for term, x in entry.poly.items():
                    self.numbers[place[term], i, j] = x
        self.low, self.high = np.array([embedding.slopes[k] for k in used], dtype=float).reshape(-1, 2).T
        self.members = np.array([[k in term for k in used] for term in terms]).reshape(len(terms), len(used))

    def closed(self, feedbacks: Array) -> Family:
        """Return the matrices (n, n) with these feedbacks (k, n) in the place of their variables."""
        n = self.numbers.shape[1]
        family = copy(self)
        family.numbers = self.numbers[..., :n] + self.numbers[..., n:] @ feedbacks
        return family

    def at(self, slopes: Array) -> Array:
        """Return A(θ) (B, n, n) for slopes (B, K)."""
        products = np.where(self.members, slopes[:, None, :], 1.0).prod(axis=2)
        return np.tensordot(products, self.numbers, axes=1)

    def vertices(self, chosen: Bits) -> Array:
        """Return A(θ) (B, n, n) at vertices (B, K)."""
        return self.at(np.where(chosen, self.high, self.low))

    def least(self, c: Array, chosen: Bits) -> Bits:
        """Return vertices (B, K) where Σ_t c_t Π θ is small, for coefficients (B, T), by changes of one slope."""
        chosen = chosen.copy()
        for _ in range(_SWEEPS):
            for k in range(len(self.low)):
                own = np.flatnonzero(self.members[:, k])
                others = self.members[own].copy()
                others[:, k] = False
                slopes = np.where(chosen, self.high, self.low)
                rest = np.where(others, slopes[:, None, :], 1.0).prod(axis=2)
                chosen[:, k] = (c[:, own] * rest).sum(axis=1) < 0
        return chosen


class Ellipsoid(NamedTuple):
    """P (n, n) of a region ξ' P ξ < 1, and the feedbacks (k, n) of the limits."""

    p: Array
    feedbacks: Array


@dataclass
class _Shapes:
    """What a quadratic form must satisfy at the matrices of a family."""

    dynamics: Dynamics
    rate: float
    toward: str = ""
    scales: Array = field(init=False)

    def __post_init__(self) -> None:
        self.scales = self.dynamics.freedom

    def losses(self, a: Array, p: Array) -> Array:
        """Return the matrices (B, n, n) that must be positive definite."""
        if not self.dynamics.discrete:
            pulled = p @ a
            return -(pulled + pulled.swapaxes(-1, -2)) - self.rate * p
        return (1 - self.rate) * p - a.swapaxes(-1, -2) @ p @ a

    def worst(self, family: Family, p: Array) -> tuple[Array, Bits]:
        """Return the least eigenvalues (B,) relative to P, and the vertices (B, K) that have them, the worst first."""
        n, count = len(p), len(family.low)
        root = np.linalg.inv(np.linalg.cholesky(p))

        def spectrum(a: Array) -> tuple[Array, Array]:
            values, vectors = np.linalg.eigh(root @ self.losses(a, p) @ root.T)
            return values, root.T @ vectors

        def toward(x: Array, a: Array, chosen: Bits) -> Bits:
            moved = x if not self.dynamics.discrete else np.einsum("bij,bj->bi", a, x)
            return family.least(-np.einsum("bi,tij,bj->bt", moved @ p, family.numbers, x), chosen)

        middle = family.at((family.low + family.high)[None] / 2)
        x = spectrum(middle)[1][0].T
        chosen = toward(x, np.repeat(middle, n, axis=0), np.zeros((n, count), dtype=bool))
        random = np.random.default_rng(0).random((_STARTS, count)) < 0.5
        chosen = np.unique(np.vstack([chosen, random]), axis=0)
        for _ in range(_TURNS):
            a = family.vertices(chosen)
            further = np.unique(toward(spectrum(a)[1][:, :, 0], a, chosen), axis=0)
            if np.array_equal(further, chosen):
                break
            chosen = further
        least = spectrum(family.vertices(chosen))[0][:, 0]
        order = np.argsort(least)
        return least[order], chosen[order]

    def holds(self, shape: Ellipsoid, level: float = 1.0) -> bool:
        """Return whether no vertex is known at which the matrix inequality fails on {V ≤ level}."""
        p, g = shape
        try:
            embedding = Embedding(self.dynamics, _cover(p, level), feedbacks=g if len(g) else None)
            values = np.sqrt(level * np.einsum("ki,ij,kj->k", g, np.linalg.inv(p), g))
            if not np.all(values < embedding.gaps() * (1 - _INSIDE / 2)):
                return False
            return bool(self.worst(Family(embedding).closed(g), p)[0][0] > 0)
        except (UnsupportedOperation, np.linalg.LinAlgError):
            return False


def _largest_level(shapes: _Shapes, shape: Ellipsoid) -> float:
    """Return a level up to which the slope rule shows that V = ξ' P ξ decreases in the box; 0 if there is none."""
    top = float((shapes.scales**2 / np.diag(np.linalg.inv(shape.p))).min()) * (1 - _INSIDE)
    if shapes.holds(shape, top):
        return top
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2 if low else high / 4
        low, high = (middle, high) if shapes.holds(shape, middle * top) else (low, middle)
    if not low and shapes.holds(shape, _NEAR * top):
        low = _NEAR
    return low * top


def slope_candidate(
    dynamics: Dynamics, linear: Linear, rate: float | None, *, seconds: float, toward: str = ""
) -> Candidate | None:
    """Return a quadratic V with a large region V < 1 that the slope rule is likely to prove; None if none is found.

    Args:
        dynamics: the dynamics, with their equilibrium.
        linear: the stable linearisation.
        rate: demanded decay rate of V; None means any decrease.
        seconds: limit of the processor time [s].
        toward: state along which the region is to be long; empty for a large volume.
    """
    d = dynamics
    if len(d.states) > _MOST_STATES:
        return None
    demanded = max(_FASTER * (rate or 0.0), _SLOW * slowest(d, linear)[1])
    try:
        shape = _slope_function(_Shapes(d, demanded, toward), linear.matrices, time.process_time() + seconds)
    except (UnsupportedOperation, np.linalg.LinAlgError):
        return None
    if shape is None:
        return None
    return Candidate(LABEL, quadratic(d, shape.p), relative_volume(d, shape.p), _rounded(shape.feedbacks))


def _rounded(feedbacks: Array) -> Array:
    """Return the numbers with as many digits as the coefficients of V; the spare of the limits covers the rounding."""
    return np.array([[float(f"{x:.{_DIGITS}e}") for x in row] for row in feedbacks]).reshape(feedbacks.shape)


def quadratic(d: Dynamics, p: Array) -> Node:
    """Return ξ' P ξ with rounded coefficients, without negligible ones."""
    apart = [variable(s.name) - number(s.rest) if s.rest else variable(s.name) for s in d.states]
    size = np.sqrt(np.diag(p))
    p = np.where(np.abs(p) > _NEGLIGIBLE * np.outer(size, size), p, 0.0)
    total: Node | None = None
    for i in range(len(p)):
        for j in range(i + 1):
            if p[i, j]:
                factor = number(Fraction(f"{p[i, j] * (1 if i == j else 2):.{_DIGITS}e}"))
                term = factor * (power(apart[i], 2) if i == j else apart[j] * apart[i])
                total = term if total is None else total + term
    assert total is not None
    return total


def form_of(function: Node, names: Sequence[str]) -> Array:
    """Return the matrix (n, n) of a quadratic form of the named variables."""
    symbols = {name: ca.SX.sym(name) for name in names}
    return np.asarray(ca.DM(ca.hessian(to_casadi(function, symbols), ca.vertcat(*symbols.values()))[0])) / 2


def relative_volume(d: Dynamics, p: Array) -> float:
    """Return the volume of {ξ' P ξ < 1} relative to the box."""
    n = len(p)
    ball = np.pi ** (n / 2) / math.gamma(n / 2 + 1)
    return float(ball / np.sqrt(np.linalg.det(p * np.outer(*[d.box[1] - d.box[0]] * 2))))


def _slope_function(shapes: _Shapes, matrices: Array, until: float) -> Ellipsoid | None:
    """Return a large region that the slope rule is likely to prove; None if none is found."""
    p = _start(shapes, matrices)
    if p is None:
        return None
    plain = _grown(shapes, Ellipsoid(p, np.zeros((0, len(p)))), until)
    limited = _limited(shapes, plain)
    if limited is None:
        return plain
    limited = _grown(shapes, limited, until)
    if plain is None or (limited is not None and _extent(limited.p, shapes) > _extent(plain.p, shapes)):
        return limited
    return plain


def _start(shapes: _Shapes, matrices: Array) -> Array | None:
    """Return P that decreases near the equilibrium, also at vertices that no corner of the parameters reaches."""
    d, rate = shapes.dynamics, shapes.rate
    for _ in range(_CUTS):
        faster = matrices / np.sqrt(1 - rate) if d.discrete else matrices + rate / 2 * np.eye(len(shapes.scales))
        p = common_quadratic(faster, shapes.scales.tolist(), discrete=d.discrete)
        if p is None:
            return None
        top = float((shapes.scales**2 / np.diag(np.linalg.inv(p))).min())
        family = Family(Embedding(d, _cover(p, _NEAR * top)))
        least, worst = shapes.worst(family, p)
        if least[0] > 0:
            return p
        matrices = np.concatenate([matrices, family.vertices(worst[:_WORST])])
    return p


def _limited(shapes: _Shapes, shape: Ellipsoid | None) -> Ellipsoid | None:
    """Return a small region with feedbacks for the limits that act in a region; None if none acts."""
    if shape is None:
        return None
    n = len(shape.p)
    small = 1e-8 * _cover(shape.p, 1.0)
    embedding = Embedding(shapes.dynamics, small, feedbacks=np.zeros((4 * n, n)))
    if not embedding.limits:
        return None
    feedbacks = np.zeros((len(embedding.limits), n))
    for k, row in enumerate(embedding.operands()):
        feedbacks[k] = row[:n] + row[n : n + len(feedbacks)] @ feedbacks
    return Ellipsoid(shape.p, feedbacks)


def _grown(shapes: _Shapes, shape: Ellipsoid, until: float) -> Ellipsoid | None:
    """Return the largest region that the rounds of the search reach from the shape of a small one."""
    level = _largest_level(shapes, shape)
    if not level > 0:
        return None
    best = Ellipsoid(shape.p / level, shape.feedbacks)
    size, stretch, pool = _extent(best.p, shapes), _STRETCH, list[Bits]()
    for _ in range(_ROUNDS):
        if time.process_time() > until:
            break
        trial = _reshaped(shapes, best, stretch, pool)
        new = 0.0 if trial is None else _extent(trial.p, shapes)
        if trial is not None and new > _GROWTH * size and shapes.holds(trial):
            best, size = trial, new
        else:
            stretch = 1 + (stretch - 1) / 2
            if stretch < _LEAST_STRETCH:
                break
    return Ellipsoid(best.p / _largest_level(shapes, best), best.feedbacks) if shapes.holds(best) else best


def _extent(p: Array, shapes: _Shapes) -> float:
    """Return the mean extent of {ξ' P ξ ≤ 1}, or that along the state `toward`, relative to the scales."""
    scales = shapes.scales
    if shapes.toward:
        k = shapes.dynamics.names.index(shapes.toward)
        return float(1 / np.sqrt(p[k, k]) / scales[k])
    return float(np.exp(-np.linalg.slogdet(p * np.outer(scales, scales))[1] / 2 / len(scales)))


def _reshaped(shapes: _Shapes, shape: Ellipsoid, stretch: float, pool: list[Bits]) -> Ellipsoid | None:
    """Return a larger region on which the slopes stay those of p/stretch², if there is one.

    The unknowns are Q = P⁻¹ in scaled states, whose square root of r Q r' is the extent of the ellipsoid along a row r,
    W ⪰ Q⁻¹ for the volume, and Y = G Q for the feedbacks G. Vertices that decided earlier shapes are in `pool`.
    """
    p, g = shape
    try:
        embedding = Embedding(shapes.dynamics, _cover(p, stretch**2), feedbacks=g / stretch if len(g) else None)
        family = Family(embedding)
    except UnsupportedOperation:
        return None
    n, k, cover, discrete = len(p), len(g), np.linalg.inv(p) * stretch**2, shapes.dynamics.discrete
    lengths, limits = np.sqrt(np.diag(cover)), embedding.gaps()
    size = np.diag(lengths)
    wide = np.zeros((n + k, n + k))
    wide[:n, :n], wide[n:, n:] = size, np.diag(limits)
    family.numbers = np.linalg.inv(size) @ family.numbers @ wide
    basis = symmetric_basis(n)
    count = 2 * len(basis) + k * n
    inverses, inverse_bounds, sides = np.zeros((count, n, n)), np.zeros((count, n, n)), np.zeros((count, k, n))
    inverses[: len(basis)], inverse_bounds[len(basis) : 2 * len(basis)] = basis, basis
    sides[2 * len(basis) :] = np.eye(k * n).reshape(k * n, k, n)
    rows = [*np.diag(lengths / shapes.scales) / (1 - _INSIDE)]
    for row in [*np.eye(n), *(row[:n] + row[n:] @ g for rows in embedding.inner for row in rows)]:
        most = float(row @ cover @ row)
        if most > 0:
            rows.append(row @ size / np.sqrt(most))
    own = size @ p @ size
    extents = np.einsum("ri,bij,rj->rb", rows, inverses, rows)
    volume = np.kron(np.array([[0.0, 1.0], [1.0, 0.0]]), np.eye(n))[None]
    fixed = [
        (np.ones((len(rows), 1, 1)), -extents[:, :, None, None]),
        (volume, _blocks(inverses, inverse_bounds)[None]),
    ]
    one = np.zeros((n + 1, n + 1))
    one[0, 0] = (1 - _INSIDE) ** 2
    for row in range(k):
        bound = np.zeros((count, n + 1, n + 1))
        bound[:, 1:, 1:] = inverses
        bound[:, 0, 1:] = bound[:, 1:, 0] = sides[:, row]
        fixed.append((one[None], bound[None]))
    if shapes.toward:
        at = shapes.dynamics.names.index(shapes.toward)
        gradient = 0.01 * np.linalg.inv(own) / n
        gradient[at, at] += 1.0
    else:
        gradient = np.linalg.inv(own) / n  # of log det P
    cost = np.tensordot(inverse_bounds, gradient, axes=2)
    chosen = shapes.worst(family.closed(g @ size / limits[:, None]), own)[1][:_WORST]
    if pool and pool[0].shape[1] == chosen.shape[1]:
        chosen = np.unique(np.vstack([chosen, pool[0]]), axis=0)
    rate = shapes.rate * (1 + _SPARE) + 1e-9
    for _ in range(_CUTS):
        at_vertices = family.vertices(chosen)[:, None]
        moved = at_vertices[..., :n] @ inverses + at_vertices[..., n:] @ sides  # A Q
        if discrete:
            loss = _blocks(np.broadcast_to((1 - rate) * inverses, moved.shape), np.broadcast_to(inverses, moved.shape))
            loss[..., n:, :n], loss[..., :n, n:] = moved, moved.swapaxes(-1, -2)
        else:
            loss = -(moved + moved.swapaxes(-1, -2)) - rate * inverses
        x = minimise(cost, [*fixed, (np.zeros((len(chosen), *loss.shape[2:])), loss)], tolerance=1e-7)
        if x is None:
            return None
        q = np.tensordot(x, inverses, axes=1)
        if np.linalg.eigvalsh(q)[0] <= 0:
            return None
        trial = np.linalg.inv(q)
        trial = (trial + trial.T) / 2
        new = np.tensordot(x, sides, axes=1) @ trial
        closed = family.closed(new)
        least, worst = shapes.worst(closed, trial)
        if least[0] > -1e-7:
            break
        chosen = np.unique(np.vstack([chosen, worst[:_WORST]]), axis=0)
    else:
        return None
    root = np.linalg.cholesky(q)
    active = np.linalg.eigvalsh(root.T @ shapes.losses(closed.vertices(chosen), trial) @ root)[:, 0]
    pool[:] = [chosen[np.argsort(active)[: 4 * _WORST]]]
    inverse = np.linalg.inv(size)
    return Ellipsoid(np.asarray(inverse @ trial @ inverse), limits[:, None] * new @ inverse)


def _cover(p: Array, level: float) -> Array:
    """Return the cover (1, n, n) of {ξ' P ξ ≤ level}."""
    return np.asarray(level * np.linalg.inv(p)[None], dtype=float)


def _blocks(a: Array, b: Array) -> Array:
    """Return the block-diagonal matrices of two arrays of matrices."""
    zero = np.zeros_like(a)
    return np.concatenate([np.concatenate([a, zero], axis=-1), np.concatenate([zero, b], axis=-1)], axis=-2)
