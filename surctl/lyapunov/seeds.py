"""First functions of a template by linear programs over samples, where the linearisation gives no quadratic one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.lyapunov.rays import grid
from surctl.lyapunov.template import Template

__all__ = ["sampled_function"]

Array = NDArray[np.float64]

_PARTS = (0.5, 0.2, 0.05)  # radii of the sampled ball, relative to the box
_ORDERS = (2, 4)  # V and its decrease are bounded below by multiples of r^order
_LEAST = 1e-7  # least multiple, for scaled coefficients of at most 1


def sampled_function(template: Template, scales: Array, corners: Array, *, half: bool) -> Array | None:
    """Return coefficients (K,) with which V is positive and decreases at samples close to the equilibrium, or None.

    The linear program maximises t with V ≥ t r^p and V' ≤ −t r^q, or V⁺ − V ≤ −t r^q, at all samples.

    Args:
        template: the template.
        scales: lengths (n,) of the states.
        corners: values (m, C) of the parameters.
        half: whether dynamics and template are symmetric to the equilibrium.
    """
    from scipy.optimize import linprog

    n, count = len(scales), len(template.basis)
    for part in _PARTS:
        rays = 64 if n == 2 else 2 if n == 1 else 256
        samples = grid(
            template, scales, rays=rays, points=10, corners=corners, outer=np.full(rays, part), half=half, beyond=0
        )
        size = np.abs(samples.values).max(axis=1)
        values = samples.values / size[:, None]
        changes = samples.changes / size[:, None]
        r = np.sqrt(samples.square) / part
        for p in _ORDERS:
            for q in (p, p + 2):
                # rows divided by r^order, so that samples close to the equilibrium count as much as the others
                rows = [np.column_stack([-(values / r**p).T, np.ones(r.size)])]
                rows += [np.column_stack([(change / r**q).T, np.ones(r.size)]) for change in changes]
                matrix = np.vstack(rows)
                run = linprog(
                    np.append(np.zeros(count), -1.0), A_ub=matrix, b_ub=np.zeros(len(matrix)),
                    bounds=[(-1, 1)] * count + [(0, 1)], method="highs",
                )  # fmt: skip
                if run.status == 0 and run.x[-1] > _LEAST:
                    return np.asarray(run.x[:-1] / size)
    return None
