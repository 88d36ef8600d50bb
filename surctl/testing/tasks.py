"""Check tasks: Jacobian, reference, angle wrap."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, check_count
from surctl.tasks import SetTask, Task
from surctl.tasks.ranges import Parameter, SampledExpressions, SymbolRanges, ranges_of
from surctl.tasks.task import axis_names, is_pose
from surctl.testing.ranges import CheckFailed
from surctl.units import as_numbers

Array: TypeAlias = NDArray[np.float64]

_STEPS = (1e-4, 1e-5, 1e-6)  # of the differences: for one of them both rounding and curvature errors are small
_OFFSETS = (0.0, 1e-12, 1e-9, 1e-6)  # offsets from the poses in `near`
_SAME = 1e-9
_DEPENDENT = 1e-9


@dataclass(frozen=True)
class TaskReport:
    """Properties of a task that passed the check.

    Attributes:
        name: name of the task. size: number of entries of the task function σ.
        samples: number of poses at which σ was differentiated.
        derivative_error: largest difference between J and the central differences of σ, relative to 1 + max |J|.
        rank: largest rank of J found.
        least_rank: smallest rank of J found; smaller than `rank` at a singular pose. least_rank_at: the pose with this
            rank.
    """

    name: str
    size: int
    samples: int
    derivative_error: float
    rank: int
    least_rank: int
    least_rank_at: str


def check_task(
    task: Task | SetTask | Callable[[ca.SX], Task | SetTask],
    *,
    parameters: Sequence[Parameter] = (),
    near: Sequence[Sequence[float]] = (),
    samples: int = 50,
    extent: float = 3.0,
    full_turn: bool = True,
    tol: float = 1e-6,
    seed: int = 0,
) -> TaskReport:
    """Check a task, or the task that a function returns for a symbolic pose eta.

    At random poses, the Jacobian J must equal the central differences of the task function σ along the motion due to
    each velocity. For a pose, the check has its own implementation of equations (1)–(2) of the paper; `kinematics` that
    the task states are taken as they are. σ, J and
    reference must be finite (a set-based task may have no lower or no upper bound; its bounds must not cross), and an
    angular error must lie in [−π, π]. A full turn of the vehicle must not change J or the reference. At the poses in
    `near`, and close to these poses, all values must be finite.

    Args:
        task: the task, or a function that returns the task for the pose eta, SX (4, 1).
        parameters: (symbol, lowest, highest) for every symbol except eta.
        near: configurations (m,) at or near singularities, for example a pose at a waypoint.
        extent: largest |x|, |y|, |z| of random poses [m], ψ is in (−π, π); largest entry of other configurations.
        full_turn: False for a task that counts turns, for example one that unwinds a tether.
        tol: largest accepted error of J, relative to 1 + max |J|.

    Raises:
        CheckFailed: a check fails; the message states the first failure.
        InputError: the object is not a task, or its class raises an error; a symbol has no range or two ranges; there
            are no samples; a pose in `near` has a wrong number of entries.

    Example:
        >>> import casadi as ca
        >>> from surctl.tasks import Task, heading_task
        >>> from surctl.testing import check_task
        >>> report = check_task(lambda eta: heading_task(eta, 0.4))
        >>> report.name, report.size, report.samples
        ('heading', 1, 50)
        >>> # angular=True is missing
        >>> check_task(lambda eta: Task(name="yaw", eta=eta, sigma=eta[3], target=0.4, kinematics="vehicle"))
        Traceback (most recent call last):
            ...
        surctl.testing.ranges.CheckFailed: ...the reference changes when the vehicle makes a full turn ...
    """
    check_count("samples", samples, least=1)
    built = task(ca.SX.sym("eta", 4)) if callable(task) else task
    if not isinstance(built, Task | SetTask):
        raise InputError("is neither a Task nor a SetTask", key="task", value=built)
    m, vehicle = int(built.eta.shape[0]), is_pose(built.eta, built.mapping)
    poses = [as_numbers(pose, key=f"near[{place}]", size=m) for place, pose in enumerate(near)]
    box = [extent, extent, extent, math.pi] if vehicle else [extent] * m
    ranges = ranges_of([(built.eta, [-b for b in box], box), *parameters])
    check = _Check(built, ranges, SampledExpressions(f"task {built.name}", ranges, _expressions(built)))
    rng = np.random.default_rng(seed)
    worst, ranks = 0.0, []
    for values in ranges.draw(rng, samples):
        _, J, _, _, _ = check.finite(values)
        worst = max(worst, check.derivative(values, J, tol))
        if full_turn and vehicle:
            check.full_turn(values)
        ranks.append((_rank(J), values))
    for pose in poses:
        for offset in _OFFSETS:
            values = ranges.draw(rng, 1)[0]
            values[:m] = pose + offset * rng.uniform(-1, 1, m)
            _, J, _, _, _ = check.finite(values)
            ranks.append((_rank(J), values))
    least = min(ranks, key=lambda entry: entry[0])
    return TaskReport(built.name, built.size, samples, worst, max(r for r, _ in ranks), least[0], ranges.text(least[1]))


def _expressions(task: Task | SetTask) -> list[ca.SX]:
    # σ, J, lower and upper bound of σ̇, and error
    J = task.jacobian()
    if isinstance(task, SetTask):
        (lower, upper), error = task.slab(), ca.SX.zeros(task.size, 1)
    else:
        lower = upper = task.reference()
        error = task.error()
    for what, expression, shape in (
        ("J", J, (task.size, task.mapping.shape[1])),
        ("the reference", lower, (task.size, 1)),
        ("the reference", upper, (task.size, 1)),
    ):
        if expression.shape != shape:
            raise CheckFailed(f"task {task.name}", f"{what} has shape {expression.shape}, expected {shape}")
    return [task.sigma, J, lower, upper, error]


@dataclass(frozen=True)
class _Check:
    task: Task | SetTask
    ranges: SymbolRanges
    at: SampledExpressions

    def finite(self, values: Array) -> list[Array]:
        results = self.at(values)
        for what, part in zip(("sigma", "J"), results, strict=False):
            if not np.isfinite(part).all():
                row = np.flatnonzero(~np.isfinite(part).all(axis=1))[0]
                self._fail(f"{what} is not finite in row {row}", values)
        lower, upper, error = (part.reshape(-1) for part in results[2:])
        bad = ~np.isfinite(lower) | ~np.isfinite(upper)
        if isinstance(self.task, SetTask):
            bad = np.isnan(lower) | np.isnan(upper) | (lower == math.inf) | (upper == -math.inf)
        for i in np.flatnonzero(bad):
            self._fail(f"the reference is not finite in row {i}: {lower[i]:g} to {upper[i]:g}", values)
        for i in np.flatnonzero(lower > upper):
            self._fail(f"the bounds of row {i} cross: {lower[i]:g} > {upper[i]:g}", values)
        if self.task.angular and np.abs(error).max() > math.pi + _SAME:
            self._fail(f"the angular error {np.abs(error).max():g} is more than half a turn", values)
        return results

    def derivative(self, values: Array, J: Array, tol: float) -> float:
        measured = np.stack([self._differences(values, step) for step in _STEPS])
        error = np.abs(measured - J).min(axis=0) / (1.0 + np.abs(J).max())
        row, column = np.unravel_index(int(np.argmax(error)), error.shape)
        if not error[row, column] <= tol:
            best = measured[np.argmin(np.abs(measured[:, row, column] - J[row, column])), row, column]
            self._fail(
                f"row {row} of J is {J[row, column]:.9g} for {axis_names(J.shape[1])[column]}, "
                f"but sigma changes at a rate of {best:.9g}",
                values,
            )
        return float(error[row, column])

    def full_turn(self, values: Array) -> None:
        turned = values.copy()
        turned[3] += 2.0 * math.pi
        before, after = self.at(values), self.at(turned)
        for k, what in ((1, "J"), (2, "the reference"), (3, "the reference")):
            if not np.allclose(after[k], before[k], rtol=_SAME, atol=_SAME):
                remedy = "" if self.task.angular else " (is sigma an angle, angular=True?)"
                self._fail(f"{what} changes when the vehicle makes a full turn{remedy}", values)

    def _motion(self, eta: Array) -> Array:
        # directions (m, n) of η along each velocity
        if is_pose(self.task.eta, self.task.mapping):
            c, s = math.cos(eta[3]), math.sin(eta[3])
            return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=float)
        return np.array(ca.Function("S", [self.task.eta], [self.task.mapping])(eta), dtype=np.float64)

    def _differences(self, values: Array, step: float) -> Array:
        # central differences (k, n) of σ along each velocity
        m = int(self.task.eta.shape[0])
        columns = []
        for along in self._motion(values[:m]).T:
            move = np.zeros(values.size)
            move[:m] = step * along
            change = (self.at(values + move)[0] - self.at(values - move)[0]).reshape(-1)
            if self.task.angular:
                change = np.array([math.remainder(entry, 2.0 * math.pi) for entry in change])
            columns.append(change / (2.0 * step))
        return np.stack(columns, axis=1)

    def _fail(self, problem: str, values: Array) -> None:
        raise CheckFailed(f"task {self.task.name}", problem, at=self.ranges.text(values))


def _rank(J: Array) -> int:
    singular = np.linalg.svd(J, compute_uv=False)
    return int((singular > _DEPENDENT * max(1.0, float(singular[0]))).sum())
