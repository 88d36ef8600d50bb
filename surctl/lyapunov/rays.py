"""A grid of points on rays from the equilibrium, to compare functions; the smallest box around a region."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.lyapunov.dynamics import Dynamics
from surctl.lyapunov.template import Template
from surctl.verification.formula import Node

Array = NDArray[np.float64]

_BEYOND = 10  # points on each ray beyond the part in which the region may lie
_ONE_THREAD = 250_000  # multiplications of a matrix product above which threads cost more than they save
_NEAREST = 0.02  # radius of the innermost points, as a share of the outermost ones


@dataclass(frozen=True, eq=False)
class Sizes:
    """Sizes of the regions V < γ of B functions, where γ is the least level with a counterexample on the grid.

    Attributes:
        level: γ (B,); not positive if no level is possible.
        volume: volume (B,) of the region relative to the volume that the rays span.
        worst: largest value (B,) of the normalised change V'/q near the equilibrium; negative if V decreases there.
    """

    level: Array
    volume: Array
    worst: Array


@dataclass(frozen=True, eq=False)
class Grid:
    """Features of a template on D rays with M points each.

    Attributes:
        points: states (n, D M), ray by ray.
        radii: relative radii (D, M) of the points in scaled states.
        values: φ (K, D M).
        changes: φ' or φ(x⁺) − φ(x) (C, K, D M) for C values of the parameters.
        edge: (D M,) whether V must reach the level at the point: it is the last one of its ray, or its successor leaves
            the box.
        square: r² (D M,) in scaled states.
    """

    points: Array
    radii: Array
    values: Array
    changes: Array
    edge: NDArray[np.bool_]
    square: Array

    def sizes(self, coefficients: Array, rate: float = 0.0) -> Sizes:
        """Return the sizes of the regions of functions with coefficients (B, K) in which V' ≤ −rate V."""
        count, m = self.radii.shape
        batch = len(coefficients)
        v = product(coefficients, self.values).reshape(batch, count, m)
        g = np.full((batch, count * m), -np.inf)
        for change in self.changes:
            np.maximum(g, product(coefficients, change), out=g)
        g = g.reshape(batch, count, m) + rate * v
        g /= self.square.reshape(count, m)
        edge = self.edge.reshape(count, m)
        bad = (g >= 0) | edge
        level = np.where(bad, v, np.inf).min(axis=(1, 2))
        # between the last good and the first bad point the change is interpolated
        first = np.where(bad.any(axis=2), bad.argmax(axis=2), m - 1)
        before = np.maximum(first - 1, 0)
        b, d = np.ogrid[:batch, :count]
        rise = g[b, d, first] - g[b, d, before]
        share = np.where(edge[d, first] | ~(rise > 0), 1.0, -g[b, d, before] / np.where(rise > 0, rise, 1.0))
        crossed = v[b, d, before] + np.clip(share, 0, 1) * (v[b, d, first] - v[b, d, before])
        level = np.minimum(level, np.where(bad.any(axis=2), crossed, np.inf).min(axis=1))
        level = np.where((v.min(axis=(1, 2)) > 0) & np.isfinite(level), level, -1.0)
        return Sizes(level, self._volume(v, level), g[:, :, 0].max(axis=1))

    def _volume(self, v: Array, level: Array) -> Array:
        radius = self._radius(v, level)
        whole = self.radii[:, -1] ** len(self.points)
        volume = (radius ** len(self.points)).mean(axis=1) / whole.mean()
        return np.where(level > 0, volume, 0.0)

    def extent(self, coefficients: Array, level: float) -> Array:
        """Return the radius (D,) on each ray at which V = level, for coefficients (K,)."""
        v = (coefficients @ self.values).reshape(1, *self.radii.shape)
        return np.asarray(self._radius(v, np.array([level]))[0])

    def _radius(self, v: Array, level: Array) -> Array:
        batch, count, m = v.shape
        out = v >= level[:, None, None]
        first = np.where(out.any(axis=2), out.argmax(axis=2), m - 1)
        before = np.maximum(first - 1, 0)
        b, d = np.ogrid[:batch, :count]
        # along a ray, V grows about as r²
        low, high = (np.sqrt(np.maximum(v[b, d, at], 0)) for at in (before, first))
        root = np.sqrt(np.maximum(level, 0))[:, None]
        share = np.clip((root - low) / np.where(high > low, high - low, 1.0), 0, 1)
        share = np.where(out.any(axis=2), share, 1.0)
        return np.asarray(self.radii[d, before] + share * (self.radii[d, first] - self.radii[d, before]))


