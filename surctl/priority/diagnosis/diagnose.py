"""Diagnosis of a task stack over a region of poses: equality of NSB and strict priority, conflicts, rank losses.

The diagnosis is computed once, before a run, from the symbolic Jacobians of the tasks. Findings from identities of the
expressions hold for all poses; findings from samples and local searches are labelled as such.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.priority.diagnosis.field import (
    TOLERANCE,
    Field,
    Measure,
    Values,
    best_of,
    build_field,
    commutator_norms,
    commuting_levels,
    descend,
    directions,
    freedom,
    orthogonal_pairs,
    outside_sines,
    pair_angles,
    projector_above,
    remaining_sine,
    smallest_angle,
    task_strength,
)
from surctl.priority.diagnosis.findings import (
    Bounds,
    Diagnosis,
    Equality,
    LevelReport,
    Met,
    Pair,
    PairKind,
    Parameter,
    Residual,
    Singularity,
    Symptom,
    Verdict,
    build_region,
)
from surctl.priority.settings import CUTOFF, ZERO_ROW
from surctl.tasks import Stack

Array: TypeAlias = NDArray[np.float64]


def strict_velocities(jacobians: Sequence[Array], references: Sequence[Array]) -> Array:
    """Return the velocity v (..., n) of strict priority for each sample (Siciliano and Slotine 1991).

    Level i with Jacobian J_i and desired rate x_i changes v to v + (J_i N)⁺(x_i − J_i v), where N is the projector on
    the null space of all levels above.

    Singular values of J_i N up to `CUTOFF`·‖J_i‖ count as 0. So near poses where a task becomes dependent on the tasks
    above it, v stays bounded but jumps.

    Args:
        jacobians: J (..., k, n) of each level, highest priority first, finite.
        references: x (..., k) of each level [unit of σ per second], finite.
    """
    n = jacobians[0].shape[-1]
    N = np.eye(n)
    v = np.zeros(n)
    for J, x in zip(jacobians, references, strict=True):
        least = np.maximum(CUTOFF * _size(J), ZERO_ROW)
        v = v + _pulled(J @ N, x - _times(J, v), least)
        N = N - _span(J @ N, least)
    return v


def nsb_velocities(jacobians: Sequence[Array], references: Sequence[Array]) -> Array:
    """Return the velocity (..., n) of the NSB law, equation (16) of the paper, for each sample.

    The law is computed by w ← w + J_i⁺(x_i − J_i w) from the lowest level to the highest. The arguments are those of
    `strict_velocities`.
    """
    w = np.zeros(jacobians[0].shape[-1])
    for J, x in zip(reversed(jacobians), reversed(references), strict=True):
        w = w + _pulled(J, x - _times(J, w), np.maximum(CUTOFF * _size(J), ZERO_ROW))
    return w


def residual_norms(jacobians: Sequence[Array], references: Sequence[Array], v: Array) -> Array:
    """Return the residual ‖J_i v − x_i‖ of each level i for each sample, (..., levels) [unit of σ per second]."""
    return np.stack(
        [np.linalg.norm(_times(J, v) - x, axis=-1) for J, x in zip(jacobians, references, strict=True)], axis=-1
    )


def _pulled(J: Array, y: Array, least: Array) -> Array:
    """Return the product J⁺y (..., n); singular values of J up to `least` (..., 1) count as 0."""
    left, s, right = np.linalg.svd(J, full_matrices=False)
    significant = s > least
    share = np.where(significant, np.einsum("...ka,...k->...a", left, y), 0.0) / np.where(significant, s, 1.0)
    pulled: Array = np.einsum("...an,...a->...n", right, share)
    return pulled


def _span(J: Array, least: Array) -> Array:
    """Return the projector J⁺J (..., n, n); singular values of J up to `least` count as 0."""
    _, s, right = np.linalg.svd(J, full_matrices=False)
    rows = right * (s > least)[..., None]
    projector: Array = np.swapaxes(rows, -1, -2) @ rows
    return projector


def _size(J: Array) -> Array:
    size: Array = np.linalg.norm(J, 2, axis=(-2, -1))[..., None]
    return size


def _times(J: Array, v: Array) -> Array:
    product: Array = np.einsum("...kn,...n->...k", J, v)
    return product


@dataclass(frozen=True, eq=False)
class _Survey:
    """The samples of a diagnosis, with the settings of the local searches that start from these samples.

    Attributes:
        field: the stack, compiled over its region.
        unit: (N, f), the samples in coordinates that scale each of the f free variables to 0 … 1.
        points: (N, d), the samples as values of all d variables of the region.
        values: Jacobians and desired rates of all tasks at the samples.
        threshold: a pose whose measure is at most this number counts as singular.
        starts: largest number of local searches for one measure.
    """

    field: Field
    unit: Array
    points: Array
    values: Values
    threshold: float
    starts: int

    def search(self, measure: Measure) -> list[tuple[Array, float]]:
        """Return final point (d,) and measure of each local search from the best samples, smallest measure first."""
        chosen = best_of(measure(self.values), self.unit, most=self.starts)
        return sorted((descend(self.field, measure, self.unit[k]) for k in chosen), key=lambda end: end[1])


def _task_rank(values: Values, i: int) -> int:
    """Return the largest rank of the Jacobian of level i over the samples."""
    return int(directions(values.jacobians[i]).rank.max())


def _gained_rank(values: Values, i: int) -> int:
    """Return the largest number, over the samples, of directions that level i adds to the row space above it."""
    return int(np.count_nonzero(freedom(values, i) > TOLERANCE, axis=1).max())


def _find_singularities(survey: _Survey) -> tuple[Singularity, ...]:
    """Return the kinematic and algorithmic singularities of every level, in order of priority."""
    singularities: list[Singularity] = []
    for i in range(len(survey.field.names)):
        for symptom, measure in _own(survey, i).items():
            singularities += _singularity(survey, i, symptom, measure, lambda point: True)
        gained = _gained_rank(survey.values, i) if i else 0
        if gained:
            sine = remaining_sine(i, gained=gained, rank=_task_rank(survey.values, i))
            singularities += _singularity(survey, i, "sine", sine, partial(_regular, survey, i))
    return tuple(singularities)


def _own(survey: _Survey, i: int) -> dict[Symptom, Measure]:
    """Return the two measures of a singularity of task i alone, by symptom; empty if task i is never active."""
    rank = _task_rank(survey.values, i)
    if rank == 0:
        return {}
    sizes = np.linalg.norm(survey.values.jacobians[i], 2, axis=(1, 2))
    strength = task_strength(i, rank=rank, size=float(np.median(sizes[sizes > 0.0])))
    return {"strength": strength, "turning": lambda values: values.turning[i]}


def _regular(survey: _Survey, i: int, point: Array) -> bool:
    here = survey.field.at(point[None])
    return all(measure(here)[0] > survey.threshold for measure in _own(survey, i).values())


def _singularity(
    survey: _Survey, i: int, symptom: Symptom, measure: Measure, counts: Callable[[Array], bool]
) -> list[Singularity]:
    ends = [end for end in survey.search(measure) if end[1] <= survey.threshold and counts(end[0])]
    if not ends:
        return []
    poses = tuple(survey.field.region.pose(point) for point in _apart(survey, [point for point, _ in ends]))
    return [
        Singularity(
            task=survey.field.names[i],
            kind="algorithmic" if symptom == "sine" else "kinematic",
            symptom=symptom,
            value=ends[0][1],
            poses=poses,
            also_singular=tuple(survey.field.names[j] for j in range(i) if not _regular(survey, j, ends[0][0])),
            share=float(np.mean(measure(survey.values) <= survey.threshold)),
        )
    ]


def _apart(survey: _Survey, points: list[Array]) -> list[Array]:
    region = survey.field.region
    width = np.where(region.upper > region.lower, region.upper - region.lower, 1.0)
    distinct: list[Array] = []
    for point in points:
        if all(np.linalg.norm((point - other) / width) > 0.01 for other in distinct):
            distinct.append(point)
    return distinct


_MET = 1e-6  # residuals up to this, relative to 1 + ‖x‖ + ‖J‖‖v‖, count as rounding


def diagnose(
    stack: Stack,
    region: Bounds,
    *,
    parameters: Sequence[Parameter] = (),
    samples: int = 1024,
    seed: int = 0,
    threshold: float = 1e-3,
    starts: int = 4,
) -> Diagnosis:
    """Analyse how NSB and strict priority handle this task stack over a region of poses.

    The function evaluates the tasks at scrambled Sobol samples of the region, then starts local searches from the worst
    samples.

    Args:
        stack: the tasks, each with one desired value (replace a set-based task by the task at its bound).
        region: lower and upper bounds of the pose η, (4,) each [m, m, m, rad], in the earth frame {E}.
        parameters: (symbol, lower bound, upper bound) of every other symbol in the Jacobians or desired rates.
        samples: number of samples, at least 1; rounded up to a power of two.
        seed: seed of the samples; the same seed gives the same diagnosis.
        threshold: a pose counts as singular if one of three numbers is below this threshold: the sine of an angle
            between row spaces, a singular value relative to its usual size, or the step [m or rad] that may reverse a
            Jacobian row.
        starts: largest number of local searches for each quantity, at least 1.

    Raises:
        InputError: the region or a parameter is invalid (see `build_region`), a symbol has no bounds, a number is out
            of range, or a task is set-based or not finite at a sample. The message names the symbol or the task.
    """
    _check_numbers(samples, threshold, starts, seed)
    box = build_region(stack, region, parameters)
    field = build_field(stack, box)
    unit = box.sample(samples, seed)
    points = box.place(unit)
    values = field.at(points)
    field.require_finite(values, points)
    survey = _Survey(field, unit, points, values, threshold, starts)
    return Diagnosis(
        tasks=stack.names,
        region={n: (float(a), float(b)) for n, a, b in zip(box.names, box.lower, box.upper, strict=True)},
        samples=len(points),
        seed=seed,
        threshold=threshold,
        equality=_equality(stack, survey),
        pairs=_pairs(stack, survey),
        singularities=_find_singularities(survey),
        levels=_levels(survey),
    )


def _check_numbers(samples: int, threshold: float, starts: int, seed: int) -> None:
    for name, value, least in (("samples", samples, 1), ("starts", starts, 1), ("seed", seed, 0)):
        if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
            raise InputError(f"must be a whole number of at least {least}", key=name, value=value, remedy="such as 4")
    if not isinstance(threshold, float | int | np.floating) or not 0.0 < threshold < 1.0:
        raise InputError("must be between 0 and 1", key="threshold", value=threshold, remedy="such as 1e-3")


def _equality(stack: Stack, survey: _Survey) -> Equality:
    """Test whether NSB equals strict priority: on the expressions, then on samples, then by local searches."""
    structural = commuting_levels(stack)
    norms = commutator_norms(survey.values.jacobians)
    largest: dict[str, float] = {}
    places: dict[str, Array] = {}
    searches = 0
    for i, name in enumerate(stack.names):
        worst = int(norms[:, i].argmax())
        largest[name], places[name] = (0.0 if structural[i] else float(norms[worst, i])), survey.points[worst]
        if largest[name] > TOLERANCE:
            ends = survey.search(partial(_commuting, i))
            places[name], largest[name] = ends[0][0], 1.0 - ends[0][1]
            searches += len(ends)
    task = max(largest, key=largest.__getitem__)
    differs = largest[task] > TOLERANCE
    return Equality(
        verdict="differs" if differs else "everywhere" if all(structural) else "on all samples",
        largest=largest[task],
        task=task if differs else None,
        where=survey.field.region.pose(places[task]) if differs else None,
        by_task=largest,
        structural=tuple(name for name, shown in zip(stack.names, structural, strict=True) if shown),
        searches=searches,
    )


def _commuting(i: int, values: Values) -> Array:
    # never negative: for 4 velocities the norm is at most 1
    closeness: Array = 1.0 - commutator_norms(values.jacobians)[:, i]
    return closeness


def _pairs(stack: Stack, survey: _Survey) -> tuple[Pair, ...]:
    orthogonal = orthogonal_pairs(stack)
    return tuple(_pair(stack, survey, i, j, (i, j) in orthogonal) for i, j in combinations(range(len(stack.tasks)), 2))


def _pair(stack: Stack, survey: _Survey, i: int, j: int, structural: bool) -> Pair:
    J = survey.values.jacobians
    first, second = directions(J[i]), directions(J[j])
    sine, cosine = pair_angles(first, second)
    active = np.isfinite(sine)
    angles = np.arctan2(sine, cosine)[active]
    smallest = where = None
    if angles.size:
        at = int(np.flatnonzero(active)[angles.argmin()])
        smallest, where = float(angles.min()), survey.points[at]
        if smallest > TOLERANCE and cosine[active].max() > TOLERANCE:
            where, _ = survey.search(smallest_angle(i, j))[0]
            smallest = _angle_at(survey, i, j, where)
    shared = second.rank - np.count_nonzero(outside_sines(second, first.projector) > TOLERANCE, axis=1)
    return Pair(
        first=stack.names[i],
        second=stack.names[j],
        kind=_pair_kind(sine[active], cosine[active], smallest, survey.threshold, structural),
        smallest=smallest,
        largest=float(angles.max()) if angles.size else None,
        where=None if where is None else survey.field.region.pose(where),
        shared=int(shared.max()),
        structural=structural,
        equal=_pair_equal(Stack((stack.tasks[i], stack.tasks[j])), [J[i], J[j]]),
    )


def _angle_at(survey: _Survey, i: int, j: int, point: Array) -> float:
    here = survey.field.at(point[None]).jacobians
    sine, cosine = pair_angles(directions(here[i]), directions(here[j]))
    return float(np.arctan2(sine[0], cosine[0]))


def _pair_kind(sine: Array, cosine: Array, smallest: float | None, threshold: float, structural: bool) -> PairKind:
    if smallest is None:
        return "never active together"
    if structural or cosine.max() <= TOLERANCE:
        return "orthogonal"
    if sine.max() <= TOLERANCE:
        return "dependent everywhere"
    return "dependent somewhere" if np.sin(smallest) <= threshold else "independent"


def _pair_equal(pair: Stack, jacobians: list[Array]) -> Verdict:
    if all(commuting_levels(pair)):
        return "everywhere"
    return "differs" if commutator_norms(jacobians).max() > TOLERANCE else "on all samples"


def _levels(survey: _Survey) -> tuple[LevelReport, ...]:
    J, x = survey.values.jacobians, survey.values.references
    strict, nsb = strict_velocities(J, x), nsb_velocities(J, x)
    left_strict, left_nsb = residual_norms(J, x, strict), residual_norms(J, x, nsb)
    return tuple(
        _level(
            survey, i, left_strict[:, i], left_nsb[:, i], (_tolerance(J[i], x[i], strict), _tolerance(J[i], x[i], nsb))
        )
        for i in range(len(J))
    )


def _tolerance(J: Array, x: Array, v: Array) -> Array:
    size = np.linalg.norm(J, 2, axis=(1, 2)) * np.linalg.norm(v, axis=1)
    tolerance: Array = _MET * (1.0 + np.linalg.norm(x, axis=1) + size)
    return tolerance


def _level(survey: _Survey, i: int, strict: Array, nsb: Array, tolerances: tuple[Array, Array]) -> LevelReport:
    met: Met = "by neither law"
    if (strict <= tolerances[0]).all():
        met = "by both laws" if (nsb <= tolerances[1]).all() else "by strict priority only"
    above = np.rint(np.trace(projector_above(survey.values, i), axis1=1, axis2=2)).astype(int)
    return LevelReport(
        task=survey.field.names[i],
        rank=_task_rank(survey.values, i),
        gained=_gained_rank(survey.values, i),
        rank_above=int(above.max()),
        exhausted=float(np.mean(above == survey.values.jacobians[i].shape[-1])),
        strict=_residual(survey, strict),
        nsb=_residual(survey, nsb),
        met=met,
        unit=survey.field.units[i],
    )


def _residual(survey: _Survey, residuals: Array) -> Residual:
    worst = int(residuals.argmax())
    return Residual(
        float(np.median(residuals)), float(residuals[worst]), survey.field.region.pose(survey.points[worst])
    )
