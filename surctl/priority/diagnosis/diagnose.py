"""Diagnosis of a task stack over a region of poses: equality of NSB and strict priority, conflicts, rank losses.

The diagnosis is computed once, before a run, from the symbolic Jacobians of the tasks. Findings from identities of the
expressions hold for all poses; findings from samples and local searches are labelled as such.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import combinations
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.priority.diagnosis.angles import outside_sines, pair_angles, projector_above, smallest_angle
from surctl.priority.diagnosis.commutator import TOLERANCE, commutator_norms, directions
from surctl.priority.diagnosis.field import Values, build_field
from surctl.priority.diagnosis.findings import Equality, LevelReport, Met, Pair, PairKind, Residual, Verdict
from surctl.priority.diagnosis.outcomes import nsb_velocities, residual_norms, strict_velocities
from surctl.priority.diagnosis.region import Bounds, Parameter, build_region
from surctl.priority.diagnosis.result import Diagnosis
from surctl.priority.diagnosis.singularities import Survey, find_singularities, gained_rank, task_rank
from surctl.priority.diagnosis.structure import commuting_levels, orthogonal_pairs
from surctl.tasks import Stack

__all__ = ["diagnose"]

Array: TypeAlias = NDArray[np.float64]

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
    survey = Survey(field, unit, points, values, threshold, starts)
    return Diagnosis(
        tasks=stack.names,
        region={n: (float(a), float(b)) for n, a, b in zip(box.names, box.lower, box.upper, strict=True)},
        samples=len(points),
        seed=seed,
        threshold=threshold,
        equality=_equality(stack, survey),
        pairs=_pairs(stack, survey),
        singularities=find_singularities(survey),
        levels=_levels(survey),
    )


def _check_numbers(samples: int, threshold: float, starts: int, seed: int) -> None:
    for name, value, least in (("samples", samples, 1), ("starts", starts, 1), ("seed", seed, 0)):
        if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
            raise InputError(f"must be a whole number of at least {least}", key=name, value=value, remedy="such as 4")
    if not isinstance(threshold, float | int | np.floating) or not 0.0 < threshold < 1.0:
        raise InputError("must be between 0 and 1", key="threshold", value=threshold, remedy="such as 1e-3")


def _equality(stack: Stack, survey: Survey) -> Equality:
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


def _pairs(stack: Stack, survey: Survey) -> tuple[Pair, ...]:
    orthogonal = orthogonal_pairs(stack)
    return tuple(_pair(stack, survey, i, j, (i, j) in orthogonal) for i, j in combinations(range(len(stack.tasks)), 2))


def _pair(stack: Stack, survey: Survey, i: int, j: int, structural: bool) -> Pair:
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


def _angle_at(survey: Survey, i: int, j: int, point: Array) -> float:
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


def _levels(survey: Survey) -> tuple[LevelReport, ...]:
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


def _level(survey: Survey, i: int, strict: Array, nsb: Array, tolerances: tuple[Array, Array]) -> LevelReport:
    met: Met = "by neither law"
    if (strict <= tolerances[0]).all():
        met = "by both laws" if (nsb <= tolerances[1]).all() else "by strict priority only"
    above = np.rint(np.trace(projector_above(survey.values, i), axis1=1, axis2=2)).astype(int)
    return LevelReport(
        task=survey.field.names[i],
        rank=task_rank(survey.values, i),
        gained=gained_rank(survey.values, i),
        rank_above=int(above.max()),
        exhausted=float(np.mean(above == survey.values.jacobians[i].shape[-1])),
        strict=_residual(survey, strict),
        nsb=_residual(survey, nsb),
        met=met,
        unit=survey.field.units[i],
    )


def _residual(survey: Survey, residuals: Array) -> Residual:
    worst = int(residuals.argmax())
    return Residual(
        float(np.median(residuals)), float(residuals[worst]), survey.field.region.pose(survey.points[worst])
    )
