"""Radii of an equilibrium that is one only up to rounding, within which the slope rule shows the true one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import Rejected
from surctl.certcheck.enclosure import Undefined, span
from surctl.certcheck.slope_rows import Rows
from surctl.certcheck.slopes import quadratic_form
from surctl.lyapunov.claims import Bound, Stability
from surctl.lyapunov.dynamics import Range
from surctl.lyapunov.equilibrium import linearisation
from surctl.lyapunov.near import slowest
from surctl.verification.formula import Node, text_of

Array = NDArray[np.float64]

_NEAR = Fraction(1, 10**6)  # extent of the region in which the values are taken, relative to the ranges
_SPARE = 1.01
_SHARE = 1e-3  # of the rate of the slowest decay, which shows the radii of a claim without a rate


def drift(
    variables: Sequence[Range], values: Sequence[Node], at: Sequence[Fraction], rests: Sequence[Fraction]
) -> Array:
    """Return bounds on how far expressions are from `rests` at a point, for all parameters; 0 where they equal them.

    Args:
        variables: the n states, then the parameters.
        values: the expressions.
        at: values (n,) of the states.
        rests: values of the expressions at an equilibrium.

    Returns:
        The bounds; all are 0 if the checker cannot compute them.
    """
    n = len(at)
    far = [_NEAR * min(Fraction(s.upper) - x, x - Fraction(s.lower)) for s, x in zip(variables, at, strict=False)]
    cover = [[far[i] ** 2 * (i == j) for j in range(n)] for i in range(n)]
    box = [span(v.lower, v.upper) for v in variables]
    try:
        rows = Rows([v.name for v in variables], box, [text_of(value) for value in values], [cover], at, Fraction(1))
        return np.array([float(rows.size(rows.resting(k, rest))) for k, rest in enumerate(rests)])
    except (Rejected, Undefined):
        return np.zeros(len(rests))


def with_radii(claim: Stability | Bound) -> Stability | None:
    """Return a claim with radii of its equilibrium; None if that is exact, or V is no quadratic form about it."""
    d = claim.dynamics
    at = [s.rest for s in d.states]
    moves = drift(d.variables, d.rates, at, at if d.discrete else [Fraction(0)] * len(at))
    if not isinstance(claim, Stability) or not moves.any():
        return None
    try:
        p = np.array(quadratic_form(d.names, text_of(claim.function), at), dtype=float)
    except Rejected:
        return None
    rate = claim.rate or _SHARE * slowest(d, linearisation(d))[1]
    sizes = radii(norm(p, moves), np.linalg.inv(p)[None], rate)
    return replace(claim, radii=dict(zip(d.names, sizes.tolist(), strict=True)))


def radii(total: float, covers: Array, rate: float) -> Array:
    """Return radii (n,) for a bound on the drift in the norm of V, and a rate at which V decays.

    Args:
        total: bound on the drift.
        covers: the inverses (K, n, n) of the matrices of V and W.
        rate: the rate, as a share in discrete time.
    """
    extents = np.sqrt(np.diagonal(covers, axis1=1, axis2=2).max(axis=0))
    return np.array([float(f"{x:.2e}") for x in _SPARE * 2 * total / rate * extents])


def norm(p: Array, sizes: Array) -> float:
    """Return a bound on √(v' P v) for all |v_k| ≤ sizes_k."""
    return float(sizes @ np.sqrt(np.diag(p)))
