"""Findings of the diagnosis of a task stack, with one class for each kind of finding."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from surctl.priority.diagnosis.region import Pose

__all__ = ["Equality", "LevelReport", "Met", "Pair", "PairKind", "Residual", "Singularity", "Symptom", "Verdict"]

Verdict: TypeAlias = Literal["everywhere", "on all samples", "differs"]
"""everywhere: NSB equals strict priority for every pose and parameter, shown on the expressions. on all samples: no
difference was found, which is not a proof. differs: a pose with a difference was found."""

PairKind: TypeAlias = Literal[
    "orthogonal", "independent", "dependent somewhere", "dependent everywhere", "never active together"
]
"""Relation of the row spaces of two Jacobians. orthogonal: at 90 degrees. independent: no common direction. dependent
somewhere: a common direction at some pose (within the threshold). dependent everywhere: a common direction at every
sample. never active together: one of the two row spaces is empty at every sample."""

Met: TypeAlias = Literal["by both laws", "by strict priority only", "by neither law"]
"""Which laws meet the level (J v equals the desired rate) at all samples."""

Symptom: TypeAlias = Literal["sine", "strength", "turning"]
"""The quantity below the threshold. sine: sine of the angle to the row space of the tasks above. strength: a singular
value of the Jacobian J relative to the median of ‖J‖. turning: the step [m or rad] that may reverse a row of J."""


@dataclass(frozen=True)
class Equality:
    """The finding on whether NSB equals strict priority for the whole stack.

    Attributes:
        verdict: whether NSB equals strict priority, and on which evidence; see `Verdict`.
        largest: the largest commutator norm found, which is 0 if both laws are equal; see `commutator_norms`.
        task: the level with the largest commutator norm; None if NSB equals strict priority at all levels. where: the
            pose at which this norm was found, or None.
        by_task: largest commutator norm found at each level.
        structural: names of the levels whose commutator is zero at all poses, as an identity of the expressions.
        searches: number of local searches for poses with a larger norm.
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
        kind: relation of the two row spaces; see `PairKind`.
        smallest, largest: smallest and largest value, over the region, of the smallest principal angle between the row
            spaces [rad]. `smallest` comes from a search, `largest` from samples. Both are None if the two tasks are
            never active together.
        where: the pose at which the angle is `smallest`.
        shared: largest dimension, over the samples, of the intersection of both row spaces.
        structural: True if the tasks are orthogonal at all poses, as an identity of the expressions.
        equal: whether NSB equals strict priority for a stack of only these two tasks, as in `Equality.verdict`, but
            from samples without local search.
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
        kind: `algorithmic` if a direction of the task lies in the row space of the tasks above, although its own
            Jacobian has its usual rank; `kinematic` if the Jacobian itself loses rank, or has no limit at the pose.
        symptom: the quantity that shows the singularity; see `Symptom`.
        value: the smallest value found of the quantity `symptom`.
        poses: the singular poses, worst first, at some distance from each other.
        also_singular: tasks of higher priority whose own Jacobians are singular at the first pose.
        share: fraction of the samples at which the quantity `symptom` is below the threshold (0 … 1).
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
    """Median and largest residual ‖J v − x‖ of a task over the samples [unit of σ per second], and the worst pose."""

    median: float
    largest: float
    where: Pose


@dataclass(frozen=True)
class LevelReport:
    """The finding on how well one level is met.

    Attributes:
        task: name of the task.
        rank: largest rank of the task's Jacobian among the samples.
        gained: largest number, among the samples, of directions that the task adds to the row space of the tasks above.
        rank_above: largest rank of all tasks above together, among the samples.
        exhausted: fraction of the samples at which the tasks above leave no freedom at all (0 … 1).
        strict: residuals with strict priority. nsb: residuals with the NSB law, equation (16) of the paper.
        met: which of the two laws meets the task at all samples; see `Met`.
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
        """Return how many directions of the task lie in the row space of the tasks above it at every sample."""
        return self.rank - self.gained
