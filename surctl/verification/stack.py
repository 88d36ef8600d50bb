"""Conditions under which every task of a stack converges under equation (16) of the paper, for targets at rest.

Let σ̃ contain the errors of all tasks. Equation (16) is the null-space law; it gives dσ̃/dt = −M K σ̃ with the gain
matrix K and the blocks M_ij = J_i N_1 ⋯ N_{j−1} J_j⁺ (successive projection, as printed), where J_i is the Jacobian of
task i, J_i⁺ its pseudoinverse, and N_i the projector onto the null space of J_i. The conditions extend those on
orthogonality and independence by Antonelli (2009, Stability analysis for prioritized closed-loop inverse kinematic
algorithms):

- M_ij with j > i is the disturbance of a higher task by a lower one. M_ij with j > i is zero if the projectors of the
  levels commute, as those of orthogonal tasks do. Then M is lower block triangular: a cascade, which is stable for any
  positive gains.
- M_ii = J_i N_1 ⋯ N_{i−1} J_i⁺ is the share of its own motion that task i keeps. If the projectors commute, the
  eigenvalues of M_ii are sin² of the angles between the task's Jacobian rows and those of the tasks above. The
  eigenvalues are positive if the task is independent of all tasks above it together (rank [J_1; …; J_i] is the sum of
  the ranks), and 1 if the task is orthogonal to all tasks above.
- If lower tasks disturb higher ones, the comparison matrix decides about convergence. The diagonal of this matrix holds
  the least eigenvalues of the symmetric parts of M_ii; its other entries are −max‖M_ij‖. If the comparison matrix is a
  non-singular M-matrix, all errors converge for all scalar gains (vector Lyapunov function Σ p_i‖σ̃_i‖; a gain scales
  one column, and the scaled matrix is still an M-matrix).

Orthogonality is decided by an identity between the expressions of the tasks. Independence is proved by interval branch
and bound on det[J_a; J_b][J_a; J_b]ᵀ ≥ s² det(J_aJ_aᵀ) det(J_bJ_bᵀ), where J_a and J_b are the Jacobians of two tasks,
and s is a lower bound on the product of the sines of the angles between them. The independent checker checks this
proof. If the proof fails, the verdict relies on samples and local searches, and its text says so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import check_document
from surctl.errors import InputError
from surctl.priority.diagnosis import Diagnosis, diagnose
from surctl.priority.diagnosis.field import (
    build_field,
    commuting_levels,
    directions,
    orthogonal_pairs,
    outside_sines,
    projector_above,
    world_jacobians,
)
from surctl.priority.diagnosis.findings import Bounds, Pair, Parameter, Region, build_region, pose_text
from surctl.tasks import SetTask, Stack, Task
from surctl.verification.claim import Claim, Variable
from surctl.verification.formula import Node, from_casadi, rebuilt, to_casadi
from surctl.verification.proving import prove
from surctl.verification.proving.tape import build_tape

# Properties of a task that follow from its expressions, without evaluation at numbers


def _names_in(region: Region, task: Task | SetTask) -> set[str]:
    """Return the variables of the region on which the task function σ of the task depends."""
    return {name for k, name in enumerate(region.names) if ca.depends_on(task.sigma, region.symbols[k])}


def _gram_is_constant(stack: Stack, i: int) -> bool:
    """Return whether the matrix J_i J_iᵀ of the Jacobian J_i of task i is constant or 1 × 1.

    Then V = σ̃ᵀ(J_i J_iᵀ)⁻¹σ̃, with the error σ̃ of the task, decreases if M_ii (see `conditions`) has positive
    eigenvalues.
    """
    A = world_jacobians(stack)[i]
    return bool(A.shape[0] == 1 or ca.simplify(A @ A.T).is_constant())


def _gains_are_equal(stack: Stack, i: int) -> bool:
    """Return whether the gains of all entries of the task are equal and do not depend on the state."""
    task = stack.tasks[i]
    if not isinstance(task, Task):
        return False
    gain = ca.SX(task.gain)
    same = all(ca.is_equal(gain[k], gain[0], 4) for k in range(gain.numel()))
    return bool(same and not ca.depends_on(gain, stack.eta))


# Simplification of expressions on a box: a max becomes its larger operand if this operand is the same everywhere


def simplified(expression: ca.SX, region: Region, names: tuple[str, ...]) -> ca.SX:
    """Return a column that is equal to `expression` on the region, without branches that interval arithmetic decides.

    Branches are min, max, abs and select. Without them, derivatives of the column contain no comparisons.

    Raises:
        UnsupportedOperation: the expression has an operation that the claim grammar does not have.
    """
    box = region.lower[:, None], region.upper[:, None]

    def above(a: Node, b: Node) -> int:
        # 0 if neither inequality is certain on the whole box
        read = build_tape(names, [a - b]).run(box)
        low, high = (float(end[0]) for end in read.jets[0].value)
        if not read.defined[0][0]:
            return 0
        return 1 if low >= 0 else -1 if high <= 0 else 0

    def change(node: Node, args: tuple[Node, ...]) -> Node:
        same = Node(node.op, args, node.value, node.name)
        if node.op not in ("abs", "min", "max", "select"):
            return same
        first, second = (args[0], -args[0]) if node.op == "abs" else args[:2]
        sign = above(first, second)
        if not sign:
            return same
        if node.op == "select":  # for equal operands select takes the case a ≤ b
            return args[2] if sign < 0 else same
        wins = sign > 0 if node.op != "min" else sign < 0
        return first if wins else second

    nodes = from_casadi(region.symbols, names, [expression[k] for k in range(expression.numel())])
    symbols = {name: region.symbols[k] for k, name in enumerate(names)}
    return ca.vertcat(*[to_casadi(rebuilt(node, change), symbols) for node in nodes])


# Proof that a task is independent of other tasks on a whole region, by a lower bound on the sine of their angle


_LEAST_STRENGTH = 1e-6  # least det J Jᵀ of a task whose Jacobian counts as regular


def prove_sine(stack: Stack, region: Region, above: Sequence[int], i: int, *, sine: float, time_limit: float) -> float:
    """Return `sine` if the product of sines between task i and the tasks above is proved to be ≥ `sine`, else 0.

    The proof is by interval branch and bound, and the independent checker must accept it.
    """
    for claim in _independence_claims(stack, region, above, i, sine=sine):
        certificate = prove(claim, time_limit=time_limit).certificate
        if certificate is None or not check_document(certificate).accepted:
            return 0.0
    return sine


def prove_strength(stack: Stack, region: Region, i: int, *, time_limit: float) -> bool:
    """Return whether the Jacobian J of task i is proved to be regular on the whole region (det J Jᵀ ≥ 1e-6)."""
    strength = _gram(_jacobian(stack, region, i))
    if strength.is_constant():
        return bool(float(strength) >= _LEAST_STRENGTH)
    certificate = prove(_claim(region, "strength", ca.SX(_LEAST_STRENGTH), strength), time_limit=time_limit).certificate
    return certificate is not None and check_document(certificate).accepted


def _independence_claims(
    stack: Stack, region: Region, above: Sequence[int], i: int, *, sine: float
) -> tuple[Claim, ...]:
    """Return three claims: det[A; B][A; B]ᵀ ≥ s² det(AAᵀ) det(BBᵀ), det AAᵀ > 0 and det BBᵀ > 0, where s = `sine`.

    A holds the Jacobians of the tasks above, and B is the Jacobian of task i. Both are expressed in {E}, where they do
    not depend on ψ.
    """
    A, B = ca.vertcat(*[_jacobian(stack, region, k) for k in above]), _jacobian(stack, region, i)
    if A.shape[0] + B.shape[0] > A.shape[1]:
        return (_claim(region, "dimension", ca.SX(1), ca.SX(0)),)  # a false claim: more Jacobian rows than velocities
    both, first, second = (_gram(part) for part in (ca.vertcat(A, B), A, B))
    floor = ca.SX(_LEAST_STRENGTH)
    return (
        _claim(region, "strength-above", floor, first),
        _claim(region, "strength", floor, second),
        _claim(region, "independence", sine**2 * first * second, both),
    )


def _jacobian(stack: Stack, region: Region, k: int) -> ca.SX:
    """Return the Jacobian of task k by the pose, without the branches that interval arithmetic decides on the region.

    Branches are min, max, abs and select.
    """
    sigma = stack.tasks[k].sigma
    try:
        smooth = simplified(sigma, region, tuple(map(_name, region.names)))
    except InputError:  # an operation that the claim grammar does not have: the prover reports it
        smooth = sigma
    return ca.jacobian(smooth, stack.eta)


def _gram(A: ca.SX) -> ca.SX:
    product = ca.densify(A @ A.T)
    return ca.simplify(product if product.numel() == 1 else ca.det(product))


def _claim(region: Region, name: str, left: ca.SX, right: ca.SX) -> Claim:
    used = {s.element_hash() for s in ca.symvar(ca.vertcat(left, right))}
    variables = tuple(
        Variable(_name(name), region.symbols[k], "1", float(region.lower[k]), float(region.upper[k]), "of the region")
        for k, name in enumerate(region.names)
        if region.symbols[k].element_hash() in used or k == 0
    )
    return Claim(name, "a task is independent of the tasks above it", "(16)", (), "proved", variables, left, right, "1")


def _name(name: str) -> str:
    # the certificate's grammar accepts only letters, digits and _
    return "".join(c if c.isalnum() or c == "_" else "_" for c in name)


# The blocks M_ij = J_i N_1 ⋯ N_{j−1} J_j⁺ of the error dynamics of a stack, computed at samples of a region.
#
# M_ij is the effect of task j on the error of task i; `conditions` explains the symbols.


Array = NDArray[np.float64]

_ZERO = 1e-9


@dataclass(frozen=True, eq=False)
class Coupling:
    """Effect of the tasks of a stack on each other's errors.

    Attributes:
        own: (n,) least eigenvalue of the symmetric part of M_ii over the samples.
        sine: (n,) least product of the sines of the angles between a task and the joint space of all tasks above it.
        worst: for each task, the state with the least product of sines.
        most: (n, n) largest ‖M_ij‖ for i ≠ j.
        commuting: for each task, whether its projector commutes with those of the tasks above, by an identity of the
            expressions.
        orthogonal: pairs (i, j), i < j, of tasks that are orthogonal by an identity of the expressions.
    """

    own: tuple[float, ...]
    sine: tuple[float, ...]
    worst: tuple[dict[str, float], ...]
    most: Array
    commuting: tuple[bool, ...]
    orthogonal: frozenset[tuple[int, int]]

    @property
    def exact(self) -> bool:
        """Return whether an identity of the expressions shows that no lower task disturbs a higher task."""
        return all(self.commuting)

    @property
    def triangular(self) -> bool:
        """Return whether no lower task disturbs a higher task in any sample."""
        return not any(self.from_below(i) for i in range(len(self.own)))

    @property
    def small_gain(self) -> bool:
        """Return whether the comparison matrix is a non-singular M-matrix."""
        return comparison_converges(np.array(self.own), self.most)

    def from_below(self, i: int) -> dict[int, float]:
        """Return the lower tasks that disturb task i, with the size ‖M_ij‖ of each disturbance."""
        if self.exact:
            return {}
        return {j: float(self.most[i, j]) for j in range(i + 1, len(self.own)) if self.most[i, j] > _ZERO}

    def untouched_below(self, i: int) -> bool:
        """Return whether an identity of the expressions shows that no lower task disturbs task i.

        The result is true for the first task, and for every task if all projectors commute. It is also true if each
        task after task i is orthogonal to all tasks that precede that later task.
        """
        apart = ((a, b) in self.orthogonal for b in range(i + 1, len(self.own)) for a in range(b))
        return self.exact or i == 0 or all(apart)

    def commuting_above(self, i: int) -> bool:
        """Return whether an identity of the expressions shows that N_1 ⋯ N_{i−1} is a projector.

        The eigenvalues of M_ii are then squared sines of angles between task i and the tasks above.
        """
        return all(self.commuting[:i])


def comparison_converges(own: Array, most: Array) -> bool:
    """Return whether the comparison matrix is a non-singular M-matrix, that is, all its leading minors are positive.

    The comparison matrix is diag(own) minus the off-diagonal part of `most`.
    """
    matrix = np.diag(own) - most * (1 - np.eye(len(own)))
    return all(np.linalg.det(matrix[:k, :k]) > 1e-12 for k in range(1, len(own) + 1))


def couplings(stack: Stack, region: Region, *, samples: int, seed: int) -> Coupling:
    """Return the effects of a stack's tasks on each other's errors over a region.

    Args:
        stack: tasks with one reference each.
        region: region of the stack's states and parameters.
        samples: number of samples.
        seed: seed of the samples.
    """
    field = build_field(stack, region)
    points = region.place(region.sample(samples, seed))
    values = field.at(points)
    J, count = values.jacobians, len(stack.tasks)
    plus = [np.linalg.pinv(j, rcond=1e-9) for j in J]
    nullspace = np.tile(np.eye(4), (len(points), 1, 1))  # N_1 ⋯ N_{j−1}
    own, most = np.zeros(count), np.zeros((count, count))
    sine, worst = [], []
    for j in range(count):
        arm = nullspace @ plus[j]
        for i in range(count):
            block = J[i] @ arm
            if i == j:
                own[i] = np.linalg.eigvalsh((block + block.swapaxes(1, 2)) / 2).min()
            else:
                most[i, j] = np.linalg.norm(block, 2, axis=(1, 2)).max()
        product = outside_sines(directions(J[j]), projector_above(values, j))[:, : stack.tasks[j].size].prod(axis=1)
        sine.append(float(product.min()))
        worst.append(region.pose(points[int(product.argmin())]))
        nullspace = nullspace @ (np.eye(4) - plus[j] @ J[j])
    return Coupling(
        tuple(map(float, own)), tuple(sine), tuple(worst), most, commuting_levels(stack),
        frozenset(orthogonal_pairs(stack)),
    )  # fmt: skip


Kind = Literal["orthogonal", "independent", "dependent"]
Shown = Literal["identity", "proved", "samples", "witness"]
Outcome = Literal["converges", "converges on samples", "need not converge"]

_DEPENDENT = 1e-3  # a sine below this value counts as 0
_PROVED_SHARE = 0.9  # share of the least sampled sine that the prover tries to prove


@dataclass(frozen=True)
class PairCondition:
    """The relation of two tasks over a region of states.

    Attributes:
        first, second: names of the tasks, the higher priority first.
        kind: orthogonal: neither task disturbs the other; independent: both tasks can be achieved at once; dependent:
            in some state both tasks cannot be achieved at once.
        shown: evidence for the kind: an identity of the expressions, a proof, samples alone, or a witness state.
        sine: lower bound on the sine of the angle between the tasks: the proved bound or, without a proof, the least
            sampled value; 0 for `dependent`.
        where: the witness state for `dependent`, otherwise the state with the least sampled sine; empty for an
            identity.
    """

    first: str
    second: str
    kind: Kind
    shown: Shown
    sine: float
    where: dict[str, float]

    @property
    def sentence(self) -> str:
        """Return the verdict in one line."""
        by = {"identity": "everywhere, by identity", "proved": "proved on the region", "samples": "on all samples"}
        both = f"{self.first} and {self.second}"
        if self.kind == "dependent":
            return f"{both}: dependent (algorithmic singularity) at {pose_text(self.where)}"
        size = "" if self.kind == "orthogonal" else f", sine of their angle at least {self.sine:.3g}"
        return f"{both}: {self.kind} {by[self.shown]}{size}"


@dataclass(frozen=True)
class LevelCondition:
    """The convergence of one task under the null-space law.

    Attributes:
        task: name of the task.
        outcome: whether the task converges for a target at rest, while the state stays in the region.
        shown: the weakest kind of evidence that the outcome depends on.
        tracks: whether the task also tracks a moving target exactly, because no other task disturbs it.
        keeps: lower bound on the share of the task's own gain that higher tasks leave to the task; 0 if higher tasks
            may remove one of its directions.
        disturbed_by: mapping from the name of each lower task that disturbs this task to the size of the disturbance,
            the largest sampled ‖M_ij‖.
        reason: reason for the outcome, in words.
        where: a state in which higher tasks remove one of the task's directions; empty if no such state is known.
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
        """Return the verdict in one line."""
        at = f" at {pose_text(self.where)}" if self.where else ""
        moving = "" if self.tracks or self.outcome == "need not converge" else ", for targets at rest"
        return f"{self.task}: {self.outcome}{moving}; {self.reason}{at}"


