"""The least level of a Lyapunov function at which a counterexample exists, found by the falsifier in shrinking boxes.

The falsifier searches the least V where a condition of the claim fails. It is then run again in the smallest box around
the region below that level, in which its samples are denser.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from surctl.errors import EmptyDomain
from surctl.lyapunov.claims import Inequality, inequality
from surctl.lyapunov.dynamics import Dynamics, Range, exact
from surctl.lyapunov.near import bends
from surctl.lyapunov.rays import directions, extent, farthest, hugged
from surctl.verification.falsifier import search, sobol
from surctl.verification.formula import Node, number, power, variable
from surctl.verification.proving import certain_excess

Array = NDArray[np.float64]

_SAMPLES = 2048
_INSIDE, _ON_FACE = (_SAMPLES, 4), (64, 1)  # samples and starts of a search; on a face, V has no other condition
_ROUNDS, _LOWER, _MARGIN = 5, 0.999, 1.05  # searches; a level that counts as lower; level of the next box
_TRIED = 24  # points of a search that may be confirmed
_RAYS, _MOST_CORNERS = 1024, 16
_FEW_RAYS, _ALONG, _NEARER = 256, np.linspace(0.04, 1.0, 25), 0.3  # for a simulated period
_NEAREST = 0.004  # least relative distance from the equilibrium
_FLAT = 1e-8  # eigenvalues below this share of the largest one count as 0
_LITTLE = 1e-9  # share of V by which it may grow close to the equilibrium by rounding
_SHORT = 0.05  # length of a step along directions without a decrease of second order
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


def least_level(dynamics: Dynamics, function: Node, rate: float | None = None, *, seed: int = 0) -> Falsified:
    """Search for the least level at which the claim fails that V < level is a region in which V decreases.

    Args:
        dynamics: the dynamics.
        function: V, an expression of the states.
        rate: with a number, V' ≤ −rate · V is demanded, otherwise V' < 0.
        seed: seed of the samples.

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
    falsifier = _Falsifier(dynamics, function, rate or 0.0, seed)
    close = falsifier.close()
    if close is not None:
        return close
    outcome = falsifier.successors() if dynamics.discrete else falsifier.faces()
    least, around = min(outcome, key=lambda f: f.level, default=None), dynamics
    for _ in range(_ROUNDS):
        if least is not None:
            around = hugged(dynamics, function, _MARGIN * least.level)
        trial = falsifier.decrease(around)
        if trial is None or (least is not None and trial.level >= _LOWER * least.level):
            break
        least = trial
    return Falsified(float(falsifier.values.max()), {}, "none", confirmed=False) if least is None else least


def least_held_level(dynamics: Dynamics, function: Node, share: float, *, seed: int = 0) -> Falsified:
    """Search on rays for the least V at which V does not decrease over a simulated control period, or on a face.

    Args:
        dynamics: the dynamics, with their sampling.
        function: V, a quadratic form about the equilibrium.
        share: share of V that must be lost in a period.
        seed: seed of the rays.
    """
    d, n, value = dynamics, len(dynamics.states), dynamics.compiled(function)
    level = float(((d.freedom / farthest(d, function, 1.0)) ** 2).min())
    least = Falsified(level, {}, "face", confirmed=True)
    centre, spread = np.zeros(n), 1.0  # of rays; `directions` loads scipy.stats, which takes longer than this search
    for _ in range(_ROUNDS):
        rays = centre[:, None] + spread * np.random.default_rng(seed).normal(size=(n, _FEW_RAYS))
        step = d.freedom[:, None] * rays
        step *= extent(d.equilibrium, d.box, step)
        steps = (step[:, :, None] * _ALONG).reshape(n, -1)
        x = d.equilibrium[:, None] + steps
        v, worst = np.asarray(value(x, d.ranges.mean(axis=0))).ravel(), None
        for w in d.corners(most=4).T:
            fails = np.asarray(value(d.held(x, w), w)).ravel() >= (1 - share) * v
            at = int(np.argmin(np.where(fails, v, np.inf)))
            if fails[at] and v[at] < least.level:
                names, worst = [v.name for v in d.variables], steps[:, at] / d.freedom
                values = dict(zip(names, [*x[:, at].tolist(), *w.tolist()], strict=True))
                least = Falsified(float(v[at]), values, "decrease", confirmed=False)
        if worst is None:
            break
        # the next rays are near the worst point
        centre, spread = worst / np.linalg.norm(worst), spread * _NEARER
    return least


