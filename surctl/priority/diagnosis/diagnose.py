"""Diagnosis of a task stack over a region: equality of NSB and strict priority, conflicts, residuals, rank losses.

The diagnosis is computed once, before a run, at samples of the configuration η and by local searches from the worst
samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations, pairwise
from typing import Literal, NamedTuple, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, check_count
from surctl.ir.symbolic import on_columns
from surctl.priority.diagnosis.laws import (
    TOLERANCE,
    commutator_norms,
    nsb_velocities,
    projector_above,
    row_vectors,
    strict_velocities,
    times,
)
from surctl.priority.settings import ZERO_ROW
from surctl.tasks import Stack
from surctl.tasks.ranges import Parameter, ranges_of
from surctl.tasks.task import is_pose

Array: TypeAlias = NDArray[np.float64]


class Values(NamedTuple):
    """Jacobians and desired rates of all tasks of a stack at N configurations.

    Attributes:
        jacobians: Jacobians (N, k, n) of each task. references: desired values (N, k) of σ̇ [unit of σ per second].
        turning: length (N,) of a step in η that may reverse a row a of ∂σ/∂η, for each task: the smallest ‖a‖/‖∂a/∂η‖,
            inf if no row changes. It goes to 0 at a point such as the one from which a distance is measured.
    """

    jacobians: list[Array]
    references: list[Array]
    turning: list[Array]


Measure: TypeAlias = Callable[[Values], Array]
"""A function that returns one non-negative number (N,) for each configuration; inf or NaN where it is undefined."""


class _Survey:
    """A stack as a function of the free variables of its region, scaled to 0 … 1, and its samples."""

    def __init__(
        self,
        stack: Stack,
        region: tuple[ArrayLike, ArrayLike],
        parameters: Sequence[Parameter],
        samples: int,
        seed: int,
    ) -> None:
        from scipy.stats import qmc

        pose = is_pose(stack.eta, stack.tasks[0].mapping)
        if not isinstance(region, tuple | list) or len(region) != 2:
            raise InputError("is not (lower, upper)", key="region", value=region)
        ranges = ranges_of([(stack.eta, *region), *parameters])
        names = [str(entry) for entry in ca.vertsplit(ranges.vector)]
        self.names = ["x", "y", "z", "psi", *names[4:]] if pose else names
        self.lower, self.upper = ranges.low, ranges.high
        free = np.flatnonzero(self.upper > self.lower)
        self.free, self.sizes, self.n = free, [task.size for task in stack.tasks], stack.velocities
        world = [ca.jacobian(task.sigma, stack.eta) for task in stack.tasks]
        turns = pose or stack.tasks[0].mapping.is_constant()
        self.constant = [turns and A.is_constant() for A in world]  # so are all commutators, in a frame that turns
        parts = []
        for (J, x), A, task in zip(stack.levels(), world, stack.tasks, strict=True):
            ranges.check(f"task {task.name}", [J, x])
            change = [ca.sumsqr(ca.jacobian(A[i, :], stack.eta)) for i in range(task.size)]
            parts += [ca.vec(J.T), x, ca.sum2(A**2), *change]
        self.run = on_columns(ca.Function("field", [ranges.vector], [ca.densify(ca.vertcat(*parts))]))
        self.unit = np.zeros((1, 0))
        if free.size:
            self.unit = qmc.Sobol(free.size, seed=seed).random_base2(math.ceil(math.log2(samples)))
        self.values = self.at(self.unit)
        for name, matrix, rate in zip(stack.names, self.values.jacobians, self.values.references, strict=True):
            broken = np.flatnonzero(~(np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(rate).all(axis=1)))
            if broken.size:
                where = _text(self.where(self.unit[broken[0]]))
                raise InputError(f"is not finite at {where}", key=f"task {name}", remedy="exclude that point")

    def points(self, unit: Array) -> Array:
        """Return the values (N, d) of all variables for scaled free variables (N, f)."""
        points = np.tile(self.lower, (len(unit), 1))
        points[:, self.free] += unit * (self.upper - self.lower)[self.free]
        return np.asarray(np.clip(points, self.lower, self.upper))

    def where(self, unit: Array) -> dict[str, float]:
        """Return the values of all variables by name."""
        return dict(zip(self.names, self.points(unit[None])[0].tolist(), strict=True))

    def at(self, unit: Array) -> Values:
        """Evaluate all tasks for scaled free variables (N, f)."""
        columns, values = self.run(self.points(unit).T)[0].T, Values([], [], [])
        ends = np.cumsum([0, *((self.n + 3) * k for k in self.sizes)])
        for k, (start, end) in zip(self.sizes, pairwise(ends), strict=True):
            J, x, square, change = np.split(columns[:, start:end], [self.n * k, self.n * k + k, self.n * k + 2 * k], 1)
            values.jacobians.append(J.reshape(-1, k, self.n))
            values.references.append(x)
            moves = (change > 0.0) & (square > 0.0)
            ratio = np.where(moves, square, np.inf) / np.where(moves, change, 1.0)
            values.turning.append(np.sqrt(ratio.min(axis=1)))
        return values

    def search(self, measure: Measure, starts: int) -> tuple[Array, float]:
        """Return the scaled free variables at which local searches from the best samples end lowest, and the measure.

        A search uses L-BFGS-B with finite differences on the squared measure, because a distance or a sine that reaches
        0 is not smooth there, but its square is.
        """
        from scipy.optimize import minimize

        at_samples = measure(self.values)
        order = np.argsort(np.where(np.isnan(at_samples), np.inf, at_samples), kind="stable")
        best, least = self.unit[order[0]], float(at_samples[order[0]])
        apart = 0.1 * math.sqrt(self.free.size)
        chosen: list[Array] = []
        for k in order:
            if len(chosen) == starts or not np.isfinite(at_samples[k]) or at_samples[k] == 0.0 or not self.free.size:
                break
            if all(np.linalg.norm(self.unit[k] - other) > apart for other in chosen):
                chosen.append(self.unit[k])
        for start in chosen:
            slope = partial(self._slope, measure, float(self._value(measure, start[None])[0]))
            bounds, options = [(0.0, 1.0)] * start.size, {"maxiter": 60, "ftol": 1e-18, "gtol": 1e-12}
            end = minimize(slope, start, jac=True, bounds=bounds, method="L-BFGS-B", options=options).x
            value = float(self._value(measure, end[None])[0])
            if value < least:
                best, least = end, value
        return best, least

    def _value(self, measure: Measure, unit: Array) -> Array:
        """Return the measure (N,); inf where it or a Jacobian is not finite."""
        values = self.at(unit)
        finite = np.logical_and.reduce([np.isfinite(J).all(axis=(1, 2)) for J in values.jacobians])
        cleaned = [np.where(finite[:, None, None], J, 0.0) for J in values.jacobians]
        measured = measure(values._replace(jacobians=cleaned))
        return np.where(finite & ~np.isnan(measured), measured, np.inf)

    def _slope(self, measure: Measure, scale: float, u: Array) -> tuple[float, Array]:
        # where the measure is undefined it is capped at a value just high enough to shorten a step that ends there
        steps = 1e-7 * np.eye(u.size)
        around = np.clip(np.vstack([u[None], u + steps, u - steps]), 0.0, 1.0)
        values = np.minimum((self._value(measure, around) / scale) ** 2, 2.0)
        ahead, behind = np.split(values[1:], 2)
        width = np.diagonal(around[1 : u.size + 1] - around[u.size + 1 :])
        return float(values[0]), (ahead - behind) / width


def _text(where: Mapping[str, float]) -> str:
    units = {"x": " m", "y": " m", "z": " m", "psi": " rad"}
    return ", ".join(f"{name} = {value:.4g}{units.get(name, '')}" for name, value in where.items())


@dataclass(frozen=True)
class Equality:
    """Whether NSB equals strict priority.

    Attributes:
        verdict: everywhere: for all configurations, because all Jacobians are constant. on all samples: no difference
            was found, which is not a proof. differs: a configuration with a difference was found.
        largest: the largest commutator norm found; see `commutator_norms`. task, where: its level and configuration, or
            None if NSB equals strict priority.
    """

    verdict: Literal["everywhere", "on all samples", "differs"]
    largest: float
    task: str | None = None
    where: Mapping[str, float] | None = None

    def __str__(self) -> str:
        """Return the finding as a sentence."""
        if self.where is not None:
            at = _text(self.where)
            return f"NSB differs from strict priority at `{self.task}`: commutator {self.largest:.2g} at {at}."
        proof = (
            "." if self.verdict == "everywhere" else f" (largest commutator {self.largest:.1g}), which is not a proof."
        )
        return f"NSB equals strict priority {self.verdict}{proof}"


@dataclass(frozen=True)
class Pair:
    """The angle between the row spaces of two tasks.

    Attributes:
        first: name of the task with the higher priority. second: name of the other task.
        kind: orthogonal: at 90 degrees at all samples. dependent everywhere: a common direction at all samples.
            dependent somewhere: a common direction at some configuration, within the threshold. coupled: none of these.
            never active together: one of the two row spaces is empty at every sample.
        smallest, largest: smallest and largest value of the smallest principal angle [rad]. `smallest` comes from a
            search, `largest` from samples. where: the configuration at which the angle is `smallest`. None if the tasks
            are never active together.
    """

    first: str
    second: str
    kind: Literal["orthogonal", "coupled", "dependent somewhere", "dependent everywhere", "never active together"]
    smallest: float | None = None
    largest: float | None = None
    where: Mapping[str, float] | None = None

    def __str__(self) -> str:
        """Return the finding as a sentence."""
        both = f"`{self.first}` and `{self.second}`"
        if self.smallest is None or self.largest is None or self.where is None:
            return f"{both} are never active together."
        if self.kind == "orthogonal":
            return f"{both} are orthogonal: neither disturbs the other."
        if self.kind == "dependent everywhere":
            return f"{both} share a direction everywhere."
        least, most = (f"{math.degrees(angle):.3g}°" for angle in (self.smallest, self.largest))
        what = "are coupled" if self.kind == "coupled" else "nearly share a direction at some configurations"
        return f"{both} {what}: angle between {least} and {most}, smallest at {_text(self.where)}."


@dataclass(frozen=True)
class Singularity:
    """Where a level loses rank.

    Attributes:
        task: name of the task.
        kind: `algorithmic` if a direction of the task lies in the row space of the tasks above, although its own
            Jacobian has its usual rank; `kinematic` if the Jacobian itself loses rank, or has no limit there.
        value: the smallest value found. algorithmic: sine of the angle to the row space of the tasks above. kinematic:
            a singular value relative to the median of ‖J‖, or the step that may reverse a row of J.
        where: the configuration with this value.
        also_singular: tasks of higher priority whose own Jacobians are singular there.
    """

    task: str
    kind: Literal["algorithmic", "kinematic"]
    value: float
    where: Mapping[str, float]
    also_singular: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Return the finding as a sentence."""
        at = _text(self.where)
        if self.kind == "kinematic":
            return f"`{self.task}` is singular by itself (kinematic singularity, {self.value:.2g}) near {at}."
        cause = "".join(f", where `{name}` is singular itself" for name in self.also_singular[:1])
        return (
            f"`{self.task}` loses a direction to the tasks above it{cause} (algorithmic singularity, sine "
            f"{self.value:.2g}): the velocity of strict priority is unbounded near {at}."
        )


