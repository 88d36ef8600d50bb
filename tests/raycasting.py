"""Echoes by brute force: many rays, each cut with every outline, independently of the shapes' own formulas."""

from __future__ import annotations

import math

import numpy as np

from surctl.marine.world import Box, Disc, Wall

RAYS = 20_001


def cast_disc(disc, apex, rays):
    """First hits of unit rays (n, 2) and their cosines: the smaller root of |apex + t·ray − center|² = r²."""
    to = apex - np.array(disc.center)
    b, c = rays @ to, to @ to - disc.radius**2
    root = b * b - c
    t = -b - np.sqrt(np.where(root >= 0, root, np.nan))
    t = np.where(np.isnan(t) | (t < 0), np.inf, t)
    normals = (to + np.where(np.isinf(t), 0.0, t)[:, None] * rays) / disc.radius
    return t, -np.sum(normals * rays, axis=1)


def corners(box):
    """The corners (4, 2), counter-clockwise."""
    c, s = math.cos(box.angle), math.sin(box.angle)
    half = np.array(box.size) / 2
    local = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
    return np.array(box.center) + local @ np.array([[c, s], [-s, c]])


def cast_box(box, apex, rays):
    """First hits on the four edges, each solved as apex + t·ray = a + q·(b − a) by Cramer's rule, and their cosines."""
    best, cosines = np.full(len(rays), np.inf), np.zeros(len(rays))
    points = corners(box)
    for a, b in zip(points, np.roll(points, -1, axis=0), strict=True):
        edge, to = b - a, a - apex
        outward = np.array((edge[1], -edge[0])) / np.hypot(*edge)
        det = rays[:, 1] * edge[0] - rays[:, 0] * edge[1]
        det = np.where(np.abs(det) < 1e-14, np.nan, det)
        t = (to[1] * edge[0] - to[0] * edge[1]) / det
        q = (to[1] * rays[:, 0] - to[0] * rays[:, 1]) / det
        t = np.where((t >= 0) & (q >= 0) & (q <= 1), t, np.inf)
        cosines = np.where(t < best, -rays @ outward, cosines)
        best = np.minimum(best, t)
    return best, cosines


def cast_wall(wall, apex, rays):
    """First hits on the line, and their cosines."""
    gap = (apex - np.array(wall.point)) @ np.array(wall.normal)
    closing = -(rays @ np.array(wall.normal))
    return np.where(closing > 1e-14, gap / np.where(closing > 1e-14, closing, 1.0), np.inf), closing


CAST = {Disc: cast_disc, Box: cast_box, Wall: cast_wall}


def inside(shape, point):
    """Whether a point lies in a shape."""
    if isinstance(shape, Disc):
        return math.dist(point, shape.center) <= shape.radius
    if isinstance(shape, Wall):
        return float((np.array(point) - shape.point) @ np.array(shape.normal)) <= 0
    points = corners(shape)
    edges = np.roll(points, -1, axis=0) - points
    to = np.array(point) - points
    return bool(np.all(edges[:, 0] * to[:, 1] - edges[:, 1] * to[:, 0] >= 0))


def heard_along(shapes, apex, bearings, *, limit=None, hull=None):
    """Range that each ray hears (n,): of its first hit, where that reflects; inf behind the own hull (a disc).

    `limit` is the largest incidence [rad], None without one, or one limit for each shape, 0 for a silent one.
    """
    apex = np.asarray(apex, dtype=float)
    rays = np.column_stack((np.cos(bearings), np.sin(bearings)))
    best, cosines = np.full(len(rays), np.inf), np.zeros(len(rays))
    limits = limit if isinstance(limit, list) else [limit] * len(shapes)
    for shape, most in zip(shapes, limits, strict=True):
        t, cosine = CAST[type(shape)](shape, apex, rays)
        facing = cosine - (-1.0 if most is None else 2.0 if most == 0 else math.cos(most))
        cosines = np.where(t < best, facing, cosines)
        best = np.minimum(best, t)
    if limit is not None:
        best = np.where(cosines >= 0, best, np.inf)
    if hull is not None:  # an apex on the hull must not depend on how a range of 0 is rounded
        to = np.array(hull.center) - apex
        across = np.abs(rays[:, 0] * to[1] - rays[:, 1] * to[0])
        best = np.where((rays @ to > 0) & (across < hull.radius), np.inf, best)
    return best


def nearest_by_rays(shapes, apex, axis, half, *, limit=None, hull=None):
    """Least range in a cone [m] from `RAYS` rays, then from finer ones about each that is the least of its neighbours.

    Two rounds of 2,001 rays across four gaps of the round before leave 4e-10 rad between rays for a beam of 120°: a
    range that changes by less than 2e3 m a radian is then known to 1e-6 m. A sliver narrower than the first gap,
    1e-4 rad, may go unseen.
    """
    if any(inside(shape, apex) for shape in shapes):
        return 0.0

    def search(low, high, count, rounds):
        looks = np.linspace(low, high, count)
        gap = looks[1] - looks[0]
        ranges = heard_along(shapes, apex, looks, limit=limit, hull=hull)
        padded = np.concatenate(([np.inf], ranges, [np.inf]))
        least = np.flatnonzero(np.isfinite(ranges) & (ranges <= padded[:-2]) & (ranges <= padded[2:]))
        if not rounds or not len(least):
            return ranges.min()
        # what lies further above the best than a steep range changes in a gap cannot come below it
        close = least[ranges[least] <= ranges.min() + 100.0 * gap]
        close = close[np.argsort(ranges[close])][:8]
        found = [search(max(low, looks[k] - 2 * gap), min(high, looks[k] + 2 * gap), 2001, rounds - 1) for k in close]
        return min(found)

    return float(search(axis - half, axis + half, RAYS, 2))
