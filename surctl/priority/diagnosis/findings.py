"""Findings of the diagnosis of a task stack, with one class for each kind of finding.

`Region` holds the poses and parameters that a diagnosis covers: bounds, samples, and text for a pose.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.tasks import Stack
from surctl.tasks.task import is_pose

Array: TypeAlias = NDArray[np.float64]
Bounds: TypeAlias = tuple[Sequence[float] | Array | float, Sequence[float] | Array | float]
"""Lower and upper bounds of the pose."""
Parameter: TypeAlias = tuple[ca.SX, Sequence[float] | Array | float, Sequence[float] | Array | float]
"""A symbol (k, 1) with its lower and upper bounds: k numbers each (or one for all), in the unit of the symbol."""
Pose: TypeAlias = Mapping[str, float]
"""x, y, z [m] in {E}, psi [rad], and every parameter by its name."""

_AXES = ("x", "y", "z", "psi")


@dataclass(frozen=True, eq=False)
class Region:
    """Lower and upper bounds of the pose and of all parameters of a task stack; build it with `build_region`.

    Attributes:
        symbols: SX (d, 1): the entries of the pose eta, then the entries of every parameter that the stack uses.
        names: names of the d variables, for example "x", "psi", "waypoint_0".
        lower, upper: (d,) bounds of the variables [m, m, m, rad, then the unit of each parameter].
    """

    symbols: ca.SX
    names: tuple[str, ...]
    lower: Array
    upper: Array

    @property
    def free(self) -> NDArray[np.intp]:
        """Return the indices (f,) of the free variables, whose lower and upper bounds differ."""
        return np.flatnonzero(self.upper > self.lower)

    def place(self, unit: Array) -> Array:
        """Return the points (N, d) of the region for coordinates (N, f) of the free variables, scaled to 0 … 1."""
        points = np.tile(self.lower, (len(unit), 1))
        points[:, self.free] += np.clip(unit, 0.0, 1.0) * (self.upper - self.lower)[self.free]
        return np.clip(points, self.lower, self.upper)

    def sample(self, samples: int, seed: int) -> Array:
        """Return scrambled Sobol points (2^k, f) in 0 … 1, with 2^k ≥ `samples`; one point if no variable is free."""
        from scipy.stats import qmc

        if self.free.size == 0:
            return np.zeros((1, 0))
        points = qmc.Sobol(self.free.size, seed=seed).random_base2(math.ceil(math.log2(samples)))
        return np.asarray(points, dtype=float)

    def pose(self, point: Array) -> dict[str, float]:
        """Return a point (d,) as a mapping from the names of the variables to their values."""
        return {name: float(value) for name, value in zip(self.names, point, strict=True)}


def build_region(stack: Stack, region: Bounds, parameters: Sequence[Parameter] = ()) -> Region:
    """Check the bounds of the pose, (4,) each [m, m, m, rad], and of the parameters, and return the region.

    Parameters that the stack does not use are dropped.

    Raises:
        InputError: bounds have a wrong size, are not finite, or have lower > upper; a parameter is not a symbol, occurs
            twice, or has a name already in use; or a symbol of the stack has no bounds (the message names its task).
    """
    if not all(is_pose(task.eta, task.mapping) for task in stack.tasks):
        problem = "has a configuration that is not the pose x, y, z, psi of a vehicle, which a diagnosis is about"
        raise InputError(problem, key="stack", remedy="diagnose single problems with solve")
    lower, upper = _corners(region, 4, key="region", names=_AXES)
    symbols, names, low, high = [stack.eta[i] for i in range(4)], list(_AXES), [lower], [upper]
    used = {s.element_hash() for J, x in stack.levels() for s in _symbols(J, x)}
    for parameter in parameters:
        symbol, bounds = _split(parameter)
        entries = _entries(symbol)
        if any(entry.element_hash() == s.element_hash() for entry in entries for s in symbols):
            raise InputError("has two ranges", key=f"parameters: {symbol}", remedy="give each symbol one range")
        lower, upper = _corners(bounds, len(entries), key="parameters", names=[str(e) for e in entries])
        for entry, least, most in zip(entries, lower, upper, strict=True):
            if entry.element_hash() in used:
                symbols.append(entry)
                names.append(_fresh(str(entry), names))
                low.append(np.array([least]))
                high.append(np.array([most]))
    _check_complete(stack, {s.element_hash() for s in symbols})
    return Region(ca.vertcat(*symbols), tuple(names), np.concatenate(low), np.concatenate(high))


def pose_text(pose: Pose) -> str:
    """Return the pose as text, `x = 0.5 m, y = …, psi = 0.3 rad, waypoint_0 = 1`, with four significant digits."""
    units = {"x": " m", "y": " m", "z": " m", "psi": " rad"}
    return ", ".join(f"{name} = {value:.4g}{units.get(name, '')}" for name, value in pose.items())


def _symbols(*expressions: ca.SX) -> list[ca.SX]:
    symbols: list[ca.SX] = ca.symvar(ca.vertcat(*[ca.vec(e) for e in expressions]))
    return symbols


def _check_complete(stack: Stack, known: set[int]) -> None:
    for name, (J, x) in zip(stack.names, stack.levels(), strict=True):
        for symbol in _symbols(J, x):
            if symbol.element_hash() not in known:
                remedy = f"give parameters=[({symbol}, lower, upper)]"
                raise InputError(f"uses {symbol}, which has no range", key=f"task {name}", remedy=remedy)


def _split(parameter: Parameter) -> tuple[ca.SX, Bounds]:
    try:
        symbol, lower, upper = parameter
    except (TypeError, ValueError):
        raise InputError(
            "is not a symbol with a range", key="parameters", value=parameter, remedy="give (symbol, lower, upper)"
        ) from None
    return symbol, (lower, upper)


def _entries(symbol: ca.SX) -> list[ca.SX]:
    if not isinstance(symbol, ca.SX) or symbol.numel() == 0 or not symbol.is_valid_input():
        raise InputError("is not an SX symbol", key="parameters", value=symbol, remedy="give (symbol, lower, upper)")
    return [ca.vec(symbol)[i] for i in range(symbol.numel())]


def _fresh(name: str, names: list[str]) -> str:
    if name in names:
        raise InputError("names two variables", key="parameters", value=name, remedy="rename one of the symbols")
    return name


def _corners(bounds: Bounds, size: int, *, key: str, names: Sequence[str]) -> tuple[Array, Array]:
    # for parameters, a single number applies to all entries
    try:
        lower, upper = (np.array(part, dtype=float).reshape(-1) for part in bounds)
    except (TypeError, ValueError):
        raise InputError("is not a box", key=key, value=bounds, remedy="give (lower, upper), numbers each") from None
    spread = key == "parameters"
    corners = [np.repeat(c, size) if spread and c.size == 1 else c for c in (lower, upper)]
    for side, corner in zip(("lower", "upper"), corners, strict=True):
        if corner.size != size:
            problem = f"{side} corner has {corner.size} entries"
            raise InputError(problem, key=f"{key}: {', '.join(names)}", remedy=f"give {size}")
    for name, least, most in zip(names, *corners, strict=True):
        if not (math.isfinite(least) and math.isfinite(most)):
            raise InputError("is not finite", key=f"{key}: {name}", value=[least, most], remedy="give finite bounds")
        if least > most:
            raise InputError("bounds cross", key=f"{key}: {name}", value=[least, most], remedy="give lower <= upper")
    return corners[0], corners[1]


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


def _say_equality(equality: Equality, *, levels: int, samples: int) -> str:
    """Return the sentence on whether NSB equals strict priority."""
    if levels == 1:
        return "With one task, NSB equals strict priority."
    if equality.verdict == "everywhere":
        return "NSB equals strict priority everywhere: all commutators vanish as expressions."
    if equality.where is None:
        return (
            f"NSB equals strict priority on all {samples} samples (largest commutator {equality.largest:.1g}), "
            "which is not a proof."
        )
    at = pose_text(equality.where)
    return f"NSB differs from strict priority at `{equality.task}`: commutator {equality.largest:.2g} at {at}."


def _say_pair(pair: Pair) -> str:
    """Return the sentence on how two tasks affect each other."""
    both = f"`{pair.first}` and `{pair.second}`"
    if pair.smallest is None or pair.largest is None or pair.where is None:
        return f"{both} are never active together."
    at = pose_text(pair.where)
    equal = "" if pair.equal == "differs" else ", and NSB treats these two as strict priority does"
    if pair.kind == "orthogonal":
        where = "everywhere" if pair.structural else "on all samples"
        return f"{both} are orthogonal {where}: neither disturbs the other."
    if pair.kind == "dependent everywhere":
        return f"{both} share {_directions(pair.shared)} at every sample{equal}."
    if pair.kind == "dependent somewhere":
        return (
            f"{both} nearly share a direction at some poses: angle between {_degrees(pair.smallest)} and "
            f"{_degrees(pair.largest)}, smallest at {at}."
        )
    return (
        f"{both} are coupled: angle between {_degrees(pair.smallest)} and {_degrees(pair.largest)}, "
        f"smallest at {at}{equal}."
    )


def _say_singularity(singularity: Singularity) -> str:
    """Return the sentence on where a level loses rank, and why."""
    at = pose_text(singularity.poses[0])
    more = f" ({len(singularity.poses) - 1} more poses found)" if len(singularity.poses) > 1 else ""
    if singularity.kind == "algorithmic":
        cause = "".join(f", where `{name}` is singular itself" for name in singularity.also_singular[:1])
        return (
            f"`{singularity.task}` loses a direction to the tasks above it{cause} (algorithmic singularity, sine "
            f"{singularity.value:.2g}): the velocity of strict priority is unbounded near {at}{more}."
        )
    reason = (
        f"a step of {singularity.value:.2g} [m or rad] may reverse a row of its Jacobian"
        if singularity.symptom == "turning"
        else f"its Jacobian loses rank (smallest singular value {singularity.value:.2g} of its usual size)"
    )
    return f"`{singularity.task}` is singular by itself (kinematic singularity): {reason} near {at}{more}."


def _say_level(level: LevelReport) -> str:
    """Return the sentence on whether a level is met, and if not, why."""
    name = f"`{level.task}`"
    if level.met == "by both laws":
        text = f"{name} is met by both laws at all samples"
    elif level.met == "by strict priority only":
        text = f"{name} is met by strict priority only: NSB leaves {_residual(level.nsb, level.unit)}"
    else:
        text = (
            f"{name} cannot be met: strict priority leaves {_residual(level.strict, level.unit)}, "
            f"NSB leaves {_residual(level.nsb, level.unit)}"
        )
    return text + _why(level) + "."


def _why(level: LevelReport) -> str:
    if level.rank == 0:
        return "; it is inactive at all samples"
    whole = _directions(level.rank)
    dependent = f"; it shares {level.dependent} of its {whole} with tasks above it" if level.dependent else ""
    spent = f"; the tasks above it leave no freedom at {level.exhausted:.0%} of the samples" if level.exhausted else ""
    return dependent + spent


def _residual(residual: Residual, unit: str) -> str:
    named = f" {unit}" if unit else ""
    return (
        f"{residual.median:.2g}{named} (median) and at most {residual.largest:.2g}{named}, "
        f"at {pose_text(residual.where)}"
    )


def _directions(count: int) -> str:
    return "1 direction" if count == 1 else f"{count} directions"


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.3g}°"


@dataclass(frozen=True)
class Diagnosis:
    """All findings on a task stack over a region of poses; `explain` (or `str`) returns the findings as sentences.

    Attributes:
        tasks: names of the tasks, highest priority first.
        region: (lower, upper) bounds of every variable by name [m, m, m, rad, then the unit of each parameter].
        samples: number of samples.
        seed: seed of the samples.
        threshold: number below which a pose counts as singular; see `diagnose`.
        equality, pairs, singularities, levels: the findings of each kind.
    """

    tasks: tuple[str, ...]
    region: Mapping[str, tuple[float, float]]
    samples: int
    seed: int
    threshold: float
    equality: Equality
    pairs: tuple[Pair, ...]
    singularities: tuple[Singularity, ...]
    levels: tuple[LevelReport, ...]

    def explain(self) -> str:
        """Return all findings as text, one sentence per line, and a last line on how the numbers were computed."""
        lines = [_say_equality(self.equality, levels=len(self.tasks), samples=self.samples)]
        lines += [_say_pair(pair) for pair in self.pairs]
        lines += [_say_singularity(singularity) for singularity in self.singularities]
        lines += [_say_level(level) for level in self.levels]
        lines.append(
            f"These results rest on {self.samples} samples (seed {self.seed}) and local searches from the worst "
            "samples, so the diagnosis can miss poses."
        )
        return "\n".join(lines)

    def __str__(self) -> str:
        """Return the text of `explain`."""
        return self.explain()

    def to_dict(self) -> dict[str, Any]:
        """Return the diagnosis as dictionaries and lists for JSON; every number is finite."""
        return {name: _plain(value) for name, value in asdict(self).items()}


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    return [_plain(entry) for entry in value] if isinstance(value, tuple) else value
