"""Findings of a diagnosis as data: one class for each question."""

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
    """Whether NSB equals strict priority, for the whole stack.

    Attributes:
        verdict: see `Verdict`.
        largest: largest commutator norm found; see `commutator_norms`.
        task, where: the level with the largest norm and the pose; None when no level differs.
        by_task: largest norm found at each level.
        structural: levels whose commutator vanishes as an expression.
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
    """The relation between the row spaces of two tasks.

    Attributes:
        first, second: names, the higher priority first.
        kind: see `PairKind`.
        smallest, largest: smallest and largest value over the region of the smallest principal angle [rad]. The
            smallest value comes from a search, the largest from samples. None if the two are never active together.
        where: the pose of `smallest`.
        shared: largest number of common directions among the samples.
        structural: True if `orthogonal` is an identity of the expressions.
        equal: `Equality.verdict` for these two tasks alone (from samples, without search).
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
    """Poses where a level loses rank.

    Attributes:
        task: name of the task.
        kind: `algorithmic`: a direction of the task falls into the row space above while its own Jacobian is
            regular; `kinematic`: the Jacobian itself loses rank, or has no limit.
        symptom: see `Symptom`.
        value: the smallest value found.
        poses: the poses, worst first, at some distance from each other.
        also_singular: tasks above that are singular by themselves at the first pose.
        share: fraction of the samples below the threshold (0 … 1).
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
    """‖J_i v − x_i‖ over the samples [unit of σ per second]: the median, the largest, and the pose of the largest."""

    median: float
    largest: float
    where: Pose


@dataclass(frozen=True)
class LevelReport:
    """How well one level is met.

    Attributes:
        task: name of the task.
        rank: largest rank of its Jacobian among the samples.
        gained: largest number of its directions outside the row space above, among the samples.
        rank_above: largest rank of all tasks above together, among the samples.
        exhausted: share of the samples where the tasks above leave no freedom at all (0 … 1).
        strict, nsb: residuals with strict priority and with the law (16).
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
        """Number of directions that the task shares with the tasks above it at every sample."""
        return self.rank - self.gained
