"""Find a barrier function by linear programs over samples, and prove it, also that solutions stay in the box."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.lyapunov.claims import Safety
from surctl.lyapunov.decide import Decision, decide_motion, prove_motion
from surctl.lyapunov.dynamics import Dynamics, exact
from surctl.lyapunov.near import inward_speeds
from surctl.lyapunov.template import Template, polynomials
from surctl.verification.formula import Node, number, values_of

# Decide a barrier claim, and whether its solutions stay in the box


_SHARE = 0.6  # of the remaining time for the stronger claim


def decide_safety(
    claim: Safety, *, time_limit: float = 60.0, seed: int = 0, progress: Callable[[str], None] | None = None
) -> Decision:
    """Decide a barrier claim, and try to prove also that the solutions stay in the box.

    The verdict is that of the claim as it stands. If the stronger claim is proved too, the decision is about it: its
    claim has `stays`. The arguments are those of `decide_motion`.
    """
    began, worked = time.perf_counter(), time.process_time()
    decision = decide_motion(claim, time_limit=time_limit, seed=seed, progress=progress)
    if decision.verdict != "proved" or claim.stays or inward_speeds(claim) is None:
        return decision
    left = max(_SHARE * (time_limit - (time.process_time() - worked)), 1.0)
    stronger = prove_motion(replace(claim, stays=True), time_limit=left, seed=seed, progress=progress)
    return replace(stronger if stronger.verdict == "proved" else decision, seconds=time.perf_counter() - began)


Array = NDArray[np.float64]

_MULTIPLIERS = (0.0, -1.0, -0.1, 1.0)
_FACTORS = (1.0, 0.5, 0.9, 0.0)  # in discrete time, B(x⁺) ≤ factor · B
_SAMPLES, _DENSE, _ROUNDS, _WORST = 400, 8192, 12, 30
_SPEED = 0.02  # share of the speed of the scaled states by which the change of B keeps clear of its bound
_LEAST = 1e-4  # least margin of a barrier whose scaled coefficients are at most 1
_MARGIN = 0.02  # margin to which a barrier is scaled


@dataclass(frozen=True, eq=False)
class BarrierResult:
    """The result of the search for a barrier function.

    Attributes:
        decision: the decision on the last claim that was tried; None if no function fits the samples.
        tried: the degrees and multipliers that were tried, in words.
    """

    decision: Decision | None
    tried: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """`proved`, or `unknown`: a search does not show that no barrier exists."""
        return "proved" if self.decision is not None and self.decision.verdict == "proved" else "unknown"


def find_barrier(
    dynamics: Dynamics,
    initial: Sequence[Node],
    unsafe: Sequence[Node],
    *,
    multiplier: float | None = None,
    degree: int = 4,
    time_limit: float = 60.0,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> BarrierResult:
    """Find a polynomial B that proves that no solution from the initial set reaches the unsafe set in the box.

    Args:
        dynamics: the dynamics.
        initial: expressions that are ≤ 0 in the initial set.
        unsafe: expressions that are ≤ 0 in the unsafe set.
        multiplier: number λ of B' ≤ λ B; by default several are tried.
        degree: largest degree of B.
        time_limit: limit of the processor time [s].
        seed: seed of the samples.
        progress: function that receives a line of progress from time to time.

    Raises:
        InputError: no sample lies in the initial or the unsafe set.

    Example:
        >>> from surctl.lyapunov import Dynamics, State, find_barrier
        >>> from surctl.verification.formula import parse, variable
        >>> x = {n: variable(n) for n in "xy"}
        >>> states = State("x", -2.0, 2.0), State("y", -2.0, 2.0)
        >>> spiral = Dynamics("spiral", "continuous", states, (parse("-x + y", x), parse("-x - y", x)))
        >>> start, bad = parse("x^2 + y^2 - 0.25", x), parse("1.5 - x", x)
        >>> find_barrier(spiral, [start], [bad], degree=2).verdict
        'proved'
    """
    until = time.process_time() + time_limit
    samples = _Samples(dynamics, tuple(initial), tuple(unsafe), seed)
    scales = np.abs(dynamics.box).max(axis=0)
    options = (_FACTORS if dynamics.discrete else _MULTIPLIERS) if multiplier is None else (multiplier,)
    decision, tried = None, []
    for k in range(1, degree + 1):
        template = polynomials(dynamics, k, scales, whole=True)
        fits = [(_fitted(template, scales, samples, option, until), option) for option in options]
        good = sorted(((fit, o) for fit, o in fits if fit is not None), key=lambda pair: -pair[0][1])
        for (coefficients, margin), option in good:
            left = until - time.process_time()
            if left <= 0:
                break
            label = f"degree {k}, {'factor' if dynamics.discrete else 'multiplier'} {option:g}"
            function = template.function(coefficients / template.sizes * (_MARGIN / margin))
            factor = None if dynamics.discrete else exact(option)
            claim = Safety(dynamics, function, tuple(initial), tuple(unsafe), factor)
            decision = decide_safety(claim, time_limit=0.5 * left, seed=seed)
            tried.append(f"{label}: {decision.verdict}")
            if progress:
                progress(f"{label}: margin {margin:.3g}, {decision.verdict} {decision.reason}")
            if decision.verdict == "proved":
                return BarrierResult(decision, tuple(tried))
        if time.process_time() > until:
            break
    return BarrierResult(decision, tuple(tried))


class _Samples:
    # samples of the initial set, the unsafe set and the box, as columns
    def __init__(self, d: Dynamics, initial: tuple[Node, ...], unsafe: tuple[Node, ...], seed: int) -> None:
        from scipy.stats import qmc

        self.dynamics = d
        self.random = np.random.default_rng(seed)
        low, high = d.box
        unit = qmc.Sobol(len(low), seed=seed).random(_DENSE).T
        wide = low[:, None] + (high - low)[:, None] * unit
        self.initial = self._inside(initial, wide, "initial")
        self.unsafe = self._inside(unsafe, wide, "unsafe")
        self.box = np.hstack([wide, self._on_faces(wide)])

    def _inside(self, constraints: tuple[Node, ...], wide: Array, name: str) -> Array:
        """Return points of a set; a small set is found by steps that shrink towards it."""
        d = self.dynamics

        def read(x: Array) -> Array:
            rows = values_of(constraints or [number(-1)], dict(zip(d.names, x, strict=True)))
            return np.asarray(np.where(np.isnan(rows), np.inf, rows).max(axis=0))

        low, high = (end[:, None] for end in d.box)
        best, values = wide, read(wide)
        radius = 0.3
        for _ in range(25):
            if (values <= 0).sum() >= _SAMPLES:
                break
            order = np.argsort(values)[:200]
            centre = best[:, order][:, self.random.integers(0, len(order), 4000)]
            fresh = np.clip(centre + radius * (high - low) * self.random.standard_normal(centre.shape), low, high)
            best = np.hstack([best[:, order], best[:, values <= 0], fresh])
            values = read(best)
            radius *= 0.7
        inside = best[:, values <= 0]
        if not inside.size:
            remedy = "widen the set, or the bounds of the states"
            raise InputError("holds no sample in the box", key=f"{d.name}.{name}", remedy=remedy)
        return inside

    def _on_faces(self, wide: Array) -> Array:
        d = self.dynamics
        part = wide[:, :: max(1, _DENSE // 1024)].copy()
        columns = np.arange(part.shape[1])
        which = self.random.integers(0, len(d.states), part.shape[1])
        part[which, columns] = d.box[self.random.integers(0, 2, part.shape[1]), which]
        return part


def _fitted(
    template: Template, scales: Array, samples: _Samples, option: float, until: float
) -> tuple[Array, float] | None:
    """Return coefficients (K,) of the scaled functions, and their margin on all samples; None if it is too small."""
    d = template.dynamics
    corners = d.corners()
    start, bad = (template.features(x, corners[:, 0])[0] for x in (samples.initial, samples.unsafe))
    flow, clear, x = [], [], samples.box
    for corner in corners.T:
        values, change = template.features(x, corner)
        flow.append(change + (1 - option) * values if d.discrete else change - option * values)
        moved = d.evaluate(x, np.repeat(corner[:, None], x.shape[1], axis=1)) - (x if d.discrete else 0.0)
        clear.append(_SPEED * np.abs(moved / scales[:, None]).max(axis=0))
    # each row a·c + b·margin ≤ 0
    rows = np.hstack([start, -bad, *flow]).T / template.sizes
    weights = np.concatenate([np.ones(start.shape[1] + bad.shape[1]), *clear])
    active = _first(samples.random, start.shape[1], bad.shape[1], len(rows) - start.shape[1] - bad.shape[1])
    for _ in range(_ROUNDS):
        if time.process_time() > until:
            return None
        outcome = _solve(rows[active], weights[active])
        if outcome is None or outcome[1] < _LEAST:
            return None
        coefficients, margin = outcome
        excess = rows @ coefficients + weights * margin * 0.5
        broken = np.flatnonzero(excess > 1e-9)
        if not broken.size:
            return coefficients, margin
        worst = broken[np.argsort(-excess[broken])][: 4 * _WORST]
        spread = samples.random.choice(broken, min(len(broken), _WORST), replace=False)
        active = np.unique(np.concatenate([active, worst[:: 4 if len(worst) > _WORST else 1], spread]))
    return None


def _first(random: np.random.Generator, *counts: int) -> NDArray[np.int_]:
    picked, begin = [], 0
    for count in counts:
        picked.append(begin + random.choice(count, min(count, _SAMPLES), replace=False))
        begin += count
    return np.concatenate(picked)


def _solve(rows: Array, weights: Array) -> tuple[Array, float] | None:
    """Return c with |c| ≤ 1 and the largest margin with rows·c + weights · margin ≤ 0."""
    from scipy.optimize import linprog

    count = rows.shape[1]
    run = linprog(
        np.append(np.zeros(count), -1.0),
        A_ub=np.column_stack([rows, weights]),
        b_ub=np.zeros(len(rows)),
        bounds=[(-1, 1)] * count + [(0, 1)],
        method="highs",
    )
    return (np.asarray(run.x[:-1]), float(run.x[-1])) if run.status == 0 else None
