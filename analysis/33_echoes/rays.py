"""Brute force: ranges and a corner ahead against rays, and shares of detections against the sonar equation."""

from __future__ import annotations

import math
import sys
from collections import Counter
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from surctl.marine.sensing import REFLECTORS, Reflector, SonarArray, Surfaces  # noqa: E402
from surctl.marine.sensing.sonar.returns import echo_keys  # noqa: E402
from surctl.marine.world import Box, Disc, Shape, site_walls  # noqa: E402
from tests.conerays import nearest_in_space, shares, weak_probability  # noqa: E402
from tests.oracles.echoes import certain_range, echo_uniform, firing_block, weak_range  # noqa: E402
from tests.raycasting import heard_along, nearest_by_rays  # noqa: E402

LENGTH, WIDTH, DEPTH = 6.0, 4.0, 2.5
KINDS = ("ideal", "webots", "specular", "diffuse", "silent")
PLACE, SHARE = 1e-6, 0.01  # [m] and share of the firings
ARRAY = SonarArray(hull_radius=0.1, pitch=0.0)  # rays and model agree where the beam is level

HULL = SonarArray(pitch=0.0)
COURSES = (15, 25, 35, 45)  # [deg] between the course and the nearer normal; 45: along the bisector
LIMITS = (5.0, 22.5, 70.0)  # [deg] largest incidence at which a face answers: specular, webots, diffuse
CLOSE = 0.002  # [m] allowed difference of rays and closed form


def scene(seed: int) -> tuple[list[tuple[Shape, Reflector]], Surfaces, tuple[float, float, float], float]:
    """Return upright shapes with reflectors, the surfaces, and place and heading of a robot in free water."""
    rng = np.random.default_rng(seed)
    bodies: list[Shape] = []
    while len(bodies) < 4:
        x, y = rng.uniform((0.8, 0.8), (LENGTH - 0.8, WIDTH - 0.8)).tolist()
        new: Shape = Disc((x, y), rng.uniform(0.05, 0.3))
        if len(bodies) < 2:
            new = Box((x, y), rng.uniform(0.1, 0.8, 2).tolist(), rng.uniform(-2, 2))
        if all(math.dist(new.center, old.center) > 1.2 for old in bodies):  # type: ignore[attr-defined]
            bodies.append(new)
    named = [REFLECTORS[kind] for kind in rng.choice(KINDS, 10).tolist()]
    walls = site_walls(WIDTH, LENGTH)
    upright = list(zip([*bodies, *walls], named[:8], strict=True))
    surfaces = Surfaces(tuple(named[:4]), tuple(named[4:8]), named[8], named[9], DEPTH)
    while True:
        x, y = rng.uniform((0.3, 0.3), (LENGTH - 0.3, WIDTH - 0.3)).tolist()
        if min(shape.nearest((x, y))[0] for shape, _ in upright) > 0.25:
            return upright, surfaces, (x, y, rng.uniform(-2.4, -0.1)), rng.uniform(-3, 3)


def both(seed: int, count: int) -> tuple[float, float]:
    """Return the range [m] of the model, and that of rays in the plane and in space."""
    upright, surfaces, place, heading = scene(seed)
    found = certain_range(ARRAY, 0, place=place, heading=heading, shapes=upright, surfaces=surfaces)
    x, y, axis = ARRAY.apex(0, position=place, heading=heading)
    limits = [
        0.0 if isinstance(shape, Disc) and kind.cylinder_range is not None else kind.incidence_limit
        for shape, kind in upright
    ]
    shapes = [shape for shape, _ in upright]
    planes = [(0.0, surfaces.surface.incidence_limit), (-DEPTH, surfaces.floor.incidence_limit)]
    cast = list(zip(shapes, limits, strict=True))
    ahead, apex = (math.cos(axis), math.sin(axis), 0.0), (x, y, place[2])
    space = nearest_in_space(apex, ahead, ARRAY.half_angle, cast, planes, count=count, seed=seed)
    return found, min(space, nearest_by_rays(shapes, (x, y), axis, ARRAY.half_angle, limit=limits))


