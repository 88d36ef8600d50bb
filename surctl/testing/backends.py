"""Whether a QP backend solves min ½‖y‖² subject to lower ≤ G y ≤ upper, on problems whose answers are known."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.priority import BACKENDS, solve_least_distance
from surctl.priority.kernels import Kernel, KernelSolution
from surctl.testing.finding import CheckFailed
from surctl.testing.known import BACKEND_FAMILIES, Known, draw_known
from surctl.testing.ranges import checked_count

__all__ = ["BACKEND_FAMILIES", "BackendReport", "check_backend", "measure_backend"]

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class BackendReport:
    """How far a backend is from the known answers. Errors are relative to 1 + max |y|; worst over a family.

    Attributes:
        name: of the backend.
        problems: solved in each family.
        error: largest |y − y*|.
        violation: largest miss of a row of length 1.
        gradient: largest |y + Gᵀ·multipliers|.
        unsolved: problems with a solution that were not answered "optimal".
        undetected: problems without one that were.
        unnamed: problems without one that were answered "failed" instead of "infeasible".
        iterations: most of a problem.
        findings: one line a family that does not pass, its first problem.
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
        """A table: one line a family."""
        lines = [f"{self.name}: {self.problems} problems a family, at most {self.iterations} iterations"]
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
    """As `measure_backend`; CheckFailed with the first finding, if there is one.

    Example:
        >>> from surctl.testing import check_backend
        >>> report = check_backend("own", families=["plain", "infeasible"], problems=20)
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
    """Solve problems that are made from their answers, so that no other solver is needed to judge.

    A problem is drawn backwards from its optimality conditions: normals, multipliers ≥ 0 and the bound at which each
    acts; y* = −Gᵀ·multipliers; bounds through y* there, and room elsewhere. One without a solution is drawn from
    weights ≥ 0 under which the rows sum to 0 and the bounds to less (Farkas).

    Args:
        backend: a name in `BACKENDS`, which is asked as the toolkit asks it (rows scaled, answer polished and
            checked); or a kernel, (G (m, d), lower (m,), upper (m,)) → Answer, which is asked as it is.
        families: names in `BACKEND_FAMILIES`.
        problems: in each family.
        size: d, number of unknowns.
        tol: largest error, violation and gradient that pass, relative to 1 + max |y*|; y may be wrong by tol over
            the angle between the rows of the family "parallel".
        seed: of numpy's PCG64.

    Raises:
        InputError: unknown backend or family; no problems, less than 2 unknowns, a tolerance that is not positive.

    Example:
        >>> from surctl.testing import measure_backend
        >>> report = measure_backend("daqp", families=["plain", "parallel"], problems=20)
        >>> dict(report.unsolved), report.findings, report.error["plain"] < 1e-12
        ({'plain': 0, 'parallel': 0}, (), True)
    """
    checked_count("problems", problems)
    checked_count("size", size, least=2)
    if not 0.0 < tol < math.inf:
        raise InputError("is no tolerance", key="tol", value=tol, remedy="give a positive number")
    if isinstance(families, str) or not families:
        raise InputError("is no list of families", key="families", value=families, remedy=nearest("", BACKEND_FAMILIES))
    for family in families:
        if family not in BACKEND_FAMILIES:
            raise InputError("no such family", key="families", value=family, remedy=nearest(family, BACKEND_FAMILIES))
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
    """One problem's judgement; finding is "" when it passes."""

    status: str
    finding: str
    iterations: int = 0
    error: float = 0.0
    violation: float = 0.0
    gradient: float = 0.0


def _named_kernel(backend: str | Kernel) -> tuple[str, Kernel]:
    """A name to tell, and the kernel."""
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
    """Solve and judge one problem; whatever the kernel raises is a finding."""
    G, lower, upper = problem.G.copy(), problem.lower.copy(), problem.upper.copy()
    try:
        result: object = kernel(G, lower, upper)
    except Exception as error:  # a backend may raise anything; here it is what we are after
        return _Mark("failed", f"raised {type(error).__name__}: {error}")
    if not isinstance(result, KernelSolution) or not isinstance(result.iterations, int | np.integer):
        return _Mark("failed", f"gave {result!r:.60}, not an Answer with a whole number of iterations")
    if not all(map(np.array_equal, (G, lower, upper), (problem.G, problem.lower, problem.upper))):
        return _Mark(result.status, "changed its own arguments")
    if result.status not in ("optimal", "infeasible", "failed"):
        return _Mark("failed", f"has the unknown status {result.status!r}")
    if problem.y is None:
        wrong = result.status == "optimal"
        return _Mark(result.status, "no y exists, but it is called optimal" if wrong else "", result.iterations)
    if result.status != "optimal":
        return _Mark(result.status, f"has a solution, but is called {result.status}", result.iterations)
    return _compared(result, problem, problem.y, tol)


def _compared(result: KernelSolution, problem: Known, known: Array, tol: float) -> _Mark:
    d, m = known.size, problem.lower.size
    if result.y is None:
        return _Mark("failed", "is called optimal, but there is no y")
    try:
        y, multipliers = np.asarray(result.y, dtype=np.float64), np.asarray(result.multipliers, dtype=np.float64)
    except (TypeError, ValueError):
        return _Mark("failed", "y or the multipliers are not numbers")
    if np.shape(y) != (d,) or np.shape(multipliers) != (m,):
        return _Mark("failed", f"y has shape {np.shape(y)}, multipliers {np.shape(multipliers)}")
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
        (violation, tol, "a row is missed by"),
        (error, tol / problem.angle, "y is wrong by"),
        (gradient, tol, "y + G'·multipliers is off by"),
        (
            loose,
            tol / problem.angle,
            "a multiplier stands on a row, or a side of it, that is off its bound by",
        ),
    ):
        if not wrong <= allowed and not finding:
            finding = f"{text} {wrong:.2g}, allowed {allowed:.2g}"
    return _Mark("optimal", finding, result.iterations, error, max(violation, 0.0), gradient)


def _worst(by_family: Mapping[str, Sequence[_Mark]], field: str) -> Mapping[str, float]:
    return MappingProxyType({f: max((getattr(m, field) for m in marks), default=0.0) for f, marks in by_family.items()})