def least_where(dynamics: Dynamics, function: Node, reached: Node, *, floor: float = 0.0, seed: int = 0) -> float:
    """Return the least V ≥ `floor` that is found in the box where an expression is ≥ 0; inf if there is none.

    Args:
        dynamics: the dynamics.
        function: V, an expression of the states.
        reached: the expression.
        floor: lower bound of V.
        seed: seed of the samples.
    """
    n, least, around, value = len(dynamics.states), np.inf, dynamics, dynamics.compiled(function)
    for _ in range(_ROUNDS):
        domain = [-reached, exact(floor) - function]
        points = _points(inequality("V", around.variables, -function, number(0), domain), *_INSIDE, seed)
        level = float(value(points[:n, 0], points[n:, 0])) if points.size else np.inf
        if not level < _LOWER * least:
            break
        least, around = level, hugged(dynamics, function, _MARGIN * level)
    return least


def _points(one: Inequality, samples: int, starts: int, seed: int) -> Array:
    """Return points (n + m, N) of the domain of an inequality −V ≤ 0, that of the least V first; none if none."""
    quick = replace(one.claim, exact=None)  # in doubles: interval arithmetic may confirm the points
    try:
        return search(quick, samples=samples, starts=starts, seed=seed).points
    except EmptyDomain:
        return np.zeros((len(one.variables), 0))


