"""The polyhedron {v : lower ≤ A v ≤ upper} of velocities that satisfy the limits, with rows of A scaled to length 1."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.problem import PriorityProblem
from surctl.priority.rowspace import ZERO_ROW
from surctl.tasks.limits import Kind

__all__ = ["Polyhedron", "polyhedron_of"]

Array: TypeAlias = NDArray[np.float64]

_ROUNDING = 1e-8


@dataclass(frozen=True, eq=False)
class Polyhedron:
    """Constraint rows lower ≤ a·v ≤ upper, scaled to ‖a‖ = 1 so that a violation is a velocity, with names and kinds.

    Attributes:
        A: (m, n), one normal a in each row. lower, upper: (m,), bounds. length: (m,), ‖a‖ before scaling.
        kinds, names: kind and name of each constraint row (m,).
        box: lower and upper bound (n,) of each velocity, from the actuator limits that bound a single velocity; ±inf
            where there is no such limit.
    """

    A: Array
    lower: Array
    upper: Array
    length: Array
    kinds: tuple[Kind, ...]
    names: tuple[str, ...]
    box: tuple[Array, Array]

    @staticmethod
    def none(n: int) -> Polyhedron:
        """Return the set of all velocities (n,), which has no constraint row."""
        nothing, unbounded = np.zeros(0), np.full(n, np.inf)
        return Polyhedron(np.zeros((0, n)), nothing, nothing, nothing, (), (), (-unbounded, unbounded))

    @property
    def width(self) -> int:
        """Return the number of velocities n."""
        return int(self.A.shape[1])

    def violation(self, v: Array) -> Array:
        """Return the amount (m,) by which v (n,) violates each constraint row; 0 if v satisfies the row."""
        value = self.A @ v
        return np.maximum(np.maximum(self.lower - value, value - self.upper), 0.0)

    def missed(self, v: Array) -> dict[str, float]:
        """Return the violation of each limit that v violates by more than rounding, by name, in the limit's unit."""
        amount = self.violation(v)
        tolerance = _ROUNDING * (1.0 + float(np.abs(v).max()))
        return {self.names[i]: float(amount[i] * self.length[i]) for i in np.flatnonzero(amount > tolerance)}

    def contains(self, v: Array) -> bool:
        """Return whether v satisfies every constraint row exactly, without tolerance; False if v contains a NaN."""
        value = self.A @ v
        return bool(((self.lower <= value) & (value <= self.upper)).all())

    def mask(self, *kinds: Kind) -> NDArray[np.bool_]:
        """Return a mask (m,) that is true for the constraint rows of these kinds."""
        return np.array([kind in kinds for kind in self.kinds], dtype=bool)

    def relaxed(self, rows: NDArray[np.bool_], by: float) -> Polyhedron:
        """Return the set with both bounds of the chosen constraint rows moved outwards by `by`."""
        move = np.where(rows, by, 0.0)
        return replace(self, lower=self.lower - move, upper=self.upper + move)

    def holding(self, v: Array) -> Polyhedron:
        """Return the set with bounds widened by rounding errors so that v, which must be feasible, satisfies them."""
        value = self.A @ v
        return replace(self, lower=np.minimum(self.lower, value), upper=np.maximum(self.upper, value))

    def only(self, rows: NDArray[np.bool_]) -> Polyhedron:
        """Return the set that the chosen constraint rows alone define."""
        chosen = np.flatnonzero(rows)
        return replace(
            self,
            A=self.A[chosen],
            lower=self.lower[chosen],
            upper=self.upper[chosen],
            length=self.length[chosen],
            kinds=tuple(self.kinds[i] for i in chosen),
            names=tuple(self.names[i] for i in chosen),
        )

    def also(self, J: Array, lower: Array, upper: Array, *, names: Sequence[str]) -> Polyhedron:
        """Return the set with k additional constraint rows lower ≤ J v ≤ upper, J (k, n), of kind "set"."""
        length = _lengths(J)
        kind: Kind = "set"
        return replace(
            self,
            A=np.vstack([self.A, J / length[:, None]]),
            lower=np.append(self.lower, lower / length),
            upper=np.append(self.upper, upper / length),
            length=np.append(self.length, length),
            kinds=(*self.kinds, *((kind,) * length.size)),
            names=(*self.names, *names),
        )

    def widened(self, J: Array, lower: Array, upper: Array) -> Polyhedron:
        """Return the set of all (v, s) that satisfy the limits on v and lower ≤ J v + s ≤ upper, J (k, n), s (k,)."""
        k = J.shape[0]
        wide = replace(self, A=np.hstack([self.A, np.zeros((self.A.shape[0], k))]))
        return wide.also(np.hstack([J, np.eye(k)]), lower, upper, names=["slack"] * k)

    def clamp(self, v: Array) -> Array:
        """Return v with each velocity clipped to the bounds `box`."""
        clamped: Array = np.clip(v, *self.box)
        return clamped


def polyhedron_of(problem: PriorityProblem) -> Polyhedron:
    """Return the limits of the problem as constraint rows of length 1.

    A constraint row with normal 0 is not scaled; all velocities satisfy this row, or none does.
    """
    rows, n = problem.rows, problem.width
    A = np.array([row.a for row in rows]).reshape(len(rows), n)
    length = _lengths(A)
    lower = np.array([row.lower for row in rows], dtype=float) / length
    upper = np.array([row.upper for row in rows], dtype=float) / length
    A = np.where(_is_zero(A), 0.0, A / length[:, None])
    kinds = tuple(row.kind for row in rows)
    return Polyhedron(A, lower, upper, length, kinds, tuple(r.name for r in rows), _box(A, lower, upper, kinds))


def _lengths(A: Array) -> Array:
    # a row of zeros gets length 1
    largest = np.abs(A).max(axis=1, initial=0.0)
    largest[largest == 0.0] = 1.0
    scaled = A / largest[:, None]  # without this scaling the square of a row of 1e155 would overflow
    length: Array = largest * np.sqrt(np.einsum("ij,ij->i", scaled, scaled))
    length[_is_zero(A)[:, 0]] = 1.0
    return length


def _is_zero(A: Array) -> NDArray[np.bool_]:
    zero: NDArray[np.bool_] = np.abs(A).max(axis=1, initial=0.0, keepdims=True) <= ZERO_ROW
    return zero


def _box(A: Array, lower: Array, upper: Array, kinds: tuple[Kind, ...]) -> tuple[Array, Array]:
    # of two limits that contradict each other the earlier one is harder, as in `build_problem`
    low, high = np.full(A.shape[1], -math.inf), np.full(A.shape[1], math.inf)
    for i in np.flatnonzero(np.count_nonzero(A, axis=1) == 1):
        if kinds[i] != "actuator":
            continue
        j = int(np.flatnonzero(A[i])[0])
        ends = (lower[i], upper[i]) if A[i, j] > 0.0 else (-upper[i], -lower[i])
        low[j], high[j] = np.clip(ends, low[j], high[j])
    return low, high
