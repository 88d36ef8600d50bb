"""What a region certificate looks like: its level sets in a plane of states, the flow there, and where V̇ ≤ −aV fails.

The flow is the cruise as the certificate states it, without thrust lag and sampling: place in the path frame, velocity
over ground in it, thrust limited per body axis, drag per body axis. Failure is searched for over corners of the
vehicle's ranges and over headings, so that white is no proof; the certificate is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest

__all__ = ["PLANES", "Plane", "Portrait", "has_levels", "portrait"]

Array = NDArray[np.float64]
Plane = Literal["along", "across", "place"]

PLANES: Mapping[str, tuple[int, int]] = {"along": (0, 2), "across": (1, 3), "place": (0, 1)}
"""Planes of states, all other deviations 0: x_e with its velocity, y_e with its velocity, x_e with y_e."""

_SHARE = 0.85  # of quadratic drag along the path, the mean over the heading: where the cruise settles
_HEADINGS = np.linspace(0, 2 * np.pi, 16, endpoint=False)


@dataclass(frozen=True, eq=False)
class Portrait:
    """A plane of deviations ξ from the steady cruise.

    Attributes:
        plane: one of `PLANES`.
        x, y: (m,), (k,) values of the two deviations [m, m/s].
        flow: (2, k, m) their rates for the nominal vehicle heading along the path.
        level: (k, m) V.
        excess: (k, m) largest V̇/V + a [1/s] that was found over vehicles and headings; above 0 the rate fails there.
        levels: V of the innermost shell, of the others, and 1.
        lagged: the certificate has thrust lag, which the flow here has not.
    """

    plane: str
    x: Array
    y: Array
    flow: Array
    level: Array
    excess: Array
    levels: tuple[float, ...]
    lagged: bool


def has_levels(document: Mapping[str, Any]) -> bool:
    """Whether `portrait` can draw a certificate: regions of the cruise, not of the loop that steers by heading."""
    return document.get("kind") == "region" and document["claim"].get("system") == "cruise"


def portrait(document: Mapping[str, Any], plane: str, *, reach: float = 1.9, points: int = 61) -> Portrait:
    """The portrait of a region certificate.

    Args:
        document: of kind `region`.
        plane: one of `PLANES`.
        reach: half-width of the plane in half-axes of V = 1.
        points: of each axis.

    Raises:
        InputError: another kind of certificate, or an unknown plane.
    """
    if not has_levels(document):
        raise InputError("has no level sets", key="certificate", value=document.get("kind"), remedy="give a region one")
    if plane not in PLANES:
        raise InputError("is not known", key="plane", value=plane, remedy=nearest(plane, PLANES))
    claim, P = document["claim"], _matrix(document["proof"]["P"])
    first, second = PLANES[plane]
    # of the section through 0, not of the projection
    section = np.linalg.inv(P[np.ix_((first, second), (first, second))])
    half = reach * np.sqrt(np.diag(section))
    x, y = (np.linspace(-h, h, points) for h in half)
    xi = np.zeros((points * points, 4))
    xi[:, first], xi[:, second] = (grid.ravel() for grid in np.meshgrid(x, y))
    value = np.einsum("ni,ij,nj->n", xi, P[:4, :4], xi)
    excess = np.full(len(xi), -np.inf)
    for boat in _boats(claim):
        for psi in _HEADINGS:
            rate = _rate(claim, boat, _state(claim, boat, xi), psi)
            growth = 2 * np.einsum("ni,ij,nj->n", xi, P[:4, :4], rate) / np.maximum(value, 1e-12)
            excess = np.maximum(excess, growth + claim["motion"]["rate_per_s"])
    law = claim["law"]
    nominal = (law["mass_kg"], (law["linear_drag"],) * 2, (law["quadratic_drag"],) * 2)
    flow = _rate(claim, nominal, _state(claim, nominal, xi), 0.0)[:, [first, second]]
    shape = (points, points)
    levels = (document["proof"]["floor"], *(shell["level"] for shell in document["proof"]["shells"]))
    return Portrait(
        plane, x, y, flow.T.reshape(2, *shape), value.reshape(shape), excess.reshape(shape), tuple(levels),
        claim["vehicle"]["lag_s"][1] > 0,
    )  # fmt: skip


Boat = tuple[float, tuple[float, ...], tuple[float, ...]]
"""Mass, and linear and quadratic drag of surge and sway."""


def _boats(claim: Mapping[str, Any]) -> list[Boat]:
    """Corners of mass and drag, surge and sway alike and as unlike as the asymmetry lets them be."""
    vehicle = claim["vehicle"]
    ratio = (2 + vehicle["asymmetry"]) / (2 - vehicle["asymmetry"]) if vehicle["asymmetry"] < 2 else np.inf

    def pairs(key: str) -> list[tuple[float, ...]]:
        low, high = vehicle[key]
        return [(low, low), (high, high), (low, min(low * ratio, high)), (max(high / ratio, low), high)]

    return list(product(vehicle["mass_kg"], pairs("linear_drag"), pairs("quadratic_drag")))


def _state(claim: Mapping[str, Any], boat: Boat, xi: Array) -> Array:
    """(x_e, y_e, U_x, U_y) from deviations: the steady cruise lags behind its target by what drag is not known."""
    law, (_, linear, quadratic) = claim["law"], boat
    v, hat, hat2 = law["cruise"], law["linear_drag"], law["quadratic_drag"]
    missing = (np.mean(linear) - hat) * v + _SHARE * (np.mean(quadratic) - hat2) * v * v
    omega = missing / (law["mass_kg"] * law["k_v"] + hat + 2 * _SHARE * hat2 * v)
    state = xi.copy()
    state[:, 0] -= omega / law["k1"]
    state[:, 2] += v
    return state


def _rate(claim: Mapping[str, Any], boat: Boat, state: Array, psi: float) -> Array:
    """d/dt (x_e, y_e, U_x, U_y), (n, 4), at heading ψ against the path."""
    law, limit = claim["law"], claim["vehicle"]["thrust_n"]
    mass, linear, quadratic = boat
    slant = np.hypot(1.0, state[:, 1] / law["lookahead"])
    along = np.minimum(np.maximum(law["cruise"] - law["k1"] * state[:, 0], 0.0), law["cap"] / slant)
    wish = np.stack([along, -along * state[:, 1] / law["lookahead"]])
    speed = state[:, 2:4].T
    push = np.zeros_like(speed)
    for k, axis in enumerate(np.array([[np.cos(psi), np.sin(psi)], [-np.sin(psi), np.cos(psi)]])):
        w, n = axis @ wish, axis @ speed
        free = law["linear_drag"] * w + law["quadratic_drag"] * w * np.abs(w) + law["mass_kg"] * law["k_v"] * (w - n)
        force = np.clip(free, -limit, limit) - linear[k] * n - quadratic[k] * n * np.abs(n)
        push += axis[:, None] * force / mass
    return np.stack([state[:, 2] - law["cruise"], state[:, 3], push[0], push[1]], axis=1)


def _matrix(lower: list[list[float]]) -> Array:
    return np.array([[lower[max(i, j)][min(i, j)] for j in range(len(lower))] for i in range(len(lower))])
