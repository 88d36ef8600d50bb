"""Shape a function of a template for a large region V < γ, by an evolution strategy with covariance adaptation."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from surctl.lyapunov.rays import Grid

__all__ = ["enlarge"]

Array = NDArray[np.float64]

_FLOOR = 1e-5  # least eigenvalue of the correlation of the features that is scaled up
_STALL = 1e-4  # relative growth of the volume in `patience` generations below which the search stops


def enlarge(
    grid: Grid, start: Array, *, seconds: float, rate: float = 0.0, seed: int = 0, step: float = 0.02
) -> tuple[Array, float]:
    """Return coefficients (K,) whose region V < γ is large, and its relative volume; γ is 1.

    The strategy is the covariance matrix adaptation of Hansen (2016) on the logarithm of the volume.

    Args:
        grid: features of the template on rays.
        start: coefficients (K,) of a function with a region that is not empty.
        seconds: limit of the processor time [s].
        rate: decay rate that V must have in the region.
        seed: seed of the random numbers.
        step: first standard deviation, relative to the coefficients that keep V within 1 on the region.
    """
    until = time.process_time() + seconds
    random = np.random.default_rng(seed)
    first = grid.sizes(start[None], rate)
    if not first.level[0] > 0:
        return start, 0.0
    mean0 = start / first.level[0]
    # coordinates in which the features are nearly uncorrelated, with about unit variance
    gram = grid.values @ grid.values.T / grid.values.shape[1]
    size = np.sqrt(np.diag(gram))
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    spread = (vectors / np.sqrt(np.maximum(values, _FLOOR * values.max()))).T / size  # rows are directions
    n = len(start)
    batch = 4 + int(3 * np.log(n)) * 2
    half = batch // 2
    weights = np.log(half + 0.5) - np.log(np.arange(1, half + 1))
    weights /= weights.sum()
    mass = 1 / (weights**2).sum()
    c_sigma, c_c = (mass + 2) / (n + mass + 5), (4 + mass / n) / (n + 4 + 2 * mass / n)
    c_1 = 2 / ((n + 1.3) ** 2 + mass)
    c_mu = min(1 - c_1, 2 * (mass - 2 + 1 / mass) / ((n + 2) ** 2 + mass))
    damping = 1 + 2 * max(0.0, np.sqrt((mass - 1) / (n + 1)) - 1) + c_sigma
    chi = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))
    mean, sigma = np.zeros(n), step
    covariance, path_sigma, path_c = np.eye(n), np.zeros(n), np.zeros(n)
    root, inverse = np.eye(n), np.eye(n)
    best, best_volume = mean0, float(first.volume[0])
    history = [best_volume]
    patience = 30 + 3 * n
    generation = 0
    while time.process_time() < until:
        generation += 1
        z = random.standard_normal((batch, n)) @ root
        trial = mean + sigma * z
        coefficients = mean0 + trial @ spread
        sizes = grid.sizes(coefficients, rate)
        possible = sizes.volume > 0
        if possible.sum() < half:
            sigma /= 2
            if sigma < 1e-9:
                break
            continue
        order = np.argsort(-sizes.volume, kind="stable")
        top = order[0]
        if sizes.volume[top] > best_volume:
            best, best_volume = coefficients[top] / sizes.level[top], float(sizes.volume[top])
        picked = z[order[:half]]
        move = weights @ picked
        mean = mean + sigma * move
        path_sigma = (1 - c_sigma) * path_sigma + np.sqrt(c_sigma * (2 - c_sigma) * mass) * (move @ inverse)
        length = np.linalg.norm(path_sigma)
        calm = length / np.sqrt(1 - (1 - c_sigma) ** (2 * generation)) < (1.4 + 2 / (n + 1)) * chi
        path_c = (1 - c_c) * path_c + calm * np.sqrt(c_c * (2 - c_c) * mass) * move
        covariance = (
            (1 - c_1 - c_mu) * covariance + c_1 * np.outer(path_c, path_c) + c_mu * (picked.T * weights) @ picked
        )
        sigma *= np.exp(min(1.0, c_sigma / damping * (length / chi - 1)))
        if generation % max(1, n // 10) == 0:
            eigen, basis = np.linalg.eigh((covariance + covariance.T) / 2)
            scale = np.sqrt(np.maximum(eigen, 1e-14))
            root, inverse = (basis * scale) @ basis.T, (basis / scale) @ basis.T
        history.append(best_volume)
        if len(history) > patience and history[-1] <= history[-patience] * (1 + _STALL):
            break
    return best, best_volume