@dataclass(frozen=True)
class LevelReport:
    """How well one level is met.

    Attributes:
        task: name of the task. unit: unit of the residuals, for example "m/s"; "" if the task has none.
        rank: largest rank of the task's Jacobian among the samples.
        gained: largest number, among the samples, of directions that the task adds to the row space of the tasks above.
        strict, nsb: median and largest residual ‖J v − x‖ over the samples with strict priority and with the NSB law,
            equation (16) of the paper.
        met: which of the two laws meets the task at all samples.
    """

    task: str
    unit: str
    rank: int
    gained: int
    strict: tuple[float, float]
    nsb: tuple[float, float]
    met: Literal["by both laws", "by strict priority only", "by neither law"]

    def __str__(self) -> str:
        """Return the finding as a sentence."""
        strict, nsb = (
            f"{median:.2g} (median) to {most:.2g} {self.unit}".rstrip() for median, most in (self.strict, self.nsb)
        )
        text = f"`{self.task}` is met {self.met}"
        if self.met == "by strict priority only":
            text += f": NSB leaves {nsb}"
        elif self.met == "by neither law":
            text += f": strict priority leaves {strict}, NSB leaves {nsb}"
        shared = self.rank - self.gained
        why = f"; it shares {shared} of {self.rank} directions with the tasks above it" if shared else ""
        return f"{text}{why if self.rank else '; it is inactive at all samples'}."


