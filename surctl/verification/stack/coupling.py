"""The blocks M_ij = J_i N_1 ⋯ N_{j−1} J_j⁺ of the error dynamics of a stack, computed at samples of a region.

M_ij is the effect of task j on the error of task i; `conditions` explains the symbols.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.priority.diagnosis.field import (
    build_field,
    commuting_levels,
    directions,
    orthogonal_pairs,
    outside_sines,
    projector_above,
)
from surctl.priority.diagnosis.findings import Region
from surctl.tasks import Stack

__all__ = ["Coupling", "comparison_converges", "couplings"]

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