def detections(seed: int, firings: int) -> tuple[float, int]:
    """Return the largest difference of a share of firings from the sonar equation, and the number of ranges."""
    rng, smooth = np.random.default_rng(seed), REFLECTORS["specular-edges"]
    array = SonarArray(hull_radius=0.0, pitch=0.0)
    half, bodies, parts = array.half_angle, [], []
    for k, away in enumerate((0.5, 1.1, 1.9)):  # behind one another, but aside
        bearing, radius = (-0.45, 0.05, 0.5)[k] + rng.uniform(-0.05, 0.05), rng.uniform(0.03, 0.06)
        centre = (away * math.cos(bearing), away * math.sin(bearing))
        if k:
            bodies.append((4 * k, Disc(centre, radius), smooth))
            chance = weak_probability(away - radius, bearing, half=half, reach=3.2, radius=radius)
            parts.append((away - radius, chance))
            continue
        box = Box(centre, (0.1, 0.1))
        bodies.append((k, box, smooth))
        for sx, sy in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            corner = (centre[0] + 0.05 * sx, centre[1] + 0.05 * sy)
            if sx < 0 or (sy > 0 and centre[1] < -0.05):  # the faces that look at the sonar
                angle = abs(math.atan2(corner[1], corner[0]))
                seen = weak_probability(math.hypot(*corner), angle, half=half, reach=0.6)
                parts.append((math.hypot(*corner), seen if angle < half else 0.0))
    key, counted = echo_keys([seed])[0], Counter[float]()
    for instant in range(firings):
        block = firing_block(key, instant, 0)
        found = weak_range(
            array, 0, position=(0.0, 0.0), heading=0.0, bodies=bodies, corners=[],
            uniform=lambda echo, block=block: echo_uniform(key, block, echo),  # type: ignore[misc]
        )  # fmt: skip
        counted[round(found, 9)] += 1
    wanted = {round(distance, 9): share for distance, share in shares(parts).items()}
    worst = max(abs(counted[distance] / firings - wanted.get(distance, 0.0)) for distance in {*wanted, *counted})
    return worst, len(wanted)


def agreement(*, quick: bool) -> tuple[list[str], dict[str, bool]]:
    """Return lines and limits of both comparisons."""
    scenes, count = (4, 5_000) if quick else (100, 100_000)
    pairs = np.array([both(seed, count) for seed in range(scenes)])
    silent = np.isinf(pairs).all(axis=1)
    with np.errstate(invalid="ignore"):
        apart = np.where(silent, 0.0, np.abs(pairs[:, 0] - pairs[:, 1]))
    firings = 3_000 if quick else 100_000
    worst, ranges = zip(*(detections(seed, firings) for seed in range(1 if quick else 3)), strict=True)
    lines = [
        f"{scenes} drawn scenes, each with {count} rays in a cone of 75° and finer ones about the nearest hits: "
        f"{int(silent.sum())} are silent for both; the range differs by at most {apart.max():.1e} m.",
        "",
        f"{firings} firings at {ranges[0]} and more weak echoes: the share of firings that measure each range differs "
        f"from the sonar equation by at most {max(worst):.2%}.",
    ]
    return lines, {
        f"range within {PLACE:g} m of the rays": bool(apart.max() <= PLACE),
        f"shares of detections within {3 * SHARE if quick else SHARE:.0%}": max(worst) <= (3 if quick else 1) * SHARE,
    }


def heard_from(course: float, limit: float, *, turns: int, rays: int) -> float:
    """Return the distance [m] from the hull at which the corner ahead is first heard at the best heading, 0 if never.

    The corner lies at the origin, between faces with the normals -x and -y, and the hull comes straight to it.

    Args:
        course: angle between the course and the normal of a face [rad].
        limit: largest incidence at which a face answers [rad].
        turns: number of headings in a quarter turn.
        rays: number of rays in a beam.
    """
    box, fan = Box((2.0, 2.0), (4.0, 4.0)), np.linspace(-HULL.half_angle, HULL.half_angle, rays)

    def heard(away: float) -> bool:
        distance = HULL.hull_radius + away
        place = (-distance * math.cos(course), -distance * math.sin(course))
        for heading in np.linspace(0.0, math.pi / 2, turns, endpoint=False):
            for sensor in range(HULL.size):
                x, y, axis = HULL.apex(sensor, position=place, heading=heading)
                ranges = heard_along([box], (x, y), axis + fan, limit=limit)
                if (ranges < HULL.maximum).any():
                    return True
        return False

    near, far = 0.0, HULL.maximum
    if not heard(near):
        return 0.0
    if heard(far - HULL.hull_radius):
        return far
    while far - near > 0.2 * CLOSE:
        middle = 0.5 * (near + far)
        near, far = (middle, far) if heard(middle) else (near, middle)
    return near


def corner_table(*, quick: bool) -> tuple[list[str], dict[str, bool]]:
    """Return the lines of a table, and whether rays and closed form agree along the bisector."""
    limits, courses = (LIMITS[1:2], COURSES[-1:]) if quick else (LIMITS, COURSES)
    turns, rays = (90, 101) if quick else (360, 601)
    found = {
        (limit, course): heard_from(math.radians(course), math.radians(limit), turns=turns, rays=rays)
        for limit in limits
        for course in courses
    }
    lines = [
        "| faces answer within | "
        + " | ".join(f"{course}° off a normal" for course in courses)
        + " | closed form, 45° |",
        "|---|" + "---|" * (len(courses) + 1),
    ]
    worst = 0.0
    for limit in limits:
        formula = HULL.corner_range(math.radians(limit))
        cells = [f"{found[limit, course]:.3f}" for course in courses]
        lines.append(f"| {limit:g}° | {' | '.join(cells)} | {formula:.3f} |")
        worst = max(worst, abs(found[limit, 45] - formula))
    close = 5 * CLOSE if quick else CLOSE
    return lines, {f"distance at which a corner is heard within {1000 * close:g} mm of the closed form": worst <= close}