@dataclass(frozen=True)
class Diagnosis:
    """All findings on a task stack over a region; `explain` (or `str`) returns them as sentences.

    Attributes:
        samples: number of samples. seed: seed of the samples.
        equality, pairs, singularities, levels: the findings of each kind.
    """

    samples: int
    seed: int
    equality: Equality
    pairs: tuple[Pair, ...]
    singularities: tuple[Singularity, ...]
    levels: tuple[LevelReport, ...]

    def explain(self) -> str:
        """Return all findings as text, one sentence per line, and a last line on how the numbers were computed."""
        end = f"These results rest on {self.samples} samples (seed {self.seed}) and local searches from the worst ones."
        return "\n".join(map(str, (self.equality, *self.pairs, *self.singularities, *self.levels, end)))

    def __str__(self) -> str:
        """Return the text of `explain`."""
        return self.explain()


def diagnose(
    stack: Stack,
    region: tuple[ArrayLike, ArrayLike],
    *,
    parameters: Sequence[Parameter] = (),
    samples: int = 1024,
    seed: int = 0,
    threshold: float = 1e-3,
    starts: int = 4,
) -> Diagnosis:
    """Analyse how NSB and strict priority handle this task stack over a region.

    The function evaluates the tasks at scrambled Sobol samples of the region, then starts local searches from the worst
    samples.

    Args:
        stack: the tasks, each with one desired value (replace a set-based task by the task at its bound).
        region: lower and upper bounds of the configuration η, as many as it has entries; (4,) each [m, m, m, rad] for
            the pose of a vehicle in the earth frame {E}.
        parameters: (symbol, lower bound, upper bound) of every other symbol in the Jacobians or desired rates.
        samples: number of samples, at least 1; rounded up to a power of two.
        seed: seed of the samples; the same seed gives the same diagnosis.
        threshold: a configuration counts as singular if one of three numbers is below this threshold: the sine of an
            angle between row spaces, a singular value relative to its usual size, or the step in η that may reverse a
            Jacobian row.
        starts: largest number of local searches for each quantity, at least 1.

    Raises:
        InputError: the region or a parameter is invalid, a symbol has no bounds, a number is out of range, or a task is
            set-based or not finite at a sample. The message names the symbol or the task.
    """
    for name, value, least in (("samples", samples, 1), ("starts", starts, 1), ("seed", seed, 0)):
        check_count(name, value, least=least)
    if not isinstance(threshold, float | int | np.floating) or not 0.0 < threshold < 1.0:
        raise InputError("must be between 0 and 1", key="threshold", value=threshold, remedy="such as 1e-3")
    survey = _Survey(stack, region, parameters, samples, seed)
    return Diagnosis(
        samples=len(survey.unit),
        seed=seed,
        equality=_equality(stack, survey, starts),
        pairs=tuple(_pair(stack, survey, i, j, threshold, starts) for i, j in combinations(range(len(stack.tasks)), 2)),
        singularities=tuple(_singularities(stack, survey, threshold, starts)),
        levels=_levels(stack, survey),
    )


