"""The least level of a Lyapunov function at which a counterexample exists, found by rays and by local searches."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.lyapunov.claims import Power, Stability
from surctl.lyapunov.dynamics import Dynamics
from surctl.lyapunov.rays import directions, extent
from surctl.verification.formula import Node
from surctl.verification.proving import certain_excess

Array = NDArray[np.float64]

_RAYS, _POINTS, _STARTS, _MOST_CORNERS = 1024, 48, 5, 16
_NEAREST = 0.004  # least relative distance from the equilibrium
_FLAT = 1e-8  # eigenvalues below this share of the largest one count as 0
_LITTLE = 1e-9  # share of V by which it may grow close to the equilibrium by rounding
_SHORT = 0.05  # length of a step along directions without a decrease of second order
_NEARLY = 0.1  # share of the median decrease below which a point is close to a counterexample
_OUTWARDS = (0.0, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4, 3e-4, 1e-3, 3e-3)


@dataclass(frozen=True, eq=False)
class Falsified:
    """The least level for which a counterexample was found.

    Attributes:
        level: V at the counterexample; a region with a larger level contains it. 0 or less if V is not positive or does
            not decrease close to the equilibrium.
        values: the counterexample: states and parameters, by name.
        cause: "decrease", "face" or "successor": the condition that fails; "flat": V' is only semidefinite.
        confirmed: whether interval arithmetic confirms that the condition fails.
    """

    level: float
    values: Mapping[str, float]
    cause: str
    confirmed: bool


@dataclass(frozen=True, eq=False)
class _Search:
    dynamics: Dynamics
    function: Node
    rate: float
    scales: Array

    @cached_property
    def symbolic(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
        # scaled states z, scaled parameters p in [0, 1], V, V' + rate V, successors
        d = self.dynamics
        z, p = ca.SX.sym("z", len(d.states)), ca.SX.sym("p", len(d.parameters))
        x = ca.DM(d.equilibrium) + ca.DM(self.scales) * z
        low, high = d.ranges
        w = ca.DM(low) + ca.DM(high - low) * p
        value, change, *after = ca.vertsplit(d.compiled(self.function, d.change(self.function), *d.rates)(x, w))
        loss = change - value if d.discrete else change
        return z, p, value, loss + self.rate * value, ca.vertcat(*after)

    @cached_property
    def values(self) -> ca.Function:
        z, p, value, rise, after = self.symbolic
        rows = [value, rise / ca.sumsqr(z)]
        if self.dynamics.discrete:
            low, high = self.dynamics.box
            out = (after - (low + high) / 2) / ((high - low) / 2)
            rows.append(ca.mmax(ca.fabs(out)) - 1)
        return ca.Function("values", [z, p], [ca.vertcat(*rows)])

    @cached_property
    def slopes(self) -> ca.Function:
        z, p, value, rise, _ = self.symbolic
        both, g = ca.vertcat(z, p), rise / ca.sumsqr(z)
        return ca.Function("slopes", [both], [value, ca.gradient(value, both), g, ca.gradient(g, both)], {"cse": True})

    def flat(self, corners: Array) -> bool:
        """Return whether V is positive definite to second order at the equilibrium, but its decrease is not."""
        z, p, value, rise, _ = self.symbolic
        hessians = ca.Function("hessians", [z, p], [ca.hessian(value, z)[0], ca.hessian(-rise, z)[0]])
        for corner in corners.T:
            of_value, of_loss = (np.asarray(h) for h in hessians(np.zeros(z.numel()), corner))
            positive = np.linalg.eigvalsh(of_value)
            if not positive.min() > _FLAT * np.abs(positive).max():
                continue
            loss, vectors = np.linalg.eigh(of_loss)
            if loss.min() < -_FLAT * np.abs(loss).max():
                return True
            # where the second order vanishes, a higher one may decide
            along = vectors[:, loss <= _FLAT * np.abs(loss).max()] * _SHORT
            for at in (*along.T, *-along.T):
                v, g = np.asarray(self.values(at, corner)).reshape(-1)[:2]
                if g * _SHORT**2 > -_FLAT * v:
                    return True
        return False


def least_level(dynamics: Dynamics, function: Node, rate: float | None = None, *, seed: int = 0) -> Falsified:
    """Search for the least level at which the claim fails that V < level is a region in which V decreases.

    Args:
        dynamics: the dynamics.
        function: V, an expression of the states.
        rate: with a number, V' ≤ −rate · V is demanded, otherwise V' < 0.
        seed: seed of the directions of the rays.

    Example:
        >>> from surctl.lyapunov import Dynamics, State
        >>> from surctl.lyapunov.falsified import least_level
        >>> from surctl.verification.formula import parse, variable
        >>> x = {"x": variable("x")}
        >>> cubic = Dynamics("cubic", "continuous", (State("x", -2.0, 2.0),), (parse("-x + x^3", x),))
        >>> least = least_level(cubic, parse("x^2", x))  # V' = 0 at |x| = 1
        >>> round(least.level, 3), least.cause, least.confirmed
        (1.0, 'decrease', True)
    """
    d = dynamics
    n = len(d.states)
    scales = np.maximum(d.box[1] - d.equilibrium, d.equilibrium - d.box[0])
    search = _Search(d, function, rate or 0.0, scales)
    u = directions(n, _RAYS if n > 1 else 2, seed=seed)
    edge = (d.box - d.equilibrium) / scales
    far = extent(np.zeros(n), edge, u)
    z = u[:, :, None] * (far[:, None] * np.linspace(_NEAREST, 1.0, _POINTS))[None]
    flat = z.reshape(n, -1)
    corners = _corners(d)
    read = [np.asarray(search.values(flat, np.repeat(p[:, None], flat.shape[1], axis=1))) for p in corners.T]
    v = read[0][0].reshape(-1, _POINTS)
    g = np.array([r[1] for r in read]).reshape(len(read), -1, _POINTS)
    if not np.all(np.isfinite(v)) or v.min() <= 0 or g[:, :, 0].max() >= 0 or search.flat(corners):
        at = np.unravel_index(np.argmin(v) if v.min() <= 0 else np.argmax(g[:, :, 0].max(axis=0)) * _POINTS, v.shape)
        least = min(float(v.min()), 0.0)
        rise = float((g[:, :, 0] * (z[:, :, 0] ** 2).sum(axis=0) / v[:, 0]).max()) if least == 0 else np.inf
        cause = "decrease" if rise > _LITTLE else "flat"
        return _at(search, z[:, at[0], at[1]], corners[:, 0], least, cause, confirmed=False)
    outcome: list[Falsified] = []
    if d.discrete:
        out = np.array([r[2] for r in read]).reshape(len(read), -1, _POINTS)
        outcome += _first(search, out >= 0, v, z, corners, "successor")
    else:
        outcome.append(_on_faces(search, v[:, -1], z[:, :, -1], edge))
    starts = _starts(g, v, z, corners)
    outcome += _first(search, g >= 0, v, z, corners, "decrease")
    outcome += [end for start in starts if (end := _descend(search, start, edge)) is not None]
    outcome = [f for f in outcome if f.confirmed]
    if not outcome:
        return Falsified(float(v.max()), {}, "none", confirmed=False)
    return min(outcome, key=lambda f: f.level)


def _corners(d: Dynamics) -> Array:
    # corners (m, C) of the parameters in [0, 1], and their middle
    count = sum(low < high for low, high in d.ranges.T)
    low, high = d.ranges
    wide = high > low
    values = (d.corners(most=4) - low[:, None]) / np.where(wide, high - low, 1.0)[:, None]
    if count > 4:
        values = np.hstack([values, np.random.default_rng(0).integers(0, 2, (len(low), _MOST_CORNERS)).astype(float)])
    return np.asarray(values)


def _starts(g: Array, v: Array, z: Array, corners: Array) -> list[Array]:
    """Return starts of local searches: points of least V where V does not decrease, or nearly, that are apart."""
    worst = g.max(axis=0)
    which = g.argmax(axis=0)
    size = np.median(np.abs(worst))
    close = worst >= -_NEARLY * size
    order = np.argsort(np.where(worst >= 0, v, np.where(close, 1.5 * v, np.inf)), axis=None)[: min(400, close.sum())]
    chosen: list[Array] = []
    for at in order:
        i, j = np.unravel_index(at, v.shape)
        start = np.concatenate([z[:, i, j], corners[:, which[i, j]]])
        if all(np.linalg.norm(start - c) > 0.15 * np.linalg.norm(start[: len(z)]) for c in chosen):
            chosen.append(start)
        if len(chosen) == _STARTS:
            break
    return chosen


def _first(search: _Search, bad: NDArray[np.bool_], v: Array, z: Array, corners: Array, cause: str) -> list[Falsified]:
    if not bad.any():
        return []
    which = bad.argmax(axis=0)
    any_bad = bad.any(axis=0)
    i, j = np.unravel_index(np.argmin(np.where(any_bad, v, np.inf)), v.shape)
    p = corners[:, which[i, j]]
    return [_outwards(search, np.asarray(z[:, i, j]), p, cause)]


def _on_faces(search: _Search, v: Array, z: Array, edge: Array) -> Falsified:
    """Return the point of least V on the faces of the box, by projected gradients from the best ray of each face."""
    from scipy.optimize import minimize

    best = np.inf, z[:, 0]
    p = np.full(len(search.dynamics.parameters), 0.5)
    n = len(z)
    size = float(v.min())  # the search's tolerances are absolute
    for side in (0, 1):
        for k in range(n):
            on = np.flatnonzero(np.abs(z[k] - edge[side, k]) < 1e-9)
            start = z[:, on[np.argmin(v[on])]] if on.size else np.where(np.arange(n) == k, edge[side, k], 0.0)
            bounds = [(edge[0, i], edge[1, i]) if i != k else (edge[side, k],) * 2 for i in range(n)]

            def value(at: Array) -> tuple[float, Array]:
                read = search.slopes(np.concatenate([at, p]))
                return float(read[0]) / size, np.asarray(read[1]).reshape(-1)[:n] / size

            run = minimize(value, start, jac=True, bounds=bounds, method="L-BFGS-B", options={"maxiter": 60})
            if float(run.fun) * size < best[0]:
                best = float(run.fun) * size, np.asarray(run.x)
    return _at(search, best[1], p, best[0], "face", confirmed=True)


def _descend(search: _Search, start: Array, edge: Array) -> Falsified | None:
    """Minimise V where V does not decrease, from a start (n + m,), with SLSQP."""
    from scipy.optimize import minimize

    n = edge.shape[1]
    m = len(start) - n
    known: dict[bytes, tuple[float, Array, float, Array]] = {}

    def read(at: Array) -> tuple[float, Array, float, Array]:
        key = at.tobytes()
        if key not in known:
            v, dv, g, dg = search.slopes(at)
            known[key] = float(v), np.asarray(dv).reshape(-1), float(g), np.asarray(dg).reshape(-1)
        return known[key]

    size = max(read(start)[0], 1e-300)
    steep = max(float(np.abs(read(start)[3]).max()), 1e-12)
    run = minimize(
        lambda at: read(at)[0] / size,
        start,
        jac=lambda at: read(at)[1] / size,
        bounds=[*zip(edge[0], edge[1], strict=True), *[(0.0, 1.0)] * m],
        constraints={"type": "ineq", "fun": lambda at: read(at)[2] / steep, "jac": lambda at: read(at)[3] / steep},
        method="SLSQP",
        options={"maxiter": 80, "ftol": 1e-8},
    )
    z, p = np.asarray(run.x[:n], dtype=float), np.clip(run.x[n:], 0, 1)
    if not np.all(np.isfinite(run.x)) or np.linalg.norm(z) < _NEAREST or read(np.asarray(run.x))[2] < -1e-4 * steep:
        return None
    return _outwards(search, np.clip(z, edge[0], edge[1]), p, "decrease")


def _outwards(search: _Search, z: Array, p: Array, cause: str) -> Falsified:
    """Return the nearest point further out on the ray at which interval arithmetic confirms the counterexample."""
    d = search.dynamics
    low, high = d.ranges
    w = low + (high - low) * p
    factors = 1 + np.array(_OUTWARDS)
    x = d.equilibrium[:, None] + search.scales[:, None] * z[:, None] * factors
    x = np.clip(x, d.box[0][:, None], d.box[1][:, None])
    if cause == "decrease":
        claim = Stability(d, search.function, 1e300, search.rate).inequalities(list(search.scales), Power(1.0, 1), None)
        excess = certain_excess(claim[-1].claim, np.vstack([x, np.repeat(w[:, None], x.shape[1], axis=1)]))
    else:
        after = d.evaluate(x, np.repeat(w[:, None], x.shape[1], axis=1))
        excess = np.max(np.maximum(after - d.box[1][:, None], d.box[0][:, None] - after), axis=0)
    fails = excess > 0
    k = int(np.argmax(fails)) if fails.any() else 0
    scaled = (x[:, k] - d.equilibrium) / search.scales
    value = float(np.asarray(search.values(scaled, p))[0, 0])
    return _at(search, scaled, p, value, cause, confirmed=bool(fails.any()))


def _at(search: _Search, z: Array, p: Array, level: float, cause: str, *, confirmed: bool) -> Falsified:
    d = search.dynamics
    low, high = d.ranges
    point = [*(d.equilibrium + search.scales * z), *(low + (high - low) * p)]
    values = {v.name: float(value) for v, value in zip(d.variables, point, strict=True)}
    return Falsified(level, values, cause, confirmed)
