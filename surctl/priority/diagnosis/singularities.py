"""Search for poses at which a task loses rank by itself (kinematic) or because of the tasks above it (algorithmic)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.diagnosis.angles import freedom, remaining_sine, task_strength
from surctl.priority.diagnosis.commutator import TOLERANCE, directions
from surctl.priority.diagnosis.field import Field, Measure, Values, best_of, descend
from surctl.priority.diagnosis.findings import Singularity, Symptom

__all__ = ["Survey", "find_singularities", "gained_rank", "task_rank"]

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Survey:
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


def task_rank(values: Values, i: int) -> int:
    """Return the largest rank of the Jacobian of level i over the samples."""
    return int(directions(values.jacobians[i]).rank.max())


def gained_rank(values: Values, i: int) -> int:
    """Return the largest number, over the samples, of directions that level i adds to the row space above it."""
    return int(np.count_nonzero(freedom(values, i) > TOLERANCE, axis=1).max())


def find_singularities(survey: Survey) -> tuple[Singularity, ...]:
    """Return the kinematic and algorithmic singularities of every level, in order of priority."""
    singularities: list[Singularity] = []
    for i in range(len(survey.field.names)):
        for symptom, measure in _own(survey, i).items():
            singularities += _singularity(survey, i, symptom, measure, lambda point: True)
        gained = gained_rank(survey.values, i) if i else 0
        if gained:
            sine = remaining_sine(i, gained=gained, rank=task_rank(survey.values, i))
            singularities += _singularity(survey, i, "sine", sine, partial(_regular, survey, i))
    return tuple(singularities)


def _own(survey: Survey, i: int) -> dict[Symptom, Measure]:
    """Return the two measures of a singularity of task i alone, by symptom; empty if task i is never active."""
    rank = task_rank(survey.values, i)
    if rank == 0:
        return {}
    sizes = np.linalg.norm(survey.values.jacobians[i], 2, axis=(1, 2))
    strength = task_strength(i, rank=rank, size=float(np.median(sizes[sizes > 0.0])))
    return {"strength": strength, "turning": lambda values: values.turning[i]}


def _regular(survey: Survey, i: int, point: Array) -> bool:
    here = survey.field.at(point[None])
    return all(measure(here)[0] > survey.threshold for measure in _own(survey, i).values())


def _singularity(
    survey: Survey, i: int, symptom: Symptom, measure: Measure, counts: Callable[[Array], bool]
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


def _apart(survey: Survey, points: list[Array]) -> list[Array]:
    region = survey.field.region
    width = np.where(region.upper > region.lower, region.upper - region.lower, 1.0)
    distinct: list[Array] = []
    for point in points:
        if all(np.linalg.norm((point - other) / width) > 0.01 for other in distinct):
            distinct.append(point)
    return distinct
