"""The set of velocities that a lower priority level may still choose without a change to the higher levels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.backends import Backend, LeastDistance, solve_least_distance
from surctl.priority.polyhedron import Polyhedron
from surctl.priority.rowspace import row_space

__all__ = ["Freedom"]

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Freedom:
    """The affine set of velocities v = base + Z y, where y is arbitrary.

    Attributes:
        base: (n,), one velocity of the set.
        Z: (n, d), orthonormal columns: the directions in which v is free.
        fixed: (n − d, n), orthonormal rows: the directions in which v is fixed.
    """

    base: Array
    Z: Array
    fixed: Array

    @staticmethod
    def whole(n: int) -> Freedom:
        """Return the set of all velocities (n,)."""
        return Freedom(np.zeros(n), np.eye(n), np.zeros((0, n)))

    def narrowed(self, J: Array, x: Array, *, cutoff: float) -> Freedom:
        """Return the subset of velocities that minimise ‖J v − x‖, for a task with Jacobian J (k, n).

        Singular values of J Z below `cutoff`·‖J‖ count as 0. The cut-off is relative to ‖J‖ and not to ‖J Z‖, because J
        Z contains only rounding errors if the task has no freedom left.
        """
        if J.shape[0] == 0:
            return self
        scale = float(np.linalg.norm(J, 2))
        space = row_space(J @ self.Z, cutoff=cutoff, scale=scale)
        base = self.base + self.Z @ space.particular(x - J @ self.base)
        return Freedom(base, self.Z @ space.null.T, np.vstack([self.fixed, space.rows @ self.Z.T]))

    def nearest(self, target: Array, rows: Polyhedron, *, backend: Backend) -> LeastDistance:
        """Return the velocity of the set that satisfies the constraint rows and is nearest to `target` (n,)."""
        return solve_least_distance(
            target,
            A=rows.A,
            lower=rows.lower,
            upper=rows.upper,
            A_eq=self.fixed,
            b_eq=self.fixed @ self.base,
            backend=backend,
        )
