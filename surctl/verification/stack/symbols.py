"""Properties of a task that follow from its expressions, without evaluation at numbers."""

from __future__ import annotations

import casadi as ca

from surctl.priority.diagnosis.field import world_jacobians
from surctl.priority.diagnosis.findings import Region
from surctl.tasks import SetTask, Stack, Task

__all__ = ["gains_are_equal", "gram_is_constant", "names_in"]


def names_in(region: Region, task: Task | SetTask) -> set[str]:
    """Return the variables of the region on which the task function σ of the task depends."""
    return {name for k, name in enumerate(region.names) if ca.depends_on(task.sigma, region.symbols[k])}


def gram_is_constant(stack: Stack, i: int) -> bool:
    """Return whether the matrix J_i J_iᵀ of the Jacobian J_i of task i is constant or 1 × 1.

    Then V = σ̃ᵀ(J_i J_iᵀ)⁻¹σ̃, with the error σ̃ of the task, decreases if M_ii (see `conditions`) has positive
    eigenvalues.
    """
    A = world_jacobians(stack)[i]
    return bool(A.shape[0] == 1 or ca.simplify(A @ A.T).is_constant())


def gains_are_equal(stack: Stack, i: int) -> bool:
    """Return whether the gains of all entries of the task are equal and do not depend on the state."""
    task = stack.tasks[i]
    if not isinstance(task, Task):
        return False
    gain = ca.SX(task.gain)
    same = all(ca.is_equal(gain[k], gain[0], 4) for k in range(gain.numel()))
    return bool(same and not ca.depends_on(gain, stack.eta))
