"""Findings of a diagnosis as data, with one class for each kind of finding."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from surctl.priority.diagnosis.region import Pose

__all__ = ["Equality", "LevelReport", "Met", "Pair", "PairKind", "Residual", "Singularity", "Symptom", "Verdict"]

Verdict: TypeAlias = Literal["everywhere", "on all samples", "differs"]
"""everywhere: the commutators vanish as expressions, for every pose and parameter; on all samples: no difference was
found, which is not a proof; differs: a pose with a difference was found."""

PairKind: TypeAlias = Literal[
    "orthogonal", "independent", "dependent somewhere", "dependent everywhere", "never active together"
]
"""Relation of two row spaces: at 90 degrees; without a common direction; with a common direction at some pose (within
the threshold) or at every sample; or one of the two is empty at every sample."""

Met: TypeAlias = Literal["by both laws", "by strict priority only", "by neither law"]
"""Whether the level attains its reference at all samples."""

Symptom: TypeAlias = Literal["sine", "strength", "turning"]
"""The quantity below the threshold: the sine of the angle to the row space above; the strength, a singular value
relative to the median of ‖J‖; or the turning, the step [m or rad] that may reverse a row."""


@dataclass(frozen=True)
class Equality:
    """The finding on whether NSB equals strict priority for the whole stack.

    Attributes:
        verdict: see `Verdict`.
        largest: the largest commutator norm found (see `commutator_norms`).
        task: the level with the largest commutator norm; None if NSB equals strict priority at all levels. where: the
            pose of this norm, or None.
        by_task: largest commutator norm found at each level.
        structural: names of the levels whose commutator vanishes as an expression.
        searches: number of local searches.
    """

    verdict: Verdict
    largest: float
    task: str | None
    where: Pose | None
    by_task: Mapping[str, float]
    structural: tuple[str, ...]
    searches: int


@dataclass(frozen=True)
class Pair:
    """The finding on the relation between the row spaces of two tasks.

    Attributes:
        first: name of the task with the higher priority. second: name of the other task.
        kind: see `PairKind`.
        smallest, largest: smallest and largest value, over the region, of the smallest principal angle between the row
            spaces [rad]. `smallest` comes from a search, `largest` from samples. Both are None if the two tasks are
            never active together.
        where: the pose at which the angle is `smallest`.
        shared: largest number of directions that both row spaces contain, over the samples.
        structural: True if the tasks are orthogonal as an identity of the expressions.
        equal: `Equality.verdict` for a stack of only these two tasks (from samples, without local search).
    """

    first: str
    second: str
    kind: PairKind
    smallest: float | None
    largest: float | None
    where: Pose | None
    shared: int
    structural: bool
    equal: Verdict


@dataclass(frozen=True)
class Singularity:
    """The finding on poses where a level loses rank.

    Attributes:
        task: name of the task.
        kind: `algorithmic`: a direction of the task lies in the row space of the tasks above while its own Jacobian is
            regular; `kinematic`: the Jacobian itself loses rank, or has no limit value at the pose.
        symptom: see `Symptom`.
        value: the smallest value of the measure found.
        poses: the singular poses, worst first, at some distance from each other.
        also_singular: tasks of higher priority whose own Jacobians are singular at the first pose.
        share: fraction of the samples with a measure below the threshold (0 … 1).
    """

    task: str
    kind: Literal["algorithmic", "kinematic"]
    symptom: Symptom
    value: float
    poses: tuple[Pose, ...]
    also_singular: tuple[str, ...]
    share: float


@dataclass(frozen=True)
class Residual:
    """Residual ‖J_i v − x_i‖ over the samples [unit of σ per second]: median, largest, and the pose of the largest."""

    median: float
    largest: float
    where: Pose


@dataclass(frozen=True)
class LevelReport:
    """The finding on how well one level is met.

    Attributes:
        task: name of the task.
        rank: largest rank of the task's Jacobian among the samples.
        gained: largest number, among the samples, of the task's directions outside the row space of the tasks above.
        rank_above: largest rank of all tasks above together, among the samples.
        exhausted: share of the samples where the tasks above leave no freedom at all (0 … 1).
        strict: residuals with strict priority. nsb: residuals with the law (16).
        met: see `Met`.
        unit: unit of the residuals, for example "m/s"; "" if the task has none.
    """

    task: str
    rank: int
    gained: int
    rank_above: int
    exhausted: float
    strict: Residual
    nsb: Residual
    met: Met
    unit: str = ""

    @property
    def dependent(self) -> int:
        """Return the number of directions that the task shares with the tasks above it at every sample."""
        return self.rank - self.gained
