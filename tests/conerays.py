"""Echoes in space by brute force: rays in a circular cone that meet upright shapes, the water surface and the floor."""

from __future__ import annotations

import math

import numpy as np

from tests.raycasting import CAST


def cone(axis, half, count, rng):
    """Unit vectors (n, 3), at random and evenly in a cone about `axis` (3,), a tenth of them on its rim."""
    along = np.cos(half) + (1 - np.cos(half)) * rng.random(count)
    along[: count // 10], turn = np.cos(half), 2 * np.pi * rng.random(count)
    side = np.cross(axis, (0.0, 0.0, 1.0) if abs(axis[2]) < 0.9 else (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    up, across = np.cross(side, axis), np.sqrt(1 - along**2)
    return along[:, None] * axis + across[:, None] * (np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * up)


def heard(directions, apex, upright, levels):
    """Range that each ray hears (n,): of its first hit, inf where that is silent.

    `upright` are (shape, largest incidence), `levels` (z, largest incidence) of horizontal planes; an incidence of None
    is any, and of 0 none.
    """
    flat = np.hypot(directions[:, 0], directions[:, 1])
    rays = directions[:, :2] / flat[:, None]
    best, margin = np.full(len(directions), np.inf), np.full(len(directions), -1.0)
    for shape, limit in upright:
        t, cosine = CAST[type(shape)](shape, np.array(apex[:2]), rays)
        t, cosine = t / flat, cosine * flat
        margin = np.where(t < best, cosine - least(limit), margin)
        best = np.minimum(best, t)
    for z, limit in levels:
        rise = z - apex[2]
        with np.errstate(divide="ignore"):
            t = np.where(directions[:, 2] * rise > 0, rise / directions[:, 2], np.inf)
        margin = np.where(t < best, np.abs(directions[:, 2]) - least(limit), margin)
        best = np.minimum(best, t)
    return np.where(margin >= 0, best, np.inf)


def least(limit):
    """Least cosine of incidence that answers."""
    return -1.0 if limit is None else 2.0 if limit == 0 else math.cos(limit)


def nearest_in_space(apex, axis, half, upright, levels, *, count, seed):
    """Least range in the cone [m]: `count` rays, then rounds of rays about the best ones in ever narrower cones."""
    rng, axis = np.random.default_rng(seed), np.array(axis)
    rays = cone(axis, half, count, rng)
    ranges = heard(rays, apex, upright, levels)
    centres = rays[np.argsort(ranges)[:12]][np.sort(ranges)[:12] < np.inf]
    nearest, narrow = ranges.min(), 4 * half / math.sqrt(count)
    while narrow > 1e-8 and len(centres):
        rays = np.vstack([cone(centre, narrow, 300, rng) for centre in centres])
        inside = rays @ axis
        # a ray past the rim is turned back onto it
        beyond = inside < math.cos(half)
        aside = rays - inside[:, None] * axis
        aside /= np.maximum(np.linalg.norm(aside, axis=1), 1e-300)[:, None]
        rays[beyond] = math.cos(half) * axis + math.sin(half) * aside[beyond]
        ranges = heard(rays, apex, upright, levels)
        order = np.argsort(ranges)[:8]
        nearest, centres, narrow = min(nearest, ranges[order[0]]), rays[order], narrow / 3
    return float(nearest)


def weak_probability(distance, angle, *, half, reach, radius=None):
    """Probability of a weak echo from the sonar equation in dB: the logistic function of the level above the threshold.

    The amplitude falls as the distance to the power of 1.5, grows with the root of a cylinder's radius, and falls with
    the angle to one half at the edge of the beam; the logistic function has the slope of the amplitude's 4th power.
    """
    spread = 20 / (4 * math.log(10))
    level = -30 * math.log10(distance / reach) - 20 * math.log10(1 + (math.tan(angle) / math.tan(half)) ** 2)
    level += 0 if radius is None else 10 * math.log10(radius / 0.1)
    return 1 / (1 + math.exp(-level / spread))


def shares(parts):
    """Share of firings that measure each of the ranges, from (range, probability): the first detected one counts."""
    missed, found = 1.0, {}
    for distance, chance in sorted(parts):
        found[distance] = missed * chance
        missed *= 1 - chance
    return found | {math.inf: missed}
