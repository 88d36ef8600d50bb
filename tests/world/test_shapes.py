"""Geometry against brute-force ray casting written here, independently of the shapes' own formulas."""

from __future__ import annotations

import math
import timeit

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.marine.world import Box, Disc, Wall, site_walls
from tests.oracles.rays import nearest_in_cone
from tests.raycasting import CAST, corners

RAYS = 40_001


def random_shape(rng):
    kind = rng.integers(3)
    center = rng.uniform(-3, 3, 2)
    if kind == 0:
        return Disc(center, rng.uniform(0.05, 1.0))
    if kind == 1:
        return Box(center, rng.uniform(0.1, 2.0, 2), rng.uniform(-4, 4))
    return Wall(center, rng.normal(size=2))


def fan(axis, half):
    angles = np.linspace(axis - half, axis + half, RAYS)
    return np.column_stack((np.cos(angles), np.sin(angles)))


@pytest.mark.parametrize("seed", range(2))
def test_cone_against_ray_casting(seed):
    rng = np.random.default_rng(seed)
    outcomes = {"hit": 0, "miss": 0, "inside": 0}
    for _ in range(60):
        shape, apex = random_shape(rng), rng.uniform(-4, 4, 2)
        axis, half = rng.uniform(-7, 7), math.radians(rng.uniform(2, 85))
        got = nearest_in_cone(shape, apex, axis, half_angle=half)
        if shape.nearest(apex)[0] <= 0:
            assert got == 0.0
            outcomes["inside"] += 1
            continue
        hits = CAST[type(shape)](shape, apex, fan(axis, half))[0]
        nearest = hits.min()
        if math.isinf(nearest):
            # a sliver thinner than the ray spacing may be all that is in the cone
            wider = CAST[type(shape)](shape, apex, fan(axis, half + 1e-4))[0].min()
            assert math.isinf(got) or not math.isinf(wider)
            outcomes["miss"] += 1
            continue
        assert got <= nearest + 1e-9
        # a wall met at a grazing angle lies far away: its tolerance is relative
        assert nearest - got < 1e-3 * max(1.0, nearest)
        outcomes["hit"] += 1
    assert min(outcomes["hit"], outcomes["miss"]) >= 5


@settings(max_examples=80, deadline=None, derandomize=True)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(-4, 4),
    st.floats(-4, 4),
    st.floats(-7, 7),
    st.floats(0.0, 1.5),
)
def test_wider_cone_never_sees_further(seed, x, y, axis, half):
    shape = random_shape(np.random.default_rng(seed))
    narrow = nearest_in_cone(shape, (x, y), axis, half_angle=half)
    wide = nearest_in_cone(shape, (x, y), axis, half_angle=half + 0.05)
    assert wide <= narrow + 1e-9
    assert narrow >= max(shape.nearest((x, y))[0], 0.0) - 1e-9


@settings(max_examples=80, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.floats(-4, 4), st.floats(-4, 4))
def test_nearest_point_lies_on_the_surface_at_the_distance(seed, x, y):
    shape = random_shape(np.random.default_rng(seed))
    distance, foot = shape.nearest((x, y))
    assert math.hypot(foot[0] - x, foot[1] - y) == pytest.approx(abs(distance), abs=1e-12)
    assert shape.nearest(foot)[0] == pytest.approx(0.0, abs=1e-12)


def test_nearest_against_points_of_the_outline():
    rng = np.random.default_rng(7)
    for _ in range(50):
        box, point = (
            Box(rng.uniform(-2, 2, 2), rng.uniform(0.1, 2, 2), rng.uniform(-4, 4)),
            rng.uniform(-3, 3, 2),
        )
        a = corners(box)
        s = np.linspace(0, 1, 4001)[:, None, None]
        outline = ((1 - s) * a + s * np.roll(a, -1, axis=0)).reshape(-1, 2)
        expected = np.hypot(*(outline - point).T).min()
        assert abs(box.nearest(point)[0]) == pytest.approx(expected, abs=1e-3)


def test_inside_is_negative():
    assert Disc((0, 0), 1.0).nearest((0.0, 0.0))[0] == -1.0
    assert Box((0, 0), (2, 4)).nearest((0.5, 0.0))[0] == pytest.approx(-0.5)
    assert Wall((0, 0), (0, 3)).nearest((2.0, -0.25))[0] == -0.25


def test_tank_walls_enclose_the_water():
    walls = site_walls(5.0, 10.0)
    point = (3.0, 1.0)
    assert [wall.nearest(point)[0] for wall in walls] == [3.0, 7.0, 1.0, 4.0]
    assert all(wall.nearest((-1.0, 6.0))[0] < 0 for wall in (walls[0], walls[3]))


@pytest.mark.parametrize(
    ("build", "key"),
    [
        (lambda: Disc((0, 0), 0.0), "disc.radius"),
        (lambda: Disc((0, math.nan), 1.0), "disc.center"),
        (lambda: Disc((0, 0, 0), 1.0), "disc.center"),
        (lambda: Box((0, 0), (1.0, -1.0)), "box.size"),
        (lambda: Box((0, 0), (1.0, 1.0), math.inf), "box.angle"),
        (lambda: Wall((0, 0), (0, 0)), "wall.normal"),
        (lambda: site_walls(0.0, 1.0), "site.width"),
        (lambda: nearest_in_cone(Disc((0, 0), 1.0), (2, 0), 0.0, half_angle=math.pi / 2), "half_angle"),
        (lambda: nearest_in_cone(Disc((0, 0), 1.0), (math.nan, 0), 0.0, half_angle=0.3), "apex, axis"),
    ],
)
def test_mistakes_are_named(build, key):
    with pytest.raises(InputError) as caught:
        build()
    assert caught.value.key == key


def test_a_cone_query_is_cheap():
    shapes = [Disc((2, 0.1), 0.3), Box((2, 1), (1.6, 0.3), 0.2), Wall((5, 0), (-1, 0))]
    calls = 3000
    for shape in shapes:
        seconds = min(
            timeit.repeat(lambda s=shape: nearest_in_cone(s, (0.0, 0.0), 0.1, half_angle=0.6), number=calls, repeat=3)
        )
        # a few microseconds; the bound leaves room for a busy machine
        assert seconds / calls < 50e-6
