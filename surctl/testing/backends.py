"""Check whether a QP backend solves min ½‖y‖² subject to lower ≤ G y ≤ upper, on problems with known solutions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, check_known, nearest
from surctl.priority import BACKENDS, solve_least_distance
from surctl.priority.backends import Kernel, KernelSolution
from surctl.testing.ranges import CheckFailed, checked_count

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Known:
    """A problem min ½‖y‖² subject to lower ≤ G y ≤ upper, together with its solution.

    Attributes:
        G: (m, d). lower, upper: (m,).
        y: (d,), the only optimum; None if no y satisfies the inequalities.
        angle: smallest angle between normals of active inequalities [rad], at most 1; a small angle amplifies errors in
            the bounds to errors in y by 1/angle.
    """

    G: Array
    lower: Array
    upper: Array
    y: Array | None
    angle: float = 1.0


def _unit(rng: np.random.Generator, count: int, size: int) -> Array:
    rows: Array = rng.normal(size=(count, size))
    unit: Array = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return unit


def _with_active(normals: Array, rng: np.random.Generator, *, idle: int = 6, free: int = 0) -> Known:
    """Return a problem with the optimum y* = −normalsᵀ·multipliers, at which the inequalities of `normals` are active.

    The signs of normals are random, and `idle` inequalities that are not active at y* are added.

    The last `free` normals have multiplier 0: their inequalities hold with equality at y* but do not affect y*.
    """
    count, size = normals.shape
    multipliers = np.append(rng.uniform(0.1, 1.0, count - free), np.zeros(free))
    y = -normals.T @ multipliers
    others = _unit(rng, idle, size)
    G = np.vstack([normals, others])
    value = G @ y
    slack = np.concatenate([np.zeros(count), rng.exponential(0.5, idle) + 1e-3])
    width = rng.exponential(1.0, len(G)) + 1e-3
    upper, lower = value + slack, np.where(rng.random(len(G)) < 0.5, value - width, -np.inf)
    side = np.where(rng.random(len(G)) < 0.5, -1.0, 1.0)  # a·y ≤ b is equivalent to −b ≤ −a·y
    turned = side < 0.0
    G, lower, upper = G * side[:, None], np.where(turned, -upper, lower), np.where(turned, -lower, upper)
    order = rng.permutation(len(G))
    return Known(G[order], lower[order], upper[order], y)


def _loose(size: int, rng: np.random.Generator) -> Known:
    # no inequality binds, so that the solution is 0
    return _with_active(np.zeros((0, size)), rng, idle=8)


def _plain(size: int, rng: np.random.Generator) -> Known:
    return _with_active(_unit(rng, int(rng.integers(1, size + 1)), size), rng)


def _equal(size: int, rng: np.random.Generator) -> Known:
    # some inequalities have equal bounds
    problem = _with_active(_unit(rng, int(rng.integers(1, size)), size), rng)
    if problem.y is None:
        return problem
    value = problem.G @ problem.y
    tight = np.minimum(problem.upper - value, value - problem.lower) < 1e-12
    return Known(problem.G, np.where(tight, value, problem.lower), np.where(tight, value, problem.upper), problem.y)


def _degenerate(size: int, rng: np.random.Generator) -> Known:
    # more inequalities at their bounds than unknowns, most of them with multiplier 0
    return _with_active(_unit(rng, 2 * size, size), rng, free=int(rng.integers(size, 2 * size)))


def _doubled(size: int, rng: np.random.Generator) -> Known:
    # some inequalities occur twice
    problem = _plain(size, rng)
    twice = rng.integers(0, len(problem.G), 4)
    side = rng.choice([-1.0, 1.0], 4)
    lower = np.where(side > 0.0, problem.lower[twice], -problem.upper[twice])
    upper = np.where(side > 0.0, problem.upper[twice], -problem.lower[twice])
    G = np.vstack([problem.G, problem.G[twice] * side[:, None]])
    return Known(G, np.concatenate([problem.lower, lower]), np.concatenate([problem.upper, upper]), problem.y)


def _parallel(size: int, rng: np.random.Generator) -> Known:
    # the normals of two active inequalities have an angle of 1e-5 to 1e-2 rad
    normals = _unit(rng, 2, size)
    angle = float(10.0 ** rng.uniform(-5, -2))
    across = normals[1] - (normals[0] @ normals[1]) * normals[0]
    normals[1] = np.cos(angle) * normals[0] + np.sin(angle) * across / np.linalg.norm(across)
    problem = _with_active(normals, rng)
    return Known(problem.G, problem.lower, problem.upper, problem.y, angle)


def _scaled(size: int, rng: np.random.Generator) -> Known:
    # the normals have lengths from 1e-3 to 1e3
    problem = _plain(size, rng)
    length = 10.0 ** rng.uniform(-3, 3, len(problem.G))
    return Known(problem.G * length[:, None], problem.lower * length, problem.upper * length, problem.y)


def _infeasible(size: int, rng: np.random.Generator) -> Known:
    # with positive weights, the normals sum to 0 and the bounds to a negative number
    count = int(rng.integers(2, size + 2))
    weights = rng.uniform(0.2, 1.0, count)
    normals = _unit(rng, count, size)
    closing = -weights[:-1] @ normals[:-1] / weights[-1]
    length = float(np.linalg.norm(closing))
    normals[-1], weights[-1] = closing / length, weights[-1] * length
    upper = rng.normal(size=count)
    upper[-1] -= (weights @ upper + rng.uniform(0.05, 1.0)) / weights[-1]
    problem = _with_active(np.zeros((0, size)), rng)
    G = np.vstack([normals, problem.G])
    lower = np.concatenate([np.full(count, -np.inf), problem.lower])
    return Known(G, lower, np.concatenate([upper, problem.upper]), None)


_MAKERS: Mapping[str, Callable[[int, np.random.Generator], Known]] = MappingProxyType(
    {
        "loose": _loose,
        "plain": _plain,
        "equal": _equal,
        "degenerate": _degenerate,
        "doubled": _doubled,
        "parallel": _parallel,
        "scaled": _scaled,
        "infeasible": _infeasible,
    }
)

BACKEND_FAMILIES = tuple(_MAKERS)
"""Kinds of problems: no row binds; random rows; equalities; more rows through the solution than unknowns; repeated
rows; nearly parallel rows; rows of length 1e-3 to 1e3; no solution."""


def draw_known(family: str, *, size: int, rng: np.random.Generator) -> Known:
    """Return one random problem of a family in `BACKEND_FAMILIES` with `size` unknowns, at least 2."""
    return _MAKERS[family](size, rng)


@dataclass(frozen=True)
class BackendReport:
    """Largest errors of a backend against the known solutions, for each family of problems, divided by 1 + max |y|.

    Attributes:
        name: name of the backend.
        problems: number of problems given to the backend for each family; the same for all families.
        error: largest |y − y*|.
        violation: largest violation of an inequality with a normal of length 1.
        gradient: largest |y + Gᵀ·multipliers|, which is 0 at the optimum.
        unsolved: number of feasible problems whose status is not "optimal".
        undetected: number of infeasible problems whose status is "optimal".
        unnamed: number of infeasible problems whose status is "failed" instead of "infeasible".
        iterations: largest number of iterations for one problem.
        findings: for each family that fails, one line about the first failed problem.
    """

    name: str
    problems: int
    error: Mapping[str, float]
    violation: Mapping[str, float]
    gradient: Mapping[str, float]
    unsolved: Mapping[str, int]
    undetected: int
    unnamed: int
    iterations: int
    findings: tuple[str, ...]

    def __str__(self) -> str:
        """Return the results as a table with one line for each family of problems."""
        lines = [f"{self.name}: {self.problems} problems per family, at most {self.iterations} iterations"]
        lines += [f"{'family':<12} {'error':>9} {'violation':>9} {'gradient':>9} {'unsolved':>8}"]
        lines += [
            f"{family:<12} {self.error[family]:>9.1e} {self.violation[family]:>9.1e} "
            f"{self.gradient[family]:>9.1e} {self.unsolved[family]:>8}"
            for family in self.error
        ]
        return "\n".join([*lines, f"infeasible: {self.undetected} undetected, {self.unnamed} only failed"])


def check_backend(
    backend: str | Kernel,
    *,
    families: Sequence[str] = BACKEND_FAMILIES,
    problems: int = 100,
    size: int = 4,
    tol: float = 1e-8,
    seed: int = 0,
) -> BackendReport:
    """Run `measure_backend`, and raise CheckFailed with the first finding if there is a finding.

    Example:
        >>> from surctl.testing import check_backend
        >>> report = check_backend("daqp", families=["plain", "infeasible"], problems=20)
        >>> report.problems, dict(report.unsolved), report.undetected, report.error["plain"] < 1e-8
        (20, {'plain': 0}, 0, True)
    """
    report = measure_backend(backend, families=families, problems=problems, size=size, tol=tol, seed=seed)
    if report.findings:
        raise CheckFailed(f"backend {report.name}", report.findings[0])
    return report


def measure_backend(
    backend: str | Kernel,
    *,
    families: Sequence[str] = BACKEND_FAMILIES,
    problems: int = 100,
    size: int = 4,
    tol: float = 1e-8,
    seed: int = 0,
) -> BackendReport:
    """Measure the errors of a backend on problems with known solutions, so that no reference solver is needed.

    A feasible problem is constructed from its solution: random normals (rows of G) and multipliers ≥ 0 give the
    solution y* = −Gᵀ·multipliers; then the bounds are chosen so that the active ones hold with equality at y* and all
    others with a margin. An infeasible problem is constructed so that a sum of its inequalities, with weights ≥ 0, is a
    contradiction (Farkas).

    Args:
        backend: a name in `BACKENDS`, called as surctl calls it (rows scaled, solution polished and checked); or a
            solver function, called directly, that takes G (m, d), lower (m,), upper (m,) and returns a
            `KernelSolution`.
        tol: largest accepted error, violation and gradient, relative to 1 + max |y*|; in the family "parallel" the
            accepted error of y is tol divided by the angle between the normals.

    Raises:
        InputError: an unknown backend or family, no problems, fewer than 2 unknowns, or a tolerance that is not
            positive.

    Example:
        >>> from surctl.testing import measure_backend
        >>> report = measure_backend("daqp", families=["plain", "parallel"], problems=20)
        >>> dict(report.unsolved), report.findings, report.error["plain"] < 1e-12
        ({'plain': 0, 'parallel': 0}, (), True)
    """
    checked_count("problems", problems)
    checked_count("size", size, least=2)
    if not 0.0 < tol < math.inf:
        raise InputError("is not a tolerance", key="tol", value=tol, remedy="give a positive number")
    if isinstance(families, str) or not families:
        raise InputError("is not a list of names", key="families", value=families, remedy=nearest("", BACKEND_FAMILIES))
    for family in families:
        check_known(family, BACKEND_FAMILIES, "no such family", key="families")
    name, kernel = _named_kernel(backend)
    rng = np.random.default_rng(seed)
    by_family = {
        family: [_judged(kernel, draw_known(family, size=size, rng=rng), tol) for _ in range(problems)]
        for family in families
    }
    solvable = {family: marks for family, marks in by_family.items() if family != "infeasible"}
    empty = by_family.get("infeasible", [])
    return BackendReport(
        name=name,
        problems=problems,
        error=_worst(solvable, "error"),
        violation=_worst(solvable, "violation"),
        gradient=_worst(solvable, "gradient"),
        unsolved=MappingProxyType({f: sum(m.status != "optimal" for m in marks) for f, marks in solvable.items()}),
        undetected=sum(mark.status == "optimal" for mark in empty),
        unnamed=sum(mark.status == "failed" for mark in empty),
        iterations=max((mark.iterations for marks in by_family.values() for mark in marks), default=0),
        findings=tuple(
            f"{family} problem {k}: {mark.finding}"
            for family, marks in by_family.items()
            for k, mark in [next(((k, m) for k, m in enumerate(marks) if m.finding), (0, None))]
            if mark is not None
        ),
    )


@dataclass(frozen=True)
class _Mark:
    # `finding` is "" if the backend passes
    status: str
    finding: str
    iterations: int = 0
    error: float = 0.0
    violation: float = 0.0
    gradient: float = 0.0


def _named_kernel(backend: str | Kernel) -> tuple[str, Kernel]:
    if callable(backend):
        return getattr(backend, "__name__", type(backend).__name__), backend
    if not isinstance(backend, str) or backend not in BACKENDS:
        remedy = nearest(str(backend), BACKENDS)
        raise InputError("no such QP backend", key="backend", value=backend, remedy=remedy)

    def solve(G: Array, lower: Array, upper: Array) -> KernelSolution:
        solution = solve_least_distance(np.zeros(G.shape[1]), A=G, lower=lower, upper=upper, backend=backend)
        return KernelSolution(solution.x, solution.multipliers, solution.iterations, solution.status)

    return backend, solve


def _judged(kernel: Kernel, problem: Known, tol: float) -> _Mark:
    G, lower, upper = problem.G.copy(), problem.lower.copy(), problem.upper.copy()
    try:
        result: object = kernel(G, lower, upper)
    except Exception as error:  # a backend may raise any exception, and every one is a finding
        return _Mark("failed", f"raised {type(error).__name__}: {error}")
    if not isinstance(result, KernelSolution) or not isinstance(result.iterations, int | np.integer):
        return _Mark("failed", f"returned {result!r:.60}, not a KernelSolution with a whole number of iterations")
    if not all(map(np.array_equal, (G, lower, upper), (problem.G, problem.lower, problem.upper))):
        return _Mark(result.status, "changed its own arguments")
    if result.status not in ("optimal", "infeasible", "failed"):
        return _Mark("failed", f"has the unknown status {result.status!r}")
    if problem.y is None:
        wrong = result.status == "optimal"
        return _Mark(result.status, "has no solution, but its status is optimal" if wrong else "", result.iterations)
    if result.status != "optimal":
        return _Mark(result.status, f"has a solution, but its status is {result.status}", result.iterations)
    return _compared(result, problem, problem.y, tol)


def _compared(result: KernelSolution, problem: Known, known: Array, tol: float) -> _Mark:
    d, m = known.size, problem.lower.size
    if result.y is None:
        return _Mark("failed", "has status optimal, but no y")
    try:
        y, multipliers = np.asarray(result.y, dtype=np.float64), np.asarray(result.multipliers, dtype=np.float64)
    except (TypeError, ValueError):
        return _Mark("failed", "y or the multipliers are not numbers")
    if np.shape(y) != (d,) or np.shape(multipliers) != (m,):
        return _Mark("failed", f"y has shape {np.shape(y)}, but the multipliers have {np.shape(multipliers)}")
    if not (np.isfinite(y).all() and np.isfinite(multipliers).all()):
        return _Mark("failed", "y or a multiplier is not finite")
    size, length = 1.0 + float(np.abs(known).max()), np.linalg.norm(problem.G, axis=1)
    value = problem.G @ y
    error = float(np.abs(y - known).max()) / size
    violation = float((np.maximum(problem.lower - value, value - problem.upper) / length).max(initial=0.0)) / size
    gradient = float(np.abs(y + problem.G.T @ multipliers).max()) / size
    away = np.where(multipliers > 0.0, problem.upper - value, value - problem.lower) / length
    strong = np.abs(multipliers) * length > tol * size
    loose = float(np.where(strong, away, 0.0).max(initial=0.0)) / size
    finding = ""
    for wrong, allowed, text in (
        (violation, tol, "a row is violated by"),
        (error, tol / problem.angle, "y is wrong by"),
        (gradient, tol, "y + G'·multipliers is off by"),
        (
            loose,
            tol / problem.angle,
            "a multiplier is nonzero for a row, or the side of a row, that is away from its bound by",
        ),
    ):
        if not wrong <= allowed and not finding:
            finding = f"{text} {wrong:.2g}, allowed {allowed:.2g}"
    return _Mark("optimal", finding, result.iterations, error, max(violation, 0.0), gradient)


def _worst(by_family: Mapping[str, Sequence[_Mark]], field: str) -> Mapping[str, float]:
    return MappingProxyType({f: max((getattr(m, field) for m in marks), default=0.0) for f, marks in by_family.items()})
