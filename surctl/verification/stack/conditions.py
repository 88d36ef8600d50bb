"""When every task of a stack converges under the null-space law (16), for targets at rest.

With σ̃ the stacked errors the law gives dσ̃/dt = −M K σ̃, M_ij = J_i N_1 ⋯ N_{j−1} J_j⁺ (successive projection, as
printed; Antonelli 2009, Stability analysis for prioritized closed-loop inverse kinematic algorithms, has the
conditions on orthogonality and independence that these are built on). Row by row:

- M_ij, j > i: a lower task disturbs a higher one. Zero where the projectors of the levels commute, which orthogonal
  tasks do. With it M is a lower block triangle, a cascade: no gain can spoil it, however the gains are chosen.
- M_ii = J_i N_1 ⋯ N_{i−1} J_i⁺: what a task keeps of itself. Where the projectors commute its eigenvalues are sin² of
  the angles to the rows above: positive where the task is independent of all above it together
  (rank [J_1; …; J_i] is the sum of the ranks), and 1 where it is orthogonal to them.
- where lower tasks do disturb, the comparison matrix (least eigenvalue of the symmetric part of M_ii on the diagonal,
  −max‖M_ij‖ beside it) decides: if it is a non-singular M-matrix, all errors converge for all scalar gains
  (vector Lyapunov function Σ p_i‖σ̃_i‖; a gain scales a column, which keeps the property).

Orthogonality is an identity of the expressions. Independence is proved by interval branch and bound on
det[J_a; J_b][J_a; J_b]ᵀ ≥ s² det(J_aJ_aᵀ) det(J_bJ_bᵀ), the sines' product squared, checked by the independent checker;
where that does not close, what samples and local searches show is said to be that.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any, Literal

from surctl.priority.diagnosis import Diagnosis, diagnose
from surctl.priority.diagnosis.findings import Pair
from surctl.priority.diagnosis.region import Bounds, Parameter, build_region, pose_text
from surctl.tasks import Stack, Task
from surctl.verification.stack.coupling import Coupling, couplings
from surctl.verification.stack.independence import prove_sine, prove_strength
from surctl.verification.stack.symbols import gains_are_equal, gram_is_constant, names_in

__all__ = ["LevelCondition", "PairCondition", "StackConditions", "stack_conditions"]

Kind = Literal["orthogonal", "independent", "dependent"]
Shown = Literal["identity", "proved", "samples", "witness"]
Outcome = Literal["converges", "converges on samples", "need not converge"]

_DEPENDENT = 1e-3  # a sine below this counts as none
_PROVED_SHARE = 0.9  # of the least sine of the samples: what the prover is asked for


@dataclass(frozen=True)
class PairCondition:
    """How two tasks lie to each other over the region.

    Attributes:
        first, second: names, the higher priority first.
        kind: orthogonal: neither disturbs the other; independent: both can be met; dependent: somewhere they cannot.
        shown: by an identity of the expressions, by a proof, by samples alone, or by a witness state.
        sine: of the smallest angle: what is shown, the least found, or 0.
        where: the witness of `dependent`, else the state of the least sine found; empty for an identity.
    """

    first: str
    second: str
    kind: Kind
    shown: Shown
    sine: float
    where: dict[str, float]

    @property
    def sentence(self) -> str:
        """The verdict in one line."""
        by = {"identity": "everywhere, by identity", "proved": "proved on the region", "samples": "on all samples"}
        both = f"{self.first} and {self.second}"
        if self.kind == "dependent":
            return f"{both}: dependent (algorithmic singularity) at {pose_text(self.where)}"
        size = "" if self.kind == "orthogonal" else f", sine of their angle at least {self.sine:.3g}"
        return f"{both}: {self.kind} {by[self.shown]}{size}"


@dataclass(frozen=True)
class LevelCondition:
    """What a task does under the law.

    Attributes:
        task: its name.
        outcome: for a target at rest, while the state stays in the region.
        shown: the weakest of what the outcome rests on.
        tracks: a moving target is followed exactly as well: nothing above or below touches the task.
        keeps: share of its own gain that the task keeps, at least; 0 where it may lose a direction.
        disturbed_by: lower tasks that disturb it, the largest ‖M_ij‖ of the samples each.
        reason: in words.
        where: a state where it loses a direction; empty otherwise.
    """

    task: str
    outcome: Outcome
    shown: Shown
    tracks: bool
    keeps: float
    disturbed_by: dict[str, float]
    reason: str
    where: dict[str, float]

    @property
    def sentence(self) -> str:
        """The verdict in one line."""
        at = f" at {pose_text(self.where)}" if self.where else ""
        moving = "" if self.tracks or self.outcome == "need not converge" else ", for targets at rest"
        return f"{self.task}: {self.outcome}{moving}; {self.reason}{at}"


@dataclass(frozen=True)
class StackConditions:
    """The conditions of a whole stack.

    Attributes:
        tasks: names, highest priority first.
        pairs: every two of them.
        levels: every one of them.
        triangular: no lower task disturbs a higher one: any positive gains do.
        small_gain: where some does, whether the comparison matrix of the samples is an M-matrix.
        samples: number of samples that numbers rest on.
    """

    tasks: tuple[str, ...]
    pairs: tuple[PairCondition, ...]
    levels: tuple[LevelCondition, ...]
    triangular: bool
    small_gain: bool
    samples: int

    @property
    def converges(self) -> bool:
        """Whether every task does, if only on the samples."""
        return all(level.outcome != "need not converge" for level in self.levels)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {**asdict(self), "converges": self.converges}

    def lines(self) -> list[str]:
        """What to print."""
        gains = "any positive gains" if self.triangular else "lower tasks disturb higher ones"
        lines = [f"stack {' > '.join(self.tasks)}: {gains}"]
        lines += [f"  {level.sentence}" for level in self.levels]
        return lines + [f"  {pair.sentence}" for pair in self.pairs]


def stack_conditions(
    stack: Stack,
    region: Bounds,
    *,
    parameters: Sequence[Parameter] = (),
    samples: int = 1024,
    seed: int = 0,
    time_limit: float = 5.0,
) -> StackConditions:
    """Verdict per pair and per task, over a region of states.

    Args:
        stack: tasks with one reference each.
        region: lower and upper corner of η, (4,) each [m, m, m, rad] in {E}.
        parameters: (symbol, lower, upper) of every further symbol of the tasks.
        samples: number of samples.
        seed: of the samples.
        time_limit: seconds of each proof of independence.

    Raises:
        InputError: as `surctl.priority.diagnosis.diagnose`.
    """
    diagnosis = diagnose(stack, region, parameters=parameters, samples=samples, seed=seed)
    box = build_region(stack, region, parameters)
    coupled = couplings(stack, box, samples=samples, seed=seed)

    def proved(above: Sequence[int], i: int, sine: float) -> float:
        return prove_sine(stack, box, above, i, sine=_PROVED_SHARE * sine, time_limit=time_limit)

    pairs = {
        (i, j): _pair(diagnosis.pairs[k], partial(proved, [i], j))
        for k, (i, j) in enumerate(combinations(range(len(stack.tasks)), 2))
    }
    levels: list[LevelCondition] = []
    for i, task in enumerate(stack.tasks):
        assert isinstance(task, Task)  # `diagnose` refuses the others
        above = [pairs[j, i] for j in range(i)]
        own = partial(prove_strength, stack, box, i, time_limit=time_limit)
        levels.append(_level(stack, diagnosis, coupled, above, i, partial(proved, range(i), i), own))
    for i, level in enumerate(levels):
        lost = [other.task for other in levels[:i] if other.outcome == "need not converge"]
        if lost and level.outcome != "need not converge" and not level.tracks:
            levels[i] = LevelCondition(
                level.task, "need not converge", "samples", False, level.keeps, level.disturbed_by,
                f"{level.reason}; but {', '.join(lost)} above it may not, and disturbs it", level.where,
            )  # fmt: skip
    touched = [names_in(box, task) for task in stack.tasks]
    shown = [_only(pair, touched[i] | touched[j]) for (i, j), pair in pairs.items()]
    levels = [_only(level, set().union(*touched[: i + 1])) for i, level in enumerate(levels)]
    return StackConditions(
        stack.names, tuple(shown), tuple(levels), coupled.triangular, coupled.small_gain, diagnosis.samples
    )


def _only(condition: Any, names: set[str]) -> Any:
    """The finding with its state cut down to the variables that its tasks depend on."""
    return replace(condition, where={name: value for name, value in condition.where.items() if name in names})


def _pair(pair: Pair, proved: Callable[[float], float]) -> PairCondition:
    where = dict(pair.where or {})
    if pair.kind == "never active together" or pair.structural:
        return PairCondition(pair.first, pair.second, "orthogonal", "identity", 1.0, {})
    sine = math.sin(min(pair.smallest or 0.0, math.pi / 2))
    if sine <= _DEPENDENT:
        return PairCondition(pair.first, pair.second, "dependent", "witness", 0.0, where)
    if pair.kind == "orthogonal":
        return PairCondition(pair.first, pair.second, "orthogonal", "samples", sine, where)
    shown = proved(sine)
    if shown > 0:
        return PairCondition(pair.first, pair.second, "independent", "proved", shown, where)
    return PairCondition(pair.first, pair.second, "independent", "samples", sine, where)


def _level(
    stack: Stack,
    diagnosis: Diagnosis,
    coupled: Coupling,
    above: Sequence[PairCondition],
    i: int,
    proved: Callable[[float], float],
    regular: Callable[[], bool],
) -> LevelCondition:
    name, own = stack.names[i], coupled.own[i]
    disturbed = {stack.names[j]: size for j, size in coupled.from_below(i).items()}
    kinematic = next((s for s in diagnosis.singularities if s.task == name and s.kind == "kinematic"), None)
    lost = next((s for s in diagnosis.singularities if s.task == name and s.kind == "algorithmic"), None)
    dependent = diagnosis.levels[i].dependent

    free = not disturbed and all(pair.kind == "orthogonal" for pair in above)

    def said(outcome: Outcome, shown: Shown, keeps: float, reason: str, where: Any = None) -> LevelCondition:
        return LevelCondition(name, outcome, shown, free, keeps, disturbed, reason, dict(where or {}))

    if kinematic is not None:
        where = kinematic.poses[0]
        return said("need not converge", "witness", 0.0, "it is singular by itself", where)
    if lost is not None or dependent or diagnosis.levels[i].rank < stack.tasks[i].size:
        where = lost.poses[0] if lost is not None else coupled.worst[i]
        return said("need not converge", "witness", 0.0, "the tasks above take a direction", where)
    if free:
        shown: Shown = "identity" if all(p.shown == "identity" for p in above) else "samples"
        sure = shown == "identity" and coupled.untouched_below(i) and regular()
        word: Outcome = "converges" if sure else "converges on samples"
        return said(word, shown if sure else "samples", 1.0, "nothing above takes any of it, its rate is its own gain")
    if disturbed and not coupled.small_gain:
        return said("need not converge", "samples", own, f"disturbed by {', '.join(disturbed)} beyond the small gain")
    if disturbed:
        reason = f"disturbed by {', '.join(disturbed)}, within the small gain: for all scalar gains"
        return said("converges on samples", "samples", own, reason)
    sine = coupled.sine[i]
    formed = gram_is_constant(stack, i) and gains_are_equal(stack, i)
    shown_sine = proved(sine) if coupled.untouched_below(i) and coupled.commuting_above(i) and formed else 0.0
    if shown_sine > 0:
        reason = f"independent of all above it, keeps at least {shown_sine**2:.3g} of its gain"
        return said("converges", "proved", shown_sine**2, reason)
    why = "" if formed else ", J Jᵀ or its gains are not of the form that a proof needs"
    return said("converges on samples", "samples", own, f"keeps at least {own:.3g} of its gain on the samples{why}")
