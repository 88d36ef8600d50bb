"""The cruise in plain floating point, written for the tests alone: who else could refute a certificate?"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rate(
    claim: dict[str, Any], boat: dict[str, Array], state: Array, psi: Array, command: Array | None = None
) -> Array:
    """d/dt of (x_e, y_e, U_x, U_y[, F_x, F_y]) (n, k), F in {B} here; `command` holds an earlier thrust in {B}."""
    law = claim["law"]
    c, s = np.cos(psi), np.sin(psi)
    measured = state.copy()
    measured[:, :2] += boat["place"]
    measured[:, 2:4] += boat["speed"]
    wanted = thrust(claim, measured, psi) if command is None else command
    force = state[:, 4:6] if state.shape[1] == 6 else wanted
    flow = state[:, 2:4] - boat["current"]
    past = c * flow[:, 0] + s * flow[:, 1], -s * flow[:, 0] + c * flow[:, 1]
    drag = [x * n + xx * n * np.abs(n) for x, xx, n in zip(boat["linear"].T, boat["quadratic"].T, past, strict=True)]
    a, b = ((force[:, k] - drag[k]) / boat["mass"] for k in (0, 1))
    push = boat["push"] / boat["mass"][:, None]
    out = [state[:, 2] - law["cruise"], state[:, 3], c * a - s * b + push[:, 0], s * a + c * b + push[:, 1]]
    if state.shape[1] == 6:
        out += [(wanted[:, k] - force[:, k]) / boat["lag"] for k in (0, 1)]
    return np.stack(out, axis=1)


def thrust(claim: dict[str, Any], state: Array, psi: Array) -> Array:
    """Commanded thrust in {B} (n, 2) [N]."""
    law, limit = claim["law"], claim["vehicle"]["thrust_n"]
    slant = np.sqrt(1 + (state[:, 1] / law["lookahead"]) ** 2)
    along = np.minimum(np.maximum(law["cruise"] - law["k1"] * state[:, 0], 0), law["cap"] / slant)
    wish = np.stack([along, -along * state[:, 1] / law["lookahead"]], axis=1)
    c, s = np.cos(psi), np.sin(psi)
    out = []
    for row in ((c, s), (-s, c)):
        w = row[0] * wish[:, 0] + row[1] * wish[:, 1]
        n = row[0] * state[:, 2] + row[1] * state[:, 3]
        free = law["linear_drag"] * w + law["quadratic_drag"] * w * np.abs(w) + law["mass_kg"] * law["k_v"] * (w - n)
        out.append(np.clip(free, -limit, limit))
    return np.stack(out, axis=1)


def boats(claim: dict[str, Any], count: int, rng: np.random.Generator) -> dict[str, Array]:
    """Random true vehicles, half of their numbers at an end of the range."""
    vehicle = claim["vehicle"]

    def drawn(key: str) -> Array:
        low, high = vehicle[key]
        share = rng.uniform(size=count)
        return low + (high - low) * np.where(rng.uniform(size=count) < 0.5, np.round(share), share)

    pairs = {}
    for name in ("linear_drag", "quadratic_drag"):
        first = drawn(name)
        ratio = (2 + vehicle["asymmetry"]) / (2 - vehicle["asymmetry"]) if vehicle["asymmetry"] < 2 else np.inf
        other = np.clip(drawn(name), first / ratio, first * ratio)
        pairs[name.removesuffix("_drag")] = np.stack([first, other], axis=1)

    def any_way(key: str) -> Array:
        whence, size = rng.uniform(0, 2 * np.pi, size=count), np.sqrt(rng.uniform(0.5, 1, size=count))
        return np.asarray(vehicle[key] * size[:, None] * np.stack([np.cos(whence), np.sin(whence)], axis=1))

    return {
        "current": any_way("current_m_per_s"),
        "push": any_way("force_n"),
        "place": any_way("place_error_m"),
        "speed": any_way("velocity_error_m_per_s"),
        "mass": drawn("mass_kg"),
        "lag": drawn("lag_s"),
        **pairs,
    }


def omega(claim: dict[str, Any], boat: dict[str, Array]) -> Array:
    """What the command exceeds the cruise by where it settles, along and across (n, 2)."""
    law = claim["law"]
    v, hat, hat2 = law["cruise"], law["linear_drag"], law["quadratic_drag"]
    flow = np.array([v, 0.0]) - boat["current"]
    pull = boat["linear"].mean(axis=1) + 0.85 * boat["quadratic"].mean(axis=1) * np.hypot(*flow.T)
    missing = pull[:, None] * flow - np.array([(hat + 0.85 * hat2 * v) * v, 0.0])
    return missing / (law["mass_kg"] * law["k_v"] + hat + 0.85 * hat2 * v * np.array([2.0, 1.0]))


def rest(claim: dict[str, Any], boat: dict[str, Array]) -> Array:
    """Where it settles: x_e, y_e (n, 2)."""
    law, w = claim["law"], omega(claim, boat)
    return np.stack([-w[:, 0] / law["k1"], -w[:, 1] * law["lookahead"] / (law["cruise"] + w[:, 0])], axis=1)


def matrix(document: dict[str, Any]) -> Array:
    """P."""
    lower = document["proof"]["P"]
    return np.array([[lower[max(i, j)][min(i, j)] for j in range(len(lower))] for i in range(len(lower))])


def worst(document: dict[str, Any], *, low: float, high: float, count: int = 40_000, seed: int = 0) -> float:
    """Largest V̇/V + a [1/s] found for low ≤ V ≤ high, without thrust lag."""
    claim, P, rng = document["claim"], matrix(document), np.random.default_rng(seed)
    boat = boats(claim, count, rng)
    xi = rng.normal(size=(count, len(P))) @ np.linalg.inv(np.linalg.cholesky(P))
    xi *= np.sqrt(rng.uniform(low, high, size=count) / np.einsum("ni,ij,nj->n", xi, P, xi))[:, None]
    psi = rng.uniform(0, 2 * np.pi, size=count)
    state = xi.copy()
    state[:, :2] += rest(claim, boat)
    state[:, 2] += claim["law"]["cruise"]
    grow = 2 * np.einsum("ni,ij,nj->n", xi, P, rate(claim, boat, state, psi))
    value = np.einsum("ni,ij,nj->n", xi, P, xi)
    return float(np.max(grow / value)) + claim["motion"]["rate_per_s"]
