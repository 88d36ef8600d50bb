"""First functions of a template by linear programs over samples, where the linearisation gives no quadratic one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.lyapunov.rays import grid
from surctl.lyapunov.template import Template, polynomials

__all__ = ["sampled_function", "without_neutral"]

Array = NDArray[np.float64]

_PARTS = (0.5, 0.2, 0.05)  # radii of the sampled ball, relative to the box
_ORDERS = (2, 4)  # V and its decrease are bounded below by multiples of r^order
_FLAT = 1e-9  # singular values below this share of the largest one count as 0
_LEAST = 1e-7  # least multiple, for scaled coefficients of at most 1


def sampled_function(template: Template, scales: Array, corners: Array, *, half: bool, matrices: Array) -> Array | None:
    """Return coefficients (K,) with which V is positive and decreases at samples close to the equilibrium, or None.

    The linear program maximises t with V ≥ t r^p and V' ≤ −t r^q, or V⁺ − V ≤ −t r^q, at all samples.

    Args:
        template: the template.
        scales: lengths (n,) of the states.
        corners: values (m, C) of the parameters.
        half: whether dynamics and template are symmetric to the equilibrium.
        matrices: Jacobians (C, n, n) of the dynamics.
    """
    from scipy.optimize import linprog

    n, count = len(scales), len(template.basis)
    level = _neutral(template, scales, matrices)
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
                    A_eq=np.column_stack([level / size, np.zeros(len(level))]), b_eq=np.zeros(len(level)),
                    bounds=[(-1, 1)] * count + [(0, 1)], method="highs",
                )  # fmt: skip
                if run.status == 0 and run.x[-1] > _LEAST:
                    return np.asarray(run.x[:-1] / size)
    return None


def without_neutral(template: Template, scales: Array, matrices: Array) -> Template:
    """Return the template without the products whose coefficient has to be 0 by the equations of `_neutral`.

    Args:
        template: the template.
        scales: lengths (n,) of the states.
        matrices: Jacobians (C, n, n) of the dynamics.
    """
    used = np.abs(_neutral(template, scales, matrices)) > _FLAT
    keep = np.ones(len(template.basis), dtype=bool)
    while True:
        alone = used[(used & keep).sum(axis=1) == 1]
        if not alone.size or not (keep & alone.any(axis=0)).any():
            break
        keep &= ~alone.any(axis=0)
    basis = tuple(node for node, stays in zip(template.basis, keep, strict=True) if stays)
    return Template(template.dynamics, basis, template.sizes[keep])


def _neutral(template: Template, scales: Array, matrices: Array) -> Array:
    """Return the rows (k, K) of equations without which V' is not negative close to the equilibrium.

    Along a direction v with A v = 0, the second order of V' = z'(A'P + P A)z vanishes, so that (A'P + P A)v = A'P v
    has to be 0: else V' changes its sign close to v. In discrete time, A − I takes the place of A.
    """
    n = len(scales)
    place = {node: k for k, node in enumerate(template.basis)}
    products = polynomials(template.dynamics, 2, scales).basis
    total = [np.zeros((0, len(place)))]
    for matrix in matrices:
        a = (matrix - np.eye(n) if template.dynamics.discrete else matrix) * scales / scales[:, None]
        _, sizes, directions = np.linalg.svd(a)
        for v in directions[sizes <= _FLAT * max(float(sizes.max()), 1e-300)]:
            equations = np.zeros((n, len(place)))
            for node, i, j in zip(products, *np.triu_indices(n), strict=True):
                if node in place:
                    # in scaled states, the coefficient of a product counts as much as its monomial
                    equations[:, place[node]] = scales[i] * scales[j] * (a[i] * v[j] + a[j] * v[i]) / 2
            total.append(equations[np.abs(equations).max(axis=1) > 0])
    return np.vstack(total)
