"""The paper's law (16), null-space-based behaviours: as printed, and as a sweep of projections."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from surctl.priority.problem import Level, PriorityProblem
from surctl.priority.rowspace import CUTOFF, project, row_space

__all__ = ["nsb", "nsb_sweep"]


def nsb(problem: PriorityProblem, *, cutoff: float = CUTOFF) -> NDArray[np.float64]:
    """v (n,) of the printed law (16): v = v_1 + N_1(v_2 + N_2(v_3 + …)).

    v_i = J_i⁺x_i (15), N_i = I − J_i⁺J_i. Singular values below `cutoff`·‖J_i‖ count as 0. Rows (limits) are
    no part of this law.
    """
    v = np.zeros(problem.width)
    for level in reversed(problem.levels):
        J_plus = row_space(level.J, cutoff=cutoff).pinv()
        N = np.eye(problem.width) - J_plus @ level.J
        v = J_plus @ level.x + N @ v
    return v


def nsb_sweep(levels: Sequence[Level], *, width: int) -> NDArray[np.float64]:
    """The same v (width,) as one sweep of Euclidean projections, from the lowest priority to the highest.

    w_{k+1} = 0; w_i = argmin ‖z − w_{i+1}‖ over argmin ‖J_i z − x_i‖; v = w_1. Identical to (16), because
    J_i⁺x_i + N_i w is that projection. No level at all gives 0.
    """
    w = np.zeros(width)
    for level in reversed(levels):
        w = project(w, level.J, x=level.x)
    return w