def _equality(stack: Stack, survey: _Survey, starts: int) -> Equality:
    """Compare NSB with strict priority on samples, then by local searches."""
    norms = commutator_norms(survey.values.jacobians).max(axis=0)
    worst = int(norms.argmax())
    if norms[worst] <= TOLERANCE:
        return Equality("everywhere" if all(survey.constant) else "on all samples", float(norms[worst]))
    ends = {i: survey.search(partial(_commuting, i), starts) for i, norm in enumerate(norms) if norm > TOLERANCE}
    task = min(ends, key=lambda i: ends[i][1])
    norm = float(commutator_norms(survey.at(ends[task][0][None]).jacobians)[0, task])
    return Equality("differs", norm, stack.names[task], survey.where(ends[task][0]))


def _commuting(i: int, values: Values) -> Array:
    norms = commutator_norms(values.jacobians)[:, i]
    return np.asarray(1.0 / np.maximum(norms, TOLERANCE))


def _angle(i: int, j: int, values: Values) -> tuple[Array, Array]:
    """Return sine and cosine (N,) of the smallest principal angle of two row spaces; NaN where one is empty.

    Sine and cosine are computed independently (Björck and Golub 1973), so the angle is accurate near 0° and near 90°.
    """
    first, second = row_vectors(values.jacobians[i]), row_vectors(values.jacobians[j])
    P, own = first.projector, second.projector
    last = np.maximum(second.rank - 1, 0)[..., None]
    sine = np.take_along_axis(_sines(own, P), last, axis=-1)[..., 0]
    cosine = np.minimum(np.linalg.norm(own @ P, 2, axis=(-2, -1)), 1.0)
    none = (second.rank == 0) | (first.rank == 0)
    return np.where(none, np.nan, sine), np.where(none, np.nan, cosine)


def _sines(own: Array, P: Array) -> Array:
    """Return the sines (N, n), largest first, of the principal angles between the ranges of two projectors."""
    return np.asarray(np.minimum(np.linalg.svd(own @ (np.eye(P.shape[-1]) - P), compute_uv=False), 1.0))


