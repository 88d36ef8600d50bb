"""A second implementation of the heading loop of a craft without sway force, to compare with the proof's inclusion.

The comparison does not replace the derivation of the inclusion, but it reveals a wrong sign, frame or factor.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.steering_claim import SteeringClaim

__all__ = ["available", "check_samples", "commanded_moments", "draw_crafts", "true_rate"]

Array = NDArray[np.float64]

_SAMPLES = 4_000


def draw_crafts(claim: SteeringClaim, count: int, rng: np.random.Generator) -> Mapping[str, Array]:
    """Return factors of `mass` (count, 4): m11, m22, m44, m24, of `drag` (count, 8), and the speeds `u` (count,)."""

    def ends(low: float, high: float, shape: tuple[int, ...]) -> Array:
        inside = rng.uniform(low, high, size=shape)
        return np.where(rng.uniform(size=shape) < 0.7, rng.choice([low, high], size=shape), inside)

    bounds = [(float(low), float(high)) for low, high in (claim.mass_factor, claim.drag_factor, claim.speed)]
    return {
        "mass": ends(*bounds[0], (count, 4)), "drag": ends(*bounds[1], (count, 8)), "u": ends(*bounds[2], (count,))
    }  # fmt: skip


def commanded_moments(
    claim: SteeringClaim, y: Array, psi: Array, r: Array, u: Array, crab: Array, s: Array
) -> tuple[Array, Array]:
    """Return the yaw moments (n,) [N m] that the law commands, with its limits, for the least and the whole `share`.

    `share` is the share of the modelled sway speed that the speed cap leaves. The arguments (n,) are cross-track error,
    heading to the path, yaw rate, surge speed, crab angle and modelled sway speed.
    """
    nr, nrr = float(claim.linear[1]), float(claim.quadratic[1])
    cruise, m44 = float(claim.cruise), float(claim.mass[2])
    ahead = max(float(claim.lookahead), cruise / float(_planned(claim, np.array([cruise]))[0]))
    desired = -np.arctan2(y, ahead) - crab
    error = np.arctan2(np.sin(desired - psi), np.cos(desired - psi))
    swing = np.sqrt(available(claim, u) / m44 * np.abs(error))
    largest = np.minimum(_planned(claim, np.maximum(u, cruise / 4)), swing)
    turn = np.clip(float(claim.k_psi) * error, -largest, largest)
    free = nr * turn + nrr * turn * np.abs(turn) + m44 * float(claim.k_r) * (turn - r)
    most, left = available(claim, u), float(claim.cap) / np.hypot(float(claim.cap), s)
    least, whole = (np.clip(free + float(claim.munk) * u * share * s, -most, most) for share in (left, 1.0))
    return least, whole


def available(claim: SteeringClaim, speed: Array) -> Array:
    """Return the largest yaw moment (n,) [N m] at surge speeds (n,): that of fins grows with their square."""
    most, cruise = float(claim.moment), float(claim.cruise)
    return most * np.minimum(speed / cruise, 1) ** 2 if claim.finned else np.full_like(speed, most)


def _planned(claim: SteeringClaim, speed: Array) -> Array:
    (yv, nr), (yvv, nrr) = ([float(n) for n in pair] for pair in (claim.linear, claim.quadratic))
    most = available(claim, speed)
    limit = 1.7 * most / (nr + np.sqrt(nr * nr + 3.4 * nrr * most))
    drift = np.minimum(float(claim.sideslip) * speed, 0.5 * most / max(abs(float(claim.munk)), 1e-9) / speed)
    return np.asarray(np.minimum((yv * drift + yvv * drift**2) / (float(claim.centripetal) * speed), limit))


def true_rate(claim: SteeringClaim, craft: Mapping[str, Array], state: Array) -> Array:
    """Return d/dt of the states (n, 6) by the law and the vehicle, with all limits of the law.

    Args:
        claim: the claim.
        craft: factors and surge speeds, see `draw_crafts`.
        state: y_e, ψ, v, r, crab and modelled sway (n, 6).
    """
    y, psi, v, r, crab, s = state.T
    u = craft["u"]
    m11, m22, m44 = (float(m) for m in claim.mass)
    yv, (yvv, nrr) = float(claim.linear[0]), map(float, claim.quadratic)
    cruise = float(claim.cruise)
    moment, _ = commanded_moments(claim, y, psi, r, u, crab, s)
    f, d = craft["mass"].T, craft["drag"].T
    t1, t2, t4 = m11 * f[0], m22 * f[1], m44 * f[2]
    t24 = float(claim.terms.get("m24", 0)) * f[3]
    own = [float(n) for n in claim.vehicle_linear]
    sway = d[0] * (own[0] * v + yvv * np.abs(v) * v)
    yaw = d[1] * (own[1] * r + nrr * np.abs(r) * r)
    for k, (name, value) in enumerate(sorted(claim.terms.items())):
        if name[0] in "YN" and set(name[1:]) <= set("uvr"):
            speeds = [{"u": u, "v": v, "r": r}[letter] for letter in name[1:]]
            force = d[2 + k % 6] * float(value) * (speeds[0] if len(speeds) == 1 else np.abs(speeds[0]) * speeds[1])
            sway, yaw = (sway + force, yaw) if name[0] == "Y" else (sway, yaw + force)
    momentum = t1 * u, t2 * v + t24 * r
    loads = float(claim.side) * moment - r * momentum[0] - sway, moment - (u * momentum[1] - v * momentum[0]) - yaw
    size = t2 * t4 - t24 * t24
    rates = (t4 * loads[0] - t24 * loads[1]) / size, (t2 * loads[1] - t24 * loads[0]) / size
    slip = np.arctan2(v, np.maximum(u, cruise / 4))
    filters = (
        (slip - crab) / float(claim.crab_time),
        -float(claim.centripetal) / m22 * u * r - (yv + yvv * np.abs(s)) * s / m22,
    )
    return np.stack([u * np.sin(psi) + v * np.cos(psi), r, *rates, *filters], axis=1)


def check_samples(claim: SteeringClaim, p: Array) -> None:
    """Compare the true loop with the claimed decay at random points of V ≤ 1.

    Raises:
        Rejected: V decays more slowly than claimed at a point.
    """
    rng = np.random.default_rng(5)
    craft = draw_crafts(claim, _SAMPLES, rng)
    xi = rng.normal(size=(_SAMPLES, 6)) @ np.linalg.inv(np.linalg.cholesky(p))
    level = np.where(rng.uniform(size=_SAMPLES) < 0.5, 1.0, rng.uniform(0, 1, size=_SAMPLES))
    xi *= np.sqrt(level / np.einsum("ni,ij,nj->n", xi, p, xi))[:, None]
    change = 2 * np.einsum("ni,ij,nj->n", xi, p, true_rate(claim, craft, xi))
    if not np.all(change <= -float(claim.rate) * level * (1 - 1e-9) + 1e-12):
        raise Rejected("V decays more slowly than claimed at a sampled point of the true loop")
