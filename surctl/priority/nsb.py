"""The null-space-based behavioural (NSB) law, implemented as printed in the paper, equation (16)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.priority.problem import PriorityProblem
from surctl.priority.rowspace import CUTOFF, row_space

__all__ = ["nsb"]


def nsb(problem: PriorityProblem, *, cutoff: float = CUTOFF) -> NDArray[np.float64]:
    """Return the velocity v (n,) of the NSB law, equation (16) of the paper: v = v_1 + N_1(v_2 + N_2(v_3 + …)).

    Here v_i = J_i⁺x_i is the velocity for task i alone, J_i is its Jacobian, x_i its desired rate, and N_i = I −
    J_i⁺J_i the projector on the null space of J_i. Singular values of J_i below `cutoff`·‖J_i‖ count as 0. The law
    ignores limits.

    Raises:
        InputError: a level is set-based; equation (16) has no set-based tasks.

    Example:
        >>> import numpy as np
        >>> from surctl.priority import Level, build_problem, nsb
        >>> away = Level("away", np.array([[1.0, 0.0]]), np.array([0.0]))
        >>> goal = Level("goal", np.eye(2), np.array([0.3, 0.4]))
        >>> [nsb(build_problem(order)).round(3).tolist() for order in ([away, goal], [goal, away])]
        [[0.0, 0.4], [0.3, 0.4]]
    """
    v = np.zeros(problem.width)
    for level in reversed(problem.levels):
        if not level.is_goal:
            raise InputError(
                "is set-based, and the printed law has no such task", key=f"task {level.name}", remedy="use solve"
            )
        J_plus = row_space(level.J, cutoff=cutoff).pinv()
        N = np.eye(problem.width) - J_plus @ level.J
        v = J_plus @ level.x + N @ v
    return v
