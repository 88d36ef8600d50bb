"""Numeric evaluation of a task stack over a region: Jacobians, desired rates, and how fast Jacobian rows change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir import on_columns
from surctl.priority.diagnosis.region import Region, pose_text
from surctl.priority.diagnosis.structure import world_jacobians
from surctl.tasks import Stack

__all__ = ["Field", "Measure", "Values", "best_of", "build_field", "descend"]

Array: TypeAlias = NDArray[np.float64]

_STEP = 1e-7  # in units of the unit box, for finite differences
_APART = 0.1  # least distance between two starts, in unit boxes, times the root of the dimension


@dataclass(frozen=True, eq=False)
class Values:
    """Jacobians and desired rates of all tasks of a stack at N points (poses and parameters).

    Attributes:
        jacobians: Jacobians (N, k, 4) of each task.
        references: desired values (N, k) of σ̇ of each task [unit of σ per second].
        turning: length (N,) [m or rad] of a step in the pose η that may reverse a row of ∂σ/∂η, for each task: the
            smallest ‖a‖/‖∂a/∂η‖ over the rows a, inf if no row changes. The length goes to 0 at a singular point of the
            task, such as the point from which a distance is measured.
    """

    jacobians: list[Array]
    references: list[Array]
    turning: list[Array]


Measure: TypeAlias = Callable[[Values], Array]
"""A function that returns one non-negative number (N,) for each point; inf or NaN where it is undefined."""


@dataclass(frozen=True, eq=False)
class Field:
    """A task stack, compiled to a numeric function of pose and parameters, and the region of these variables.

    Attributes:
        names: names of the tasks. sizes: number of rows of each task. units: unit of σ̇ of each task.
        region: the region of poses and parameters.
        function: function of points (d, N) of the region. Its output is one array whose columns contain, for one task
            after another, the Jacobian column by column, the desired rate, and ‖a‖² and ‖∂a/∂η‖² of each row a of
            ∂σ/∂η.
    """

    names: tuple[str, ...]
    sizes: tuple[int, ...]
    units: tuple[str, ...]
    region: Region
    function: Callable[[Array], list[Array]]

    def at(self, points: Array) -> Values:
        """Evaluate all tasks at points (N, d); numbers that are not finite are returned unchanged."""
        column = self.function(points.T)[0].T
        values, start = Values([], [], []), 0
        for k in self.sizes:
            J, x, square, change = np.split(column[:, start : start + 7 * k], [4 * k, 5 * k, 6 * k], axis=1)
            values.jacobians.append(J.reshape(-1, 4, k).swapaxes(1, 2))
            values.references.append(x)
            moves = (change > 0.0) & (square > 0.0)
            ratio = np.where(moves, square, np.inf) / np.where(moves, change, 1.0)
            values.turning.append(np.sqrt(ratio.min(axis=1)))
            start += 7 * k
        return values

    def require_finite(self, values: Values, points: Array) -> None:
        """Raise an InputError that names task and pose if a Jacobian or a desired rate is not finite."""
        for name, J, x in zip(self.names, values.jacobians, values.references, strict=True):
            broken = np.flatnonzero(~(np.isfinite(J).all(axis=(1, 2)) & np.isfinite(x).all(axis=1)))
            if broken.size:
                where = pose_text(self.region.pose(points[broken[0]]))
                raise InputError(f"is not finite at {where}", key=f"task {name}", remedy="exclude that pose")


def build_field(stack: Stack, region: Region) -> Field:
    """Compile a task stack for evaluation over a region from `build_region`."""
    parts = []
    for (J, x), A in zip(stack.levels(), world_jacobians(stack), strict=True):
        square = ca.sum2(A**2)
        change = [ca.sumsqr(ca.jacobian(A[i, :], stack.eta)) for i in range(J.shape[0])]
        parts += [ca.vec(J), x, square, *change]
    column = ca.densify(ca.vertcat(*parts))
    function = on_columns(ca.Function("field", [region.symbols], [column]))
    sizes, units = tuple(task.size for task in stack.tasks), tuple(task.rate_unit for task in stack.tasks)
    return Field(stack.names, sizes, units, region, function)


def best_of(measure: Array, unit: Array, *, most: int) -> NDArray[np.intp]:
    """Return the indices of up to `most` samples with the smallest finite measures (N,), at some distance apart."""
    order = np.argsort(measure, kind="stable")
    left = order[np.isfinite(measure[order])]
    chosen: list[np.intp] = []
    while left.size and len(chosen) < most:
        chosen.append(left[0])
        distance = np.linalg.norm(unit[left] - unit[left[0]], axis=1)
        left = left[distance > _APART * np.sqrt(unit.shape[1])]
    return np.array(chosen, dtype=np.intp)


def descend(field: Field, measure: Measure, start: Array) -> tuple[Array, float]:
    """Return a point (d,) at which `measure` has a local minimum, and this minimum, by a search from `start` (f,).

    `start` is in the unit box: coordinates of the f free variables of the region, scaled to 0 … 1. The search uses
    L-BFGS-B with central differences on the squared measure, because a distance or a sine that reaches 0 is not smooth
    there, but its square is. The returned minimum is never larger than the measure at the start.
    """
    from scipy.optimize import minimize

    begin = _value(field, measure, start[None])[0]
    if not np.isfinite(begin) or begin == 0.0 or start.size == 0:
        return field.region.place(start[None])[0], float(begin)
    run = minimize(
        lambda u: _slope(field, measure, u, scale=begin),
        start,
        jac=True,
        bounds=[(0.0, 1.0)] * start.size,
        method="L-BFGS-B",
        options={"maxiter": 60, "ftol": 1e-18, "gtol": 1e-12},
    )
    end = np.asarray(run.x, dtype=float)
    reached = _value(field, measure, end[None])[0]
    point, value = (end, reached) if reached <= begin else (start, begin)
    return field.region.place(point[None])[0], float(value)


def _value(field: Field, measure: Measure, unit: Array) -> Array:
    """Return the measure (N,) at points of the unit box (the scaled region); inf where a Jacobian is not finite."""
    values = field.at(field.region.place(unit))
    finite = np.logical_and.reduce([np.isfinite(J).all(axis=(1, 2)) for J in values.jacobians])
    cleaned = [np.where(finite[:, None, None], J, 0.0) for J in values.jacobians]
    measured = measure(Values(cleaned, values.references, values.turning))
    return np.where(finite & ~np.isnan(measured), measured, np.inf)


def _slope(field: Field, measure: Measure, u: Array, *, scale: float) -> tuple[float, Array]:
    """Return q = min((m/scale)², 2) at a point u (f,) of the unit box, and the gradient (f,) of q with respect to u.

    u holds the f free variables of the region, scaled to 0 … 1. m is the value of the function `measure` at u; inf if a
    Jacobian is not finite or the value is NaN. `scale` > 0 is a constant divisor. The gradient is computed by finite
    differences.
    """
    steps = _STEP * np.eye(u.size)
    around = np.clip(np.vstack([u[None], u + steps, u - steps]), 0.0, 1.0)
    # where the measure is undefined it is capped at a value just high enough to shorten a step that ends there
    values = np.minimum((_value(field, measure, around) / scale) ** 2, 2.0)
    ahead, behind = values[1 : u.size + 1], values[u.size + 1 :]
    width = (around[1 : u.size + 1] - around[u.size + 1 :]).diagonal()
    return float(values[0]), (ahead - behind) / width
