"""Random vehicles and states of a turning cruise, where a proof is compared with the true loop."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.turning_cells import Trim
from surctl.certcheck.turning_claim import TurningClaim, axis_pairs, drag_factors
from tests.certcheck.turning_truth import commanded, true_rate

Array = NDArray[np.float64]

_SAMPLES = 4_000
_STEP = 1e-6  # [s] of the difference quotient of the commands


def draw_vehicles(claim: TurningClaim, count: int, rng: np.random.Generator) -> Mapping[str, Array]:
    """Return the factors (count, 2) of `mass`, `linear` and `quadratic` of random vehicles within the claim.

    `term_mass` and `term` hold the factors (count,) of the terms beside equation (3): of inertia, and of all others.
    """
    values = []
    for corners in (axis_pairs(claim.mass_factor, claim.mass_asymmetry), drag_factors(claim)):
        vertices = np.array([[float(n) for n in one] for one in corners])
        weights = rng.dirichlet(np.ones(len(vertices)), size=count)
        weights = np.where(rng.uniform(size=(count, 1)) < 0.6, np.eye(len(vertices))[weights.argmax(axis=1)], weights)
        values.append(weights @ vertices)
    shared = {
        key: rng.choice([float(low), float(top), 1.0], size=count)
        for key, (low, top) in (("term_mass", claim.mass_factor), ("term", claim.drag_factor))
    }
    return {"mass": values[0], "linear": values[1][:, :2], "quadratic": values[1][:, 2:], **shared}


def draw_motions(claim: TurningClaim, count: int, rng: np.random.Generator) -> Array:
    """Return heave velocity and acceleration, yaw acceleration and turn rate of the path (count, 4) at their bounds."""
    most = claim.heave, claim.heave_rate, claim.turn_rate, claim.curvature * claim.cruise
    return np.asarray(rng.choice([-1.0, 1.0], size=(count, 4)) * np.array([float(bound) for bound in most]))


def check_samples(claim: TurningClaim, trim: Trim, p: Array, floor: float) -> None:
    """Compare the true loop with the claimed decay at random points of floor ≤ V ≤ 1."""
    rng = np.random.default_rng(5)
    boat = draw_vehicles(claim, _SAMPLES, rng)
    shares = (boat[name].mean(axis=1) - 1 for name in ("linear", "quadratic"))
    omega = sum(float(slope) * share for slope, share in zip(trim.slopes, shares, strict=True))
    z = rng.normal(size=(_SAMPLES, len(p))) @ np.linalg.inv(np.linalg.cholesky(p))
    level = np.where(rng.uniform(size=_SAMPLES) < 0.5, rng.choice([floor, 1.0], size=_SAMPLES),
                     rng.uniform(floor, 1, size=_SAMPLES))  # fmt: skip
    z *= np.sqrt(level / np.einsum("ni,ij,nj->n", z, p, z))[:, None]
    xi, own = z[:, :4], 6 if claim.lag[1] else 4
    r = float(claim.yaw_rate) * rng.choice([-1.0, 1.0], size=_SAMPLES)
    psi = rng.uniform(0, 2 * np.pi, size=_SAMPLES)
    motions, angle = draw_motions(claim, _SAMPLES, rng), rng.uniform(0, 2 * np.pi, size=_SAMPLES)
    flow = float(claim.current) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    means = np.stack([np.ones(_SAMPLES), *(boat[name].mean(axis=1) - 1 for name in ("linear", "quadratic"))], 1)
    shift = -(means @ np.array([[float(g) for g in row] for row in trim.flow])) * flow  # of the steady command
    omega, cruise = omega + shift[:, 0], np.full(_SAMPLES, float(claim.cruise))
    aside = -float(claim.lookahead) * shift[:, 1] / (cruise + omega)
    rest = np.stack([-omega / float(claim.k1), aside, cruise, np.zeros(_SAMPLES)], 1)
    state, masses = xi + rest, np.array([float(m) for m in claim.mass])
    command, trim_force = commanded(claim, state, psi), commanded(claim, rest, psi)
    sigma = rng.uniform(0.01, 0.99, size=(_SAMPLES, 1))
    changed = z[:, own:] * np.sqrt(sigma / (1 - sigma)) if claim.period else np.zeros((_SAMPLES, 2))  # D = σ ε
    axes = np.stack([np.stack([np.cos(psi), np.sin(psi)], 1), np.stack([-np.sin(psi), np.cos(psi)], 1)], 1)
    away = rng.normal(size=(3, _SAMPLES, 2))
    away = away / np.linalg.norm(away, axis=2, keepdims=True)
    push = np.hstack([float(claim.place_error) * away[0], float(claim.velocity_error) * away[1]])
    error = changed * masses + commanded(claim, state + push, psi) - command + float(claim.force) * away[2]
    if claim.lag[1]:
        force = np.einsum("nij,nj->ni", axes, z[:, 4:6])
        error = trim_force + force * masses - command
    rate = true_rate(claim, boat, state, psi, r, motions, flow=flow, error=error)
    rates = [rate]
    if claim.lag[1]:
        turned = (commanded(claim, rest, psi + _STEP * r) - trim_force) / _STEP / masses
        lagging = (command / masses + changed - trim_force / masses - force) / float(claim.lag[1]) - turned
        rates.append(np.einsum("nij,ni->nj", axes, lagging) + r[:, None] * np.stack([-z[:, 5], z[:, 4]], 1))
    change = 2 * np.einsum("ni,ij,nj->n", z[:, :own], p[:own, :own], np.hstack(rates))
    if claim.period:
        moving = (commanded(claim, state + _STEP * rate, psi + _STEP * r) - command) / _STEP / masses
        late = changed / sigma
        change -= p[-1, -1] * (late * (late / float(claim.period) + 2 * (1 - sigma) * moving)).sum(axis=1)
    assert np.all(change <= -float(claim.rate) * level * (1 - 1e-4 * claim.behind - 1e-9) + 1e-12)
