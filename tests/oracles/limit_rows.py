"""Check the rows of a limit over the ranges of its symbols: names, finite rows, bounds that leave a velocity."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias, get_args

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from surctl.errors import InputError, check_count
from surctl.tasks import Kind, Limit, LimitRow
from surctl.tasks.ranges import Parameter, SampledExpressions, SymbolRanges, ranges_of
from surctl.tasks.task import as_expression
from surctl.testing.ranges import CheckFailed

Array: TypeAlias = NDArray[np.float64]

_DOTTED = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z0-9_]+)*")
_STARTS, _ROUNDS, _TRIES = 3, 40, 20  # number of starts, rounds and trial steps of the search for crossing bounds
_EMPTY = 1e-9  # actuator rows that must open by more than this velocity count as contradictory
_SWEEPS = 10
_BESIDE = 1e-3  # distance, as a velocity, between a trial point and the bound of a row
_ON = 1e-7  # trial points nearer than this to a bound are skipped


@dataclass(frozen=True)
class LimitReport:
    """Properties of a limit that passed the check.

    Attributes:
        names: names of the constraint rows of the limit.
        samples: number of points at which the constraint rows were evaluated, including corners of the ranges.
        narrowest: smallest distance upper − lower between two bounds, as a velocity; inf if no constraint row has two
            bounds. narrowest_row: the constraint row with this distance.
        compared: number of velocities at which `holds` was compared with the constraint rows.
    """

    names: tuple[str, ...]
    samples: int
    narrowest: float
    narrowest_row: str
    compared: int


def check_limit(
    limit: Limit,
    *,
    parameters: Sequence[Parameter] = (),
    holds: Callable[..., bool] | None = None,
    velocity: float = 1.0,
    samples: int = 50,
    seed: int = 0,
) -> LimitReport:
    """Check the constraint rows of a limit over the ranges of its symbols.

    The names of the constraint rows lower ≤ a·v ≤ upper on the velocity v must be unique, consist of identifiers joined
    by dots, and be the same at every call. The kinds must be known, and the shape of a must be (1, n). At random points
    and at corners of the ranges, the normal a must be finite, the bounds must not be NaN, and lower ≤ upper must hold.
    If a = 0, the bounds must include 0. For each constraint row, the check then searches for crossing bounds by random
    steps from the points with the smallest upper − lower. Some velocity must satisfy all rows of the kind actuator
    (tested by linear programming).

    Args:
        limit: any object with a method `rows()`.
        parameters: (symbol, lowest, highest) for every symbol in the constraint rows.
        holds: function that takes a velocity v (n,) and the values of the parameters, and returns whether v satisfies
            the limit as intended. The check compares this result with the constraint rows at random velocities and on
            both sides of every bound.
        velocity: largest entry of the random velocities for `holds` [m/s, rad/s].

    Raises:
        CheckFailed: a check fails; the message states the first failure and names the constraint row.
        InputError: a symbol has no range or two ranges, there are no samples, or the velocity is not positive.
    """
    check_count("samples", samples, least=1)
    if not 0.0 < velocity < math.inf:
        raise InputError("is not a speed", key="velocity", value=velocity, remedy="give a positive number")
    rows = _shaped(limit)
    ranges = ranges_of(parameters)
    check = _LimitCheck(rows, ranges, SampledExpressions("limit", ranges, _row_expressions(rows)))
    rng = np.random.default_rng(seed)
    points = np.vstack([ranges.draw(rng, samples), _corners(ranges)])
    gaps = check.gaps(points)
    for i in range(len(rows)):
        gaps = np.vstack([gaps, check.search(i, points[np.argsort(gaps[: len(points), i])[:_STARTS]], rng)])
    compared = 0
    for point in points[:samples]:
        check.together(point)
        if holds is not None:
            compared += check.compare(point, holds, rng, velocity)
    least = gaps.min(axis=0)
    narrowest = int(np.argmin(least))
    return LimitReport(
        tuple(row.name for row in rows), len(points), float(least[narrowest]), rows[narrowest].name, compared
    )


def _shaped(limit: Limit) -> tuple[LimitRow, ...]:
    # all checks that do not depend on values
    if not hasattr(limit, "rows"):
        raise CheckFailed("limit", f"is a {type(limit).__name__} without rows()")
    rows, again = tuple(limit.rows()), tuple(limit.rows())
    if not rows:
        raise CheckFailed("limit", "has no rows")
    for row in (*rows, *again):
        if not isinstance(row, LimitRow):
            raise CheckFailed("limit", f"has a row that is a {type(row).__name__}, not a LimitRow")
    if [row.name for row in rows] != [row.name for row in again]:
        raise CheckFailed("limit", "has different row names at every call")
    names: set[str] = set()
    n = max(1, int(as_expression(rows[0].a).numel())) if isinstance(rows[0].a, ca.SX) else 4
    for row in rows:
        what = f"limit row {row.name!r}"
        if not isinstance(row.name, str) or not _DOTTED.fullmatch(row.name):
            raise CheckFailed(what, "is not identifiers joined by dots")
        if row.name in names:
            raise CheckFailed(what, "occurs twice")
        names.add(row.name)
        if row.kind not in get_args(Kind):
            raise CheckFailed(what, f"has the unknown kind {row.kind!r}; known: {', '.join(get_args(Kind))}")
        for field, value, shape in (("a", row.a, (1, n)), ("lower", row.lower, (1, 1)), ("upper", row.upper, (1, 1))):
            try:
                actual = as_expression(value).shape
            except ValueError:
                raise CheckFailed(what, f"{field} is a {type(value).__name__}, not SX") from None
            if actual != shape:
                raise CheckFailed(what, f"{field} has shape {actual}, expected {shape}")
    return rows


def _row_expressions(rows: Sequence[LimitRow]) -> list[ca.SX]:
    return [ca.vertcat(*(ca.SX(getattr(row, field)) for row in rows)) for field in ("a", "lower", "upper")]


@dataclass(frozen=True)
class _LimitCheck:
    rows: Sequence[LimitRow]
    ranges: SymbolRanges
    at: SampledExpressions

    def values(self, point: Array) -> tuple[Array, Array, Array]:
        # A (m, n), lower (m,), upper (m,)
        A, lower, upper = self.at(point)
        return A, lower.reshape(-1), upper.reshape(-1)

    def gaps(self, points: Array) -> Array:
        # upper − lower (N, m), divided by ‖a‖ if a is not 0
        A, lower, upper = self.at.many(points)
        lower, upper = lower[..., 0], upper[..., 0]
        length = np.linalg.norm(A, axis=2)
        crossed = (lower > upper) | (lower == math.inf) | (upper == -math.inf)
        never = (length == 0.0) & ((lower > 0.0) | (upper < 0.0))
        for bad, problem in (
            (~np.isfinite(A).all(axis=2), "a is not finite: {a}"),
            (np.isnan(lower) | np.isnan(upper), "a bound is not a number: {low} to {high}"),
            (crossed, "allows no velocity: lower = {low}, upper = {high}"),
            (never, "requires a row of zeros to lie in {low} to {high}"),
        ):
            for k, i in np.argwhere(bad)[:1]:
                details = {"a": A[k, i].tolist(), "low": f"{lower[k, i]:.6g}", "high": f"{upper[k, i]:.6g}"}
                self._fail(i, problem.format_map(details), points[k])
        gaps: Array = (upper - lower) / np.where(length > 0.0, length, 1.0)
        return gaps

    def search(self, i: int, starts: Array, rng: np.random.Generator) -> Array:
        # random steps from each start; the step length is halved if no step helps
        best = np.full(len(self.rows), math.inf)
        span = self.ranges.high - self.ranges.low
        for start in starts if span.any() else starts[:0]:
            here, least, width = start, self.gaps(start[None, :])[0, i], 0.3
            for _ in range(_ROUNDS if math.isfinite(least) else 0):
                steps = width * span * rng.normal(size=(_TRIES, span.size))
                tried = np.clip(here + steps, self.ranges.low, self.ranges.high)
                gaps = self.gaps(tried)
                best = np.minimum(best, gaps.min(axis=0))
                k = int(np.argmin(gaps[:, i]))
                if gaps[k, i] < least:
                    here, least = tried[k], gaps[k, i]
                else:
                    width *= 0.5
        return best

    def together(self, point: Array) -> None:
        # t is the smallest distance by which all limits must open so that one velocity satisfies them
        A, lower, upper = self.values(point)
        n = A.shape[1]
        hard = np.array([row.kind == "actuator" for row in self.rows]) & A.any(axis=1)
        if hard.sum() < 2:
            return
        chosen = np.flatnonzero(hard)
        length = np.linalg.norm(A[chosen], axis=1)
        G, low, high = A[chosen] / length[:, None], lower[chosen] / length, upper[chosen] / length
        above, below = np.isfinite(high), np.isfinite(low)
        sides = np.vstack([G[above], -G[below]])
        result = linprog(
            [*[0] * n, 1],
            A_ub=np.column_stack([sides, -np.ones(len(sides))]),
            b_ub=np.concatenate([high[above], -low[below]]),
            bounds=[(None, None)] * n + [(0, None)],
        )
        size = 1.0 + float(np.abs(result.x[:n]).max()) if result.x is not None else 1.0
        if result.status == 0 and result.x[n] > _EMPTY * size:
            names = np.concatenate([chosen[above], chosen[below]])[np.abs(result.ineqlin.marginals) > _EMPTY]
            guilty = " and ".join(dict.fromkeys(self.rows[i].name for i in names))
            raise CheckFailed(
                "limit",
                f"actuator rows {guilty} contradict each other: smallest violation {result.x[n]:.3g}",
                at=self.ranges.text(point),
            )

    def compare(self, point: Array, holds: Callable[..., bool], rng: np.random.Generator, velocity: float) -> int:
        # random velocities, and velocities beside every bound
        A, lower, upper = self.values(point)
        compared = 0
        for v in self._trials(A, lower, upper, rng, velocity):
            inside = np.minimum(A @ v - lower, upper - A @ v) / np.maximum(np.linalg.norm(A, axis=1), 1e-300)
            if np.abs(inside).min() < _ON:
                continue
            compared += 1
            feasible = bool((inside > 0.0).all())
            if bool(holds(v, *self.ranges.split(point))) != feasible:
                i = int(np.argmin(inside))
                verdict = "and all others allow" if feasible else "refuses"
                text = np.array2string(v, precision=5, separator=", ")
                self._fail(i, f"{verdict} v = {text}, but holds() says otherwise", point)
        return compared

    def _trials(self, A: Array, lower: Array, upper: Array, rng: np.random.Generator, velocity: float) -> list[Array]:
        # velocities on both sides of every bound satisfy all other rows
        trials = list(rng.uniform(-velocity, velocity, (5, A.shape[1])))
        for a, *bounds in zip(A, lower, upper, strict=True):
            for bound in bounds:
                if a.any() and math.isfinite(bound):
                    v = _toward(A, lower, upper, rng.uniform(-velocity, velocity, size=(A.shape[1],)))
                    on, normal = v + a * (bound - a @ v) / (a @ a), a / np.linalg.norm(a)
                    trials += [on - _BESIDE * normal, on + _BESIDE * normal]
        return trials

    def _fail(self, i: int, problem: str, point: Array) -> None:
        raise CheckFailed(f"limit row {self.rows[i].name!r}", problem, at=self.ranges.text(point))


def _toward(A: Array, lower: Array, upper: Array, v: Array) -> Array:
    # repeated projections on violated rows (Kaczmarz); v then mostly satisfies all rows
    for _ in range(_SWEEPS):
        for a, low, high in zip(A, lower, upper, strict=True):
            if a.any():
                inset = min(2.0 * _BESIDE * float(np.linalg.norm(a)), 0.5 * (high - low))
                v = v + a * (min(max(float(a @ v), low + inset), high - inset) - a @ v) / (a @ a)
    return v


def _corners(ranges: SymbolRanges) -> Array:
    # one per row: for few entries all corners, else the lowest and the highest
    if ranges.low.size == 0:
        return np.zeros((1, 0))
    if ranges.low.size > _MOST_CORNERS:
        return np.vstack([ranges.low, ranges.high])
    ends = itertools.product(*zip(ranges.low, ranges.high, strict=True))
    return np.array(list(ends)).reshape(-1, ranges.low.size)


_MOST_CORNERS = 10  # largest number of entries for which all corners of the box are evaluated