def product(a: Array, b: Array) -> Array:
    """Return the matrix product a b in pieces so small that the linear algebra library starts no threads for them."""
    piece = max(1, _ONE_THREAD // (a.shape[0] * a.shape[1]))
    if b.shape[1] <= piece:
        return np.asarray(a @ b)
    return np.hstack([a @ b[:, k : k + piece] for k in range(0, b.shape[1], piece)])


def directions(dimension: int, count: int, *, half: bool = False, seed: int = 0) -> Array:
    """Return unit vectors (n, count), evenly spread over the sphere, or over half of it."""
    if dimension == 1:
        return np.array([[-1.0, 1.0]])
    if dimension == 2:
        angle = (1 if half else 2) * np.pi * (np.arange(count) + 0.5) / count
        return np.array([np.cos(angle), np.sin(angle)])
    from scipy.stats import norm, qmc

    unit = qmc.Sobol(dimension, seed=seed).random(count).T
    normal = norm.ppf(np.clip(unit, 1e-6, 1 - 1e-6))
    return np.asarray(normal / np.linalg.norm(normal, axis=0))


def extent(equilibrium: Array, box: Array, steps: Array) -> Array:
    """Return the largest factors (N,) with which steps (n, N) from the equilibrium end in the box (2, n)."""
    low, high = (end[:, None] - equilibrium[:, None] for end in box)
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.where(steps > 0, high / steps, np.where(steps < 0, low / steps, np.inf))
    return np.asarray(factor.min(axis=0))


def grid(
    template: Template,
    scales: Array,
    *,
    rays: int,
    points: int,
    corners: Array,
    outer: Array | None = None,
    half: bool = False,
    beyond: int = _BEYOND,
) -> Grid:
    """Return the features of a template on rays from the equilibrium to the border of the box.

    Args:
        template: the template.
        scales: lengths (n,) in which the directions of the rays are evenly spread.
        rays: number of rays.
        points: number of points on each ray.
        corners: values (m, C) of the parameters.
        outer: relative radius (rays,) up to which the region may extend on each ray; beyond it, a few points up to the
            border of the box are still part of the grid.
        half: whether half of the rays suffice, because dynamics and template are symmetric to x*.
        beyond: number of points on each ray beyond `outer`.
    """
    d = template.dynamics
    u = directions(len(d.states), rays, half=half)
    border = extent(d.equilibrium, d.box, u * scales[:, None])
    far = border if outer is None else np.minimum(border, outer)
    radii = far[:, None] * np.linspace(_NEAREST, 1.0, points)
    if outer is not None:
        radii = np.hstack([radii, far[:, None] + (border - far)[:, None] * np.linspace(0, 1, beyond + 1)[1:]])
    at = (u[:, :, None] * radii[None]).reshape(len(u), -1)
    x = d.equilibrium[:, None] + scales[:, None] * at
    square = (at**2).sum(axis=0)
    read = [template.features(x, corner) for corner in corners.T]
    edge = np.zeros(radii.shape, dtype=bool)
    if not d.discrete or outer is not None:
        edge[:, points - 1 :] = True
    last = edge.reshape(-1)
    if d.discrete:
        for corner in corners.T:
            after = d.evaluate(x, np.repeat(corner[:, None], x.shape[1], axis=1))
            last |= np.any((after < d.box[0][:, None]) | (after > d.box[1][:, None]), axis=0)
    return Grid(x, radii, read[0][0], np.array([change for _, change in read]), last, square)


# The smallest box around a region V < level: in it, few boxes of a proof lie outside the region


_RAYS, _POINTS = 512, 40
_MARGIN, _WIDE = 1.02, 1.1  # bounds relative to the extent of the region; in discrete time, a step must end inside
_BITS = 8  # of the distances of the bounds from the equilibrium: a bound is then exactly its decimal notation


def hugged(dynamics: Dynamics, function: Node, level: float) -> Dynamics:
    """Return the dynamics with bounds that are just outside the region V < level around the equilibrium.

    No bound is widened. A proof that V ≥ level on the faces of the box shows that the region does not reach them.

    Args:
        dynamics: the dynamics.
        function: V, an expression of the states.
        level: level of the region.

    Example:
        >>> from surctl.lyapunov import Dynamics, State
        >>> from surctl.lyapunov.rays import hugged
        >>> from surctl.verification.formula import parse, variable
        >>> x = {"x": variable("x")}
        >>> cubic = Dynamics("cubic", "continuous", (State("x", -2.0, 2.0),), (parse("-x + x^3", x),))
        >>> hugged(cubic, parse("x^2", x), 0.25).box.round(2).tolist()
        [[-0.51], [0.51]]
    """
    return bounded(dynamics, farthest(dynamics, function, level))


def farthest(dynamics: Dynamics, function: Node, level: float) -> Array:
    """Return how far (2, n) the region V < level reaches below and above the equilibrium in each state, in the box."""
    d, n = dynamics, len(dynamics.states)
    scales = np.maximum(d.box[1] - d.equilibrium, d.equilibrium - d.box[0])
    z = ca.SX.sym("z", n)
    value = d.compiled(function)(ca.DM(d.equilibrium) + ca.DM(scales) * z, d.corners()[:, 0])
    hessian = ca.hessian(value, z)[0]
    if hessian.is_constant() and np.all(np.linalg.eigvalsh(matrix := np.asarray(ca.DM(hessian)) / 2) > 0):
        # a quadratic form about the equilibrium
        far = np.sqrt(level * np.diag(np.linalg.inv(matrix))) * scales
        return np.array([far, far])
    from scipy.optimize import minimize

    read = ca.Function("value", [z], [value])
    slope = ca.Function("slope", [z], [ca.gradient(value, z)])
    edge = (d.box - d.equilibrium) / scales
    u = np.hstack([directions(n, _RAYS), np.eye(n), -np.eye(n)])
    radii = extent(np.zeros(n), edge, u)[:, None] * np.linspace(0, 1, _POINTS + 1)[1:]
    along = u[:, :, None] * radii
    v = np.asarray(read(along.reshape(n, -1))).reshape(u.shape[1], -1)
    inside = np.logical_and.accumulate(v < level, axis=1)
    points = np.where(inside, along, 0.0).reshape(n, -1)
    inner = {
        "type": "ineq",
        "fun": lambda at: 1 - float(read(at)) / level,  # V in any unit: tolerances of the search are absolute
        "jac": lambda at: -np.asarray(slope(at)).reshape(-1) / level,
    }
    reached = np.zeros((2, n))
    for k in range(n):
        for side, sign in enumerate((-1.0, 1.0)):
            start = points[:, np.argmax(sign * points[k])]
            toward = -sign * np.eye(n)[k]
            outermost = minimize(
                lambda at, toward=toward: float(toward @ at), start, jac=lambda at, toward=toward: toward,
                constraints=[inner], bounds=edge.T, method="SLSQP",
            )  # fmt: skip
            far = max(sign * start[k], sign * outermost.x[k] if outermost.success else 0.0)
            reached[side, k] = far * scales[k]
    return reached


def enclosing(dynamics: Dynamics, covers: Array, level: float) -> Dynamics:
    """Return the dynamics with bounds just outside ξ' Q⁻¹ ξ ≤ level about each equilibrium, for all Q (K, n, n)."""
    far = np.sqrt(level * np.diagonal(covers, axis1=1, axis2=2).max(axis=0)) + dynamics.radii
    return bounded(dynamics, np.array([far, far]))


def bounded(dynamics: Dynamics, extents: Array) -> Dynamics:
    """Return the dynamics with bounds just outside x* − extents[0] and x* + extents[1] (2, n); no bound is widened."""
    away = extents * (_WIDE if dynamics.discrete else _MARGIN)
    grid = 2.0 ** (np.floor(np.log2(np.maximum(away, 1e-300))) + 1 - _BITS)
    ends = dynamics.equilibrium + np.array([[-1.0], [1.0]]) * np.ceil(away / grid) * grid
    bounds = {}
    for state, low, high in zip(dynamics.states, *ends.tolist(), strict=True):
        low, high = max(low, state.lower), min(high, state.upper)
        if low < state.equilibrium < high:
            bounds[state.name] = (low, high)
    return dynamics.on(bounds)
