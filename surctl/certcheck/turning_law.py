"""The path-following law and the velocity loop of a certificate, at arrays of states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.braking_claim import GuardedLaw
from surctl.certcheck.turning_claim import TurningClaim

__all__ = ["followed", "velocity_loop"]

Array = NDArray[np.float64]


def followed(law: TurningClaim, limit: Sequence[Any] | Array, state: Array, psi: Array) -> Array:
    """Return the thrust (n, 2) [N] that a law commands on each axis of the body.

    Args:
        law: the claim about the law.
        limit: thrust limits (surge, sway) [N].
        state: (x_e, y_e, U_x, U_y) (n, 4), with the velocity U in the path frame.
        psi: angle (n,) from the path to the heading.
    """
    x_e, y_e, along, across = state.T
    k1, lookahead, cruise, cap = (float(x) for x in (law.k1, law.lookahead, law.cruise, law.cap))
    slant = np.sqrt(1 + (y_e / lookahead) ** 2)
    speed = np.minimum(np.maximum(cruise - k1 * x_e, 0), cap / slant)
    c, s = np.cos(psi), np.sin(psi)
    desired, nu = (
        np.array([c * first + s * second, -s * first + c * second])
        for first, second in ((speed, -speed * y_e / lookahead), (along, across))
    )
    return velocity_loop(law, limit, desired, nu).T


def velocity_loop(law: TurningClaim | GuardedLaw, limit: Sequence[Any] | Array, desired: Array, nu: Array) -> Array:
    """Return the thrust (2, n) [N] in surge and sway, for desired and true velocities (2, n) in the body frame."""
    mass, linear, quadratic, most = (
        np.array(pair, dtype=float)[:, None] for pair in (law.mass, law.linear, law.quadratic, limit)
    )
    free = linear * desired + quadratic * desired * np.abs(desired) + mass * float(law.k_v) * (desired - nu)
    return np.asarray(np.clip(free, -most, most))