@dataclass(frozen=True)
class StackConditions:
    """The convergence conditions of a whole stack.

    Attributes:
        tasks: names of the tasks, highest priority first.
        pairs: one condition for each pair of tasks.
        levels: one condition for each task.
        triangular: whether no lower task disturbs a higher one, so that any positive gains are allowed.
        small_gain: whether the comparison matrix, computed from the samples, is a non-singular M-matrix.
        samples: number of samples from which the sampled numbers come.
    """

    tasks: tuple[str, ...]
    pairs: tuple[PairCondition, ...]
    levels: tuple[LevelCondition, ...]
    triangular: bool
    small_gain: bool
    samples: int

    @property
    def converges(self) -> bool:
        """Return whether every task converges, by proof or in all samples."""
        return all(level.outcome != "need not converge" for level in self.levels)

    def to_dict(self) -> dict[str, Any]:
        """Return the conditions as plain data for JSON."""
        return {**asdict(self), "converges": self.converges}

    def lines(self) -> list[str]:
        """Return the lines of a printed report."""
        gains = "any positive gains are allowed" if self.triangular else "lower tasks disturb higher ones"
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
    """Return the relation of each pair of tasks and the convergence of each task over a region of states.

    Args:
        stack: tasks with one reference each.
        region: lower corner and upper corner of the pose η, two vectors (4,) [m, m, m, rad] in {E}.
        parameters: (symbol, lower, upper) of every other symbol in the tasks.
        samples: number of samples.
        seed: seed of the samples.
        time_limit: time limit of each proof of independence [s].

    Raises:
        InputError: `surctl.priority.diagnosis.diagnose` raises this error.
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
        assert isinstance(task, Task)  # `diagnose` refuses set-based tasks
        above = [pairs[j, i] for j in range(i)]
        own = partial(prove_strength, stack, box, i, time_limit=time_limit)
        levels.append(_level(stack, diagnosis, coupled, above, i, partial(proved, range(i), i), own))
    for i, level in enumerate(levels):
        lost = [other.task for other in levels[:i] if other.outcome == "need not converge"]
        if lost and level.outcome != "need not converge" and not level.tracks:
            levels[i] = LevelCondition(
                level.task, "need not converge", "samples", False, level.keeps, level.disturbed_by,
                f"{level.reason}; but it is disturbed by {', '.join(lost)} above it, which need not converge",
                level.where,
            )  # fmt: skip
    touched = [_names_in(box, task) for task in stack.tasks]
    shown = [_only(pair, touched[i] | touched[j]) for (i, j), pair in pairs.items()]
    levels = [_only(level, set().union(*touched[: i + 1])) for i, level in enumerate(levels)]
    return StackConditions(
        stack.names, tuple(shown), tuple(levels), coupled.triangular, coupled.small_gain, diagnosis.samples
    )


def _only(condition: Any, names: set[str]) -> Any:
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
        return said("need not converge", "witness", 0.0, "its own Jacobian is singular", where)
    if lost is not None or dependent or diagnosis.levels[i].rank < stack.tasks[i].size:
        where = lost.poses[0] if lost is not None else coupled.worst[i]
        return said("need not converge", "witness", 0.0, "the tasks above use one of its directions", where)
    if free:
        shown: Shown = "identity" if all(p.shown == "identity" for p in above) else "samples"
        sure = shown == "identity" and coupled.untouched_below(i) and regular()
        word: Outcome = "converges" if sure else "converges on samples"
        return said(word, shown if sure else "samples", 1.0, "no task above acts on it, so its rate is its own gain")
    if disturbed and not coupled.small_gain:
        return said("need not converge", "samples", own, f"the small-gain condition fails for {', '.join(disturbed)}")
    if disturbed:
        reason = f"disturbed by {', '.join(disturbed)}, but the small-gain condition holds for all scalar gains"
        return said("converges on samples", "samples", own, reason)
    sine = coupled.sine[i]
    formed = _gram_is_constant(stack, i) and _gains_are_equal(stack, i)
    shown_sine = proved(sine) if coupled.untouched_below(i) and coupled.commuting_above(i) and formed else 0.0
    if shown_sine > 0:
        reason = f"independent of all tasks above it, it keeps at least {shown_sine**2:.3g} of its gain"
        return said("converges", "proved", shown_sine**2, reason)
    why = "" if formed else "; a proof needs a constant J Jᵀ and equal, constant gains"
    return said("converges on samples", "samples", own, f"it keeps at least {own:.3g} of its gain on the samples{why}")