def _pair(stack: Stack, survey: _Survey, i: int, j: int, threshold: float, starts: int) -> Pair:
    names = stack.names[i], stack.names[j]
    sine, cosine = _angle(i, j, survey.values)
    active = np.flatnonzero(np.isfinite(sine))
    if active.size == 0:
        return Pair(*names, "never active together")
    angles = np.arctan2(sine, cosine)
    at = active[angles[active].argmin()]
    smallest, where = float(angles[at]), survey.unit[at]
    if smallest > TOLERANCE and cosine[active].max() > TOLERANCE:
        where, _ = survey.search(lambda values: _angle(i, j, values)[0], starts)
        smallest = float(np.arctan2(*_angle(i, j, survey.at(where[None])))[0])
    kind: Literal["orthogonal", "coupled", "dependent somewhere", "dependent everywhere"] = "coupled"
    if cosine[active].max() <= TOLERANCE:
        kind = "orthogonal"
    elif sine[active].max() <= TOLERANCE:
        kind = "dependent everywhere"
    elif math.sin(smallest) <= threshold:
        kind = "dependent somewhere"
    return Pair(*names, kind, smallest, float(angles[active].max()), survey.where(where))


def _gained(values: Values, i: int) -> Array:
    """Return the sines (N, n) of the principal angles between the row space of level i and that of all levels above."""
    return _sines(row_vectors(values.jacobians[i]).projector, projector_above(values.jacobians, i))


def _singularities(stack: Stack, survey: _Survey, threshold: float, starts: int) -> list[Singularity]:
    """Return the kinematic and algorithmic singularities of every level, in order of priority."""
    singularities: list[Singularity] = []
    own: list[Measure] = []
    for i, name in enumerate(stack.names):
        J = survey.values.jacobians[i]
        rank, sizes = int(row_vectors(J).rank.max()), np.linalg.norm(J, 2, axis=(1, 2))
        own.append(partial(_weakness, i, rank, float(np.median(sizes[sizes > 0.0])) if rank else 1.0))
        unit, value = survey.search(own[i], starts)
        if rank and value <= threshold:
            singularities.append(Singularity(name, "kinematic", value, survey.where(unit)))
        gained = int(np.count_nonzero(_gained(survey.values, i) > TOLERANCE, axis=1).max()) if i else 0
        if gained:
            unit, value = survey.search(partial(_remaining, i, own[i], gained, threshold), starts)
            here = survey.at(unit[None])
            if value <= threshold:
                also = tuple(stack.names[j] for j in range(i) if own[j](here)[0] <= threshold)
                singularities.append(Singularity(name, "algorithmic", value, survey.where(unit), also))
    return singularities


def _weakness(i: int, rank: int, size: float, values: Values) -> Array:
    """Return the smaller of singular value number `rank` of task i, relative to its usual size, and of its turning."""
    s = np.linalg.svd(values.jacobians[i], compute_uv=False)
    return np.where(s[:, 0] > ZERO_ROW, np.minimum(s[:, max(rank - 1, 0)] / size, values.turning[i]), np.inf)


def _remaining(i: int, own: Measure, gained: int, threshold: float, values: Values) -> Array:
    """Return the least sine of the directions that level i usually adds; inf where it is singular itself."""
    strength = own(values)
    return np.where(np.isfinite(strength) & (strength > threshold), _gained(values, i)[:, gained - 1], np.inf)


def _levels(stack: Stack, survey: _Survey) -> tuple[LevelReport, ...]:
    J, x = survey.values.jacobians, survey.values.references
    reports = []
    for i, task in enumerate(stack.tasks):
        residuals, met = [], []
        for law in (strict_velocities, nsb_velocities):
            v = law(J, x)
            left = np.linalg.norm(times(J[i], v) - x[i], axis=-1)
            size = np.linalg.norm(J[i], 2, axis=(1, 2)) * np.linalg.norm(v, axis=1) + np.linalg.norm(x[i], axis=1)
            met.append(bool((left <= 1e-6 * (1.0 + size)).all()))
            residuals.append((float(np.median(left)), float(left.max())))
        reports.append(
            LevelReport(
                task.name,
                task.rate_unit,
                rank=int(row_vectors(J[i]).rank.max()),
                gained=int(np.count_nonzero(_gained(survey.values, i) > TOLERANCE, axis=1).max()),
                strict=residuals[0],
                nsb=residuals[1],
                met="by neither law" if not met[0] else "by both laws" if met[1] else "by strict priority only",
            )
        )
    return tuple(reports)
