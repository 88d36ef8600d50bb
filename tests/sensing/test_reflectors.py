"""Reflectors against brute-force rays, their compiled form, and the random numbers of weak echoes."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.sensing import REFLECTORS, Reflector, SonarArray, Surfaces
from surctl.marine.sensing.sonar.echo import beam_of
from surctl.marine.sensing.sonar.returns import (
    certain_range_symbols,
    echo_keys,
    firing_block_symbols,
    uniform_symbols,
    weak_range_symbols,
)
from surctl.marine.sensing.sonar.solids import SolidBox, SolidDisc, SolidWalls
from surctl.marine.world import Box, Disc, site_walls
from tests.conerays import nearest_in_space, shares, weak_probability
from tests.oracles.echoes import certain_range, corner_points, echo_uniform, firing_block, nearest_facing, weak_range
from tests.raycasting import nearest_by_rays

LENGTH, WIDTH, DEPTH = 6.0, 4.0, 3.0
WALLS = site_walls(WIDTH, LENGTH)
BODIES = (Box((2.0, 1.2), (0.6, 0.9)), Box((4.2, 3.0), (0.5, 0.5)), Disc((3.2, 1.6), 0.2), Disc((1.2, 3.0), 0.1))
NAMES = ("specular-edges", "diffuse", "specular", "ideal")
MIXED = Surfaces(
    tuple(REFLECTORS[name] for name in NAMES),
    tuple(REFLECTORS[name] for name in ("specular", "webots", "specular", "silent")),
    REFLECTORS["diffuse"],
    REFLECTORS["specular"],
    DEPTH,
)
POSES = tuple(
    (x, y, z, heading)
    for (x, y), z, heading in zip(
        ((0.6, 0.6), (3.2, 2.6), (5.2, 2.0), (1.2, 2.2), (4.6, 0.7), (2.6, 3.4), (5.4, 0.5), (0.5, 1.8)),
        (-1.3, -0.5, -1.6, -1.1, -0.3, -1.5, -1.4, -2.6),
        (0.3, -1.9, 3.0, 1.2, 2.2, -0.8, -0.7, 0.0),
        strict=True,
    )
)


def limits():
    """Largest incidence of each body and wall: 0 for what is silent or answers with a probability."""
    bodies = [
        0.0 if isinstance(shape, Disc) and r.cylinder_range is not None else r.incidence_limit
        for shape, r in zip(BODIES, MIXED.obstacles, strict=True)
    ]
    return [*bodies, *(r.incidence_limit for r in MIXED.walls)]


def upright():
    return list(zip([*BODIES, *WALLS], [*MIXED.obstacles, *MIXED.walls], strict=True))


def test_shapes_with_limits_of_their_own_against_ray_casting() -> None:
    shapes, each = [*BODIES, *WALLS], limits()
    faced = [2.0 if limit == 0 else -1.0 if limit is None else math.cos(limit) for limit in each]
    for x, y, _, heading in POSES[:2]:
        found = nearest_facing(shapes, faced, (x, y), heading, half_angle=0.6)
        wanted = nearest_by_rays(shapes, (x, y), heading, 0.6, limit=each)
        assert found == wanted or found == pytest.approx(wanted, abs=1e-6)


def test_faces_surface_and_floor_against_rays_in_space() -> None:
    array, levels, kinds = SonarArray(hull_radius=0.1, pitch=0.0), 0, set()
    rough = replace(MIXED, floor=REFLECTORS["diffuse"])
    cast = list(zip([*BODIES, *WALLS], limits(), strict=True))
    planes = [(0.0, rough.surface.incidence_limit), (-DEPTH, rough.floor.incidence_limit)]
    for x, y, z, heading in POSES:
        found = certain_range(array, 0, place=(x, y, z), heading=heading, shapes=upright(), surfaces=rough)
        apex = (x + 0.1 * math.cos(heading), y + 0.1 * math.sin(heading), z)
        axis = (math.cos(heading), math.sin(heading), 0.0)
        wanted = nearest_in_space(apex, axis, array.half_angle, cast, planes, count=8_000, seed=1)
        assert found == pytest.approx(wanted, abs=1e-6)
        level = min(-z, DEPTH + z) / math.sin(array.half_angle)
        levels += found == pytest.approx(level, abs=1e-9)
        kinds.add(round(found, 3))
    assert 2 <= levels <= len(POSES) - 2 and len(kinds) > 5


def test_a_pitch_silences_the_surface_and_narrows_the_beam() -> None:
    array, rough = SonarArray(hull_radius=0.1, pitch=0.0), REFLECTORS["diffuse"]
    place, open_water = {"place": (3.0, 2.0, -0.15), "heading": 0.0}, Surfaces((), (rough,) * 4, rough, rough, 9.0)
    for degrees, wanted in ((0.0, 0.15 / math.sin(math.radians(37.5))), (-17.0, 0.15 / math.sin(math.radians(20.5)))):
        pitched = replace(array, pitch=math.radians(degrees))
        assert certain_range(pitched, 0, shapes=[], surfaces=open_water, **place) == pytest.approx(wanted)
    pitched = replace(array, pitch=None)  # the default
    assert pitched.elevation == pytest.approx(math.radians(-18.0))
    assert certain_range(pitched, 0, shapes=[], surfaces=open_water, **place) > 4.5
    assert pitched.half_angle == pytest.approx(math.acos(math.cos(math.radians(37.5)) / math.cos(math.radians(18))))
    near = [(Box((3.3, 2.0), (0.1, 1.0)), REFLECTORS["silent"])]  # hides the surface
    assert certain_range(array, 0, shapes=near, surfaces=open_water, **place) > 4.5
    with pytest.raises(InputError, match="contains the horizontal plane"):
        SonarArray(pitch=0.7)


def test_weak_echoes_are_detected_as_often_as_the_sonar_equation_says() -> None:
    array, firings, smooth = SonarArray(hull_radius=0.0), 3000, REFLECTORS["specular-edges"]
    bodies = [(0, Box((0.9, 0.45), (0.5, 0.3)), smooth), (8, Disc((1.9, -0.3), 0.05), smooth)]
    edges = [(0.65, 0.6), (0.65, 0.3), (1.15, 0.3)]  # the fourth one is behind
    half, parts = array.half_angle, []
    for x, y in edges:
        angle = math.atan2(y, x)
        chance = weak_probability(math.hypot(x, y), angle, half=half, reach=0.6) if angle < half else 0.0
        parts.append((math.hypot(x, y), chance))
    away = math.hypot(1.9, 0.3)
    foot = weak_probability(away - 0.05, math.atan2(0.3, 1.9), half=half, reach=3.2, radius=0.05)
    parts.append((away - 0.05, foot))
    key = echo_keys([3])[0]
    counted: Counter[float] = Counter()
    for instant in range(firings):
        block = firing_block(key, instant, 0)
        found = weak_range(
            array, 0, position=(0.0, 0.0), heading=0.0, bodies=bodies, corners=[],
            uniform=lambda echo, block=block: echo_uniform(key, block, echo),
        )  # fmt: skip
        counted[round(found, 9)] += 1
    wanted = {round(distance, 9): share for distance, share in shares(parts).items()}
    assert set(counted) <= set(wanted)
    for distance, share in wanted.items():
        assert counted[distance] / firings == pytest.approx(
            share, abs=4 * math.sqrt(share * (1 - share) / firings) + 1e-9
        )
    assert sum(0.02 < share < 0.98 for share in wanted.values()) >= 3


@pytest.mark.parametrize("pitch", [0.0, -0.2])
def test_the_compiled_returns_are_those_of_the_reference(pitch: float) -> None:
    array, key = SonarArray(hull_radius=0.1, pitch=pitch), echo_keys([11])[0]
    place, instant, sensor = ca.SX.sym("place", 4), ca.SX.sym("instant"), ca.SX.sym("sensor")
    solids = [
        SolidBox(ca.SX(b.center), ca.SX(b.size)) if isinstance(b, Box) else SolidDisc(ca.SX(b.center), ca.SX(b.radius))
        for b in BODIES
    ]
    beam = beam_of(array, range(4), sensor, position=place[:2], heading=place[3])
    bodies = list(zip(solids, MIXED.obstacles, strict=True))
    walls = SolidWalls(ca.SX([0.0, LENGTH, 0.0, WIDTH]))
    block = firing_block_symbols(ca.SX(key), instant, sensor)
    outputs = [
        certain_range_symbols(array, beam, bodies, walls, z=place[2], surfaces=MIXED),
        weak_range_symbols(
            array,
            beam,
            [(ca.SX(4 * k), *pair) for k, pair in enumerate(bodies)],
            walls,
            surfaces=MIXED,
            uniform=lambda echo: uniform_symbols(ca.SX(key), block, echo),
        ),
    ]
    compiled = ca.Function("returns", [place, instant, sensor], outputs, {"cse": True})
    corners, weak = corner_points(WALLS, MIXED), 0
    assert corners == [(0.0, 0.0)]
    listed = [
        (4 * k, shape, reflector) for k, (shape, reflector) in enumerate(zip(BODIES, MIXED.obstacles, strict=True))
    ]
    for count, (x, y, z, heading) in enumerate(POSES):
        for k in range(4):
            firing = firing_block(key, count, k)
            wanted = (
                certain_range(array, k, place=(x, y, z), heading=heading, shapes=upright(), surfaces=MIXED),
                weak_range(
                    array, k, position=(x, y), heading=heading, bodies=listed, corners=corners,
                    uniform=lambda echo, firing=firing: echo_uniform(key, firing, echo),
                ),
            )  # fmt: skip
            found = [float(value) for value in compiled([x, y, z, heading], count, k)]
            assert found == pytest.approx([min(value, 2 * array.maximum) for value in wanted], abs=1e-12)
            weak += wanted[1] < array.maximum
    assert weak >= 5


def test_the_random_numbers_of_echoes_are_even_and_independent() -> None:
    keys = echo_keys([0, 1])
    grid = np.array(
        [[echo_uniform(key, firing_block(key, instant, 1), echo) for echo in (0, 1)]
         for key in keys for instant in range(1500)]
    ).reshape(2, 1500, 2)  # fmt: skip
    assert grid.min() > 0 and grid.max() < 1
    for sample in (grid[0, :, 0], grid[1, :, 1]):
        counts = np.histogram(sample, bins=20, range=(0, 1))[0]
        assert ((counts - 75.0) ** 2 / 75.0).sum() < 43.8  # chi square with 19 degrees of freedom, 0.1 %
    pairs = ((grid[0, :, 0], grid[0, :, 1]), (grid[0, :, 0], grid[1, :, 0]), (grid[0, :-1, 0], grid[0, 1:, 0]))
    for one, other in pairs:
        assert abs(np.corrcoef(one, other)[0, 1]) < 3.5 / math.sqrt(1500)


def test_the_corner_of_two_smooth_walls_answers_from_any_direction() -> None:
    smooth, rough = REFLECTORS["specular"], REFLECTORS["diffuse"]
    ask = {"position": (1.0, 1.0), "heading": -3 * math.pi / 4, "bodies": [], "uniform": lambda echo: 0.5}
    around = Surfaces((), (smooth, smooth, smooth, rough), smooth, smooth, DEPTH)
    array = SonarArray(hull_radius=0.0)
    assert weak_range(array, 0, corners=corner_points(WALLS, around), **ask) == pytest.approx(math.sqrt(2))
    assert corner_points(WALLS, around) == [(0.0, 0.0), (LENGTH, 0.0)]
    hidden = ask | {"bodies": [(0, Disc((0.5, 0.5), 0.1), Reflector(0.0))]}
    assert weak_range(array, 0, corners=corner_points(WALLS, around), **hidden) == math.inf
