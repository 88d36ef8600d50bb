"""The path-following law of a certificate, at arrays of states."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Follower", "followed"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Follower:
    """The numbers of the path-following law; SI units, pairs are (surge, sway)."""

    k1: float
    lookahead: float
    cruise: float
    cap: float
    k_v: float
    mass: tuple[float, ...]
    linear: tuple[float, ...]
    quadratic: tuple[float, ...]
    thrust: tuple[float, ...]

    @classmethod
    def of(cls, claim: Any, *pairs: Iterable[Any]) -> Follower:
        """Return the numbers of a claim, with the given pairs of mass, linear and quadratic drag, and thrust limit."""
        mass, linear, quadratic, thrust = (tuple(map(float, pair)) for pair in pairs)
        k1, lookahead, cruise, cap, k_v = (
            float(getattr(claim, name)) for name in ("k1", "lookahead", "cruise", "cap", "k_v")
        )
        return cls(k1, lookahead, cruise, cap, k_v, mass, linear, quadratic, thrust)


def followed(law: Follower, state: Array, psi: Array) -> Array:
    """Return the thrust (n, 2) [N] that a law commands on each axis of the body.

    Args:
        law: the law.
        state: (x_e, y_e, U_x, U_y) (n, 4), with the velocity U in the path frame.
        psi: angle (n,) from the path to the heading.
    """
    x_e, y_e, along, across = state.T
    slant = np.sqrt(1 + (y_e / law.lookahead) ** 2)
    speed = np.minimum(np.maximum(law.cruise - law.k1 * x_e, 0), law.cap / slant)
    desired = speed, -speed * y_e / law.lookahead
    c, s = np.cos(psi), np.sin(psi)
    nu = c * along + s * across, -s * along + c * across
    in_body = c * desired[0] + s * desired[1], -s * desired[0] + c * desired[1]
    thrusts = []
    for i in (0, 1):
        m, a, b, limit = law.mass[i], law.linear[i], law.quadratic[i], law.thrust[i]
        free = a * in_body[i] + b * in_body[i] * np.abs(in_body[i]) + m * law.k_v * (in_body[i] - nu[i])
        thrusts.append(np.clip(free, -limit, limit))
    return np.stack(thrusts, axis=1)
