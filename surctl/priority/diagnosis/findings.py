"""What a diagnosis finds, as data: one class for each question."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from surctl.priority.diagnosis.region import Pose

__all__ = ["Equality", "LevelReport", "Met", "Pair", "PairKind", "Residual", "Singularity", "Symptom", "Verdict"]

Verdict: TypeAlias = Literal["everywhere", "on all samples", "differs"]
"""everywhere: the commutators vanish as expressions, for every pose and parameter; on all samples: nothing else was
found, which proves nothing; differs: there is a pose."""

PairKind: TypeAlias = Literal[
    "orthogonal", "independent", "dependent somewhere", "dependent everywhere", "never active together"
]
"""Of two row spaces: at 90 degrees; without a direction in common; with one at some pose (down to the threshold), or
at every sample; or one of the two is empty at every sample."""

Met: TypeAlias = Literal["by both laws", "by strict priority only", "by neither law"]
"""Whether the reference of a level is reached at all samples."""

Symptom: TypeAlias = Literal["sine", "strength", "turning"]
"""What went below the threshold: the sine of the angle to the row space above; the strength, a singular value in parts
of the median of ‖J‖; the turning, a step [m, or rad] that may turn a row right round."""


@dataclass(frozen=True)
class Equality:
    """Whether NSB equals strict priority, for the whole stack.

    Attributes:
        verdict: see `Verdict`.
        largest: largest commutator norm found; see `commutator_norms`.
        task, where: the level and the pose of it; None when no level differs.
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
    """How the row spaces of two tasks lie to each other.

    Attributes:
        first, second: names, the higher priority first.
        kind: see `PairKind`.
        smallest, largest: of the smallest principal angle over the region [rad]; the smallest one is searched for,
            the largest is that of the samples. None when the two are never active together.
        where: the pose of `smallest`.
        shared: directions in common, the most that a sample showed.
        structural: `orthogonal` is an identity of the expressions.
        equal: what `Equality.verdict` says of these two tasks alone (samples only, no search).
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
        task: its name.
        kind: `algorithmic`: a direction of the task falls into the row space above while its own Jacobian is
            regular; `kinematic`: the Jacobian itself loses rank, or has no limit.
        symptom: see `Symptom`.
        value: the least that was found.
        poses: where, worst first; they keep apart.
        also_singular: tasks above that are singular by themselves at the first pose.
        share: of the samples, how many are below the threshold (0 … 1).
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
    """‖J_i v − x_i‖ over the samples [unit of σ per second]: median, largest, and where that is."""

    median: float
    largest: float
    where: Pose


@dataclass(frozen=True)
class LevelReport:
    """What one level gets.

    Attributes:
        task: its name.
        rank: of its Jacobian, the largest of the samples.
        gained: directions that it finds outside the row space above, the most of the samples.
        rank_above: rank of all tasks above together, the largest of the samples.
        exhausted: share of the samples where the tasks above leave no freedom at all (0 … 1).
        strict, nsb: residuals by strict priority and by the law (16).
        met: see `Met`.
        unit: of the residuals, as "m/s"; "" if the task has none.
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
        """Directions that the task shares with those above it, at every sample."""
        return self.rank - self.gained