class _Falsifier:
    def __init__(self, dynamics: Dynamics, function: Node, rate: float, seed: int) -> None:
        d = dynamics
        self.dynamics, self.function, self.rate, self.seed = d, function, rate, seed
        self.scales = np.maximum(d.box[1] - d.equilibrium, d.equilibrium - d.box[0])
        change = d.change(function)
        self.rise = (change - function if d.discrete else change) + exact(rate) * function
        self.read = d.compiled(function, self.rise)
        low, high = d.box[:, :, None]
        self.values, self.paces = self._at(low + (high - low) * sobol(len(low), _SAMPLES, seed))

    def _at(self, x: Array, w: Array | None = None) -> tuple[Array, Array]:
        """Return V (N,) and (V' + rate V)/|z|² (N,) at states x (n, N), with z in relative distances from x*."""
        d = self.dynamics
        values, rises = np.asarray(self.read(x, d.ranges.mean(axis=0) if w is None else w))
        return values, rises / (((x - d.equilibrium[:, None]) / self.scales[:, None]) ** 2).sum(axis=0)

    def close(self) -> Falsified | None:
        """Return the counterexample if V is not positive in the box, or does not decrease close to the equilibrium."""
        d, n = self.dynamics, len(self.dynamics.states)
        corners, (low, high) = d.corners(most=4), d.ranges
        if (low < high).sum() > 4:
            share = np.random.default_rng(0).integers(0, 2, (len(low), _MOST_CORNERS))
            corners = np.hstack([corners, low[:, None] + (high - low)[:, None] * share])
        step = self.scales[:, None] * directions(n, _RAYS if n > 1 else 2, seed=self.seed)
        step *= _NEAREST * extent(d.equilibrium, d.box, step)
        x = d.equilibrium[:, None] + step
        read = [self._at(x, corner) for corner in corners.T]
        v, pace = read[0][0], np.max([pace for _, pace in read], axis=0)
        least = min(float(v.min()), float(self.values.min()), 0.0)
        if np.isfinite(self.values).all() and v.min() > 0 and least == 0 and pace.max() < 0 and not self._flat(corners):
            return None
        at = int(np.argmin(v) if v.min() <= 0 else np.argmax(pace))
        rise = float((pace * (step**2 / self.scales[:, None] ** 2).sum(axis=0) / v).max()) if least == 0 else np.inf
        cause = "decrease" if rise > _LITTLE else "flat"
        return self._counterexample(np.concatenate([x[:, at], corners[:, 0]]), cause, confirmed=False, level=least)

    def _flat(self, corners: Array) -> bool:
        """Return whether V is positive definite to second order at the equilibrium, but its decrease is not."""
        d, hessians = self.dynamics, bends(self.dynamics, self.function, self.rate, self.scales)
        for corner in corners.T:
            of_value, of_rise = (np.asarray(h) for h in hessians(np.zeros(len(d.states)), corner))
            positive = np.linalg.eigvalsh(of_value)
            if not positive.min() > _FLAT * np.abs(positive).max():
                continue
            loss, vectors = np.linalg.eigh(-of_rise)
            if loss.min() < -_FLAT * np.abs(loss).max():
                return True
            # where the second order vanishes, a higher one may decide
            along = vectors[:, loss <= _FLAT * np.abs(loss).max()] * _SHORT
            x = d.equilibrium[:, None] + self.scales[:, None] * np.hstack([along, -along])
            values, paces = self._at(x, corner)
            if np.any(paces * _SHORT**2 > -_FLAT * values):
                return True
        return False

    def faces(self) -> list[Falsified]:
        """Return the point of least V on each face of the box."""
        d = self.dynamics
        whole = inequality("V on a face", d.states, -self.function, number(0), [])
        faces = [whole.on(s.name, end) for s in d.states for end in (s.lower, s.upper)]
        points = [np.append(_points(face, *_ON_FACE, self.seed)[:, 0], d.ranges.mean(axis=0)) for face in faces]
        return [self._counterexample(x, "face", confirmed=True) for x in points]

    def successors(self) -> list[Falsified]:
        """Return points of least V where the successor leaves the box."""
        d = self.dynamics
        ends = [
            inside / exact(size)
            for s, after, size in zip(d.states, d.rates, self.scales, strict=True)
            for inside in (exact(s.upper) - after, after - exact(s.lower))
        ]
        outcome = [self._outwards(d.variables, inside, [], "successor") for inside in ends]
        return [f for f in outcome if f is not None]

    def decrease(self, around: Dynamics) -> Falsified | None:
        """Return a point of least V in a box where V does not decrease."""
        apart = zip(around.states, self.scales, strict=True)
        parts = [power((variable(s.name) - number(s.rest)) / exact(size), 2) for s, size in apart]
        square = sum(parts[1:], parts[0])
        pace = exact(float(np.nanmedian(np.abs(self.paces))) or 1.0)
        near = number(Fraction(repr(_NEAREST**2))) - square
        return self._outwards(around.variables, -self.rise / square / pace, [near], "decrease")

    def _outwards(
        self, variables: Sequence[Range], holds: Node, domain: Sequence[Node], cause: str
    ) -> Falsified | None:
        """Return a point of least V where `holds` < 0, as interval arithmetic confirms there or a little outwards."""
        d, n = self.dynamics, len(self.dynamics.states)
        sought = inequality(cause, variables, -self.function, number(0), [holds, *domain])
        least = _points(sought, *_INSIDE, self.seed)
        points = np.repeat(least[:, :_TRIED], len(_OUTWARDS), axis=1)
        away = (points[:n] - d.equilibrium[:, None]) * (1 + np.resize(_OUTWARDS, points.shape[1]))
        points[:n] = np.clip(d.equilibrium[:, None] + away, *d.box[:, :, None])
        fails = certain_excess(inequality(cause, d.variables, number(0), holds, []).claim, points) > 0
        return self._counterexample(points[:, int(np.argmax(fails))], cause, confirmed=True) if fails.any() else None

    def _counterexample(self, point: Array, cause: str, *, confirmed: bool, level: float | None = None) -> Falsified:
        n = len(self.dynamics.states)
        value = float(self._at(point[:n, None])[0][0]) if level is None else level
        names = [v.name for v in self.dynamics.variables]
        return Falsified(value, dict(zip(names, point.tolist(), strict=True)), cause, confirmed)
