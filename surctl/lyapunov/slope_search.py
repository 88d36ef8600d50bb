"""Search of quadratic Lyapunov functions by the slope rule: V and level of a large region, proposed by cutting planes.

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
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import UnsupportedOperation
from surctl.lyapunov.candidates import Candidate
from surctl.lyapunov.dynamics import Dynamics
from surctl.lyapunov.equilibrium import Linear, common_quadratic
from surctl.lyapunov.near import slowest
from surctl.lyapunov.slopes import Embedding
from surctl.verification.conic import minimise, symmetric_basis
from surctl.verification.formula import Node, number, power, to_casadi, variable

__all__ = ["LABEL", "Family", "form_of", "quadratic", "relative_volume", "slope_candidate"]

LABEL = "quadratic by the slope rule"
"""How a function of the slope rule was found, in words."""

Array = NDArray[np.float64]
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
        terms = sorted({term for row in embedding.rows for entry in row for term in entry})
        used = sorted({k for term in terms for k in term})
        if len(used) > _MOST:
            raise UnsupportedOperation(f"{len(used)} slopes", key="slopes")
        self.numbers = np.zeros((len(terms), n, len(embedding.covers[0])))
        place = {term: t for t, term in enumerate(terms)}
        for i, row in enumerate(embedding.rows):
            for j, entry in enumerate(row):
                for term, x in entry.items():
                    self.numbers[place[term], i, j] = x
        self.low, self.high = np.array([embedding.slopes[k] for k in used]).reshape(-1, 2).T
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


class Shape(NamedTuple):
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
        d = self.dynamics
        self.scales = np.minimum(d.box[1] - d.equilibrium, d.equilibrium - d.box[0])

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

    def holds(self, shape: Shape, level: float = 1.0) -> bool:
        """Return whether no vertex is known at which the matrix inequality fails on {V ≤ level}."""
        p, g = shape
        try:
            embedding = Embedding(self.dynamics, _cover(p, level), feedbacks=g if len(g) else None)
            reach = np.sqrt(level * np.einsum("ki,ij,kj->k", g, np.linalg.inv(p), g))
            if not np.all(reach < np.array(embedding.limits) * (1 - _INSIDE / 2)):
                return False
            return bool(self.worst(Family(embedding).closed(g), p)[0][0] > 0)
        except (UnsupportedOperation, np.linalg.LinAlgError):
            return False


def _largest_level(shapes: _Shapes, shape: Shape) -> float:
    """Return a level up to which the slope rule shows that V = ξ' P ξ decreases in the box; 0 if there is none."""
    top = float((shapes.scales**2 / np.diag(np.linalg.inv(shape.p))).min()) * (1 - _INSIDE)
    if shapes.holds(shape, top):
        return top
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2 if low else high / 4
        low, high = (middle, high) if shapes.holds(shape, middle * top) else (low, middle)
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


def _slope_function(shapes: _Shapes, matrices: Array, until: float) -> Shape | None:
    """Return a large region that the slope rule is likely to prove; None if none is found."""
    p = _start(shapes, matrices)
    if p is None:
        return None
    plain = _grown(shapes, Shape(p, np.zeros((0, len(p)))), until)
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


def _limited(shapes: _Shapes, shape: Shape | None) -> Shape | None:
    """Return a small region with feedbacks for the limits that act in a region; None if none acts."""
    if shape is None:
        return None
    n = len(shape.p)
    small = 1e-8 * _cover(shape.p, 1.0)
    embedding = Embedding(shapes.dynamics, small, feedbacks=np.zeros((4 * n, n)))
    if not embedding.limits:
        return None
    feedbacks = np.zeros((len(embedding.limits), n))
    for k, row in enumerate(embedding.operands):
        feedbacks[k] = row[:n] + row[n : n + len(feedbacks)] @ feedbacks
    return Shape(shape.p, feedbacks)


def _grown(shapes: _Shapes, shape: Shape, until: float) -> Shape | None:
    """Return the largest region that the rounds of the search reach from the shape of a small one."""
    level = _largest_level(shapes, shape)
    if not level > 0:
        return None
    best = Shape(shape.p / level, shape.feedbacks)
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
    return Shape(best.p / _largest_level(shapes, best), best.feedbacks) if shapes.holds(best) else best


def _extent(p: Array, shapes: _Shapes) -> float:
    """Return the mean extent of {ξ' P ξ ≤ 1}, or that along the state `toward`, relative to the scales."""
    scales = shapes.scales
    if shapes.toward:
        k = shapes.dynamics.names.index(shapes.toward)
        return float(1 / np.sqrt(p[k, k]) / scales[k])
    return float(np.exp(-np.linalg.slogdet(p * np.outer(scales, scales))[1] / 2 / len(scales)))


def _reshaped(shapes: _Shapes, shape: Shape, stretch: float, pool: list[Bits]) -> Shape | None:
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
    lengths, limits = np.sqrt(np.diag(cover)), np.array(embedding.limits)
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
    for row in [*np.eye(n), *(row[:n] + row[n:] @ g for _, rows in embedding.inner for row in rows)]:
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
    return Shape(np.asarray(inverse @ trial @ inverse), limits[:, None] * new @ inverse)


def _cover(p: Array, level: float) -> Array:
    """Return the cover (1, n, n) of {ξ' P ξ ≤ level}."""
    return np.asarray(level * np.linalg.inv(p)[None], dtype=float)


def _blocks(a: Array, b: Array) -> Array:
    """Return the block-diagonal matrices of two arrays of matrices."""
    zero = np.zeros_like(a)
    return np.concatenate([np.concatenate([a, zero], axis=-1), np.concatenate([zero, b], axis=-1)], axis=-2)
