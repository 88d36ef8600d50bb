"""Upright solids of finite height: distances against brute force over their surface, written here."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.world import WHOLE, Box, Disc, Heights, Prism, Wall

STEP = 0.02
Points = NDArray[np.float64]


def _filled(base: Box | Disc) -> Points:
    """Points of the base (k, 2), its rim among them, at most STEP apart."""
    if isinstance(base, Disc):
        spokes = max(8, math.ceil(2 * math.pi * base.radius / STEP))
        turns = np.linspace(0, 2 * math.pi, spokes, endpoint=False)
        rings = np.linspace(0, base.radius, max(2, math.ceil(base.radius / STEP) + 1))
        flat = np.stack([np.outer(rings, f(turns)).ravel() for f in (np.cos, np.sin)], axis=1)
        return flat + np.array(base.center)
    axes = [np.linspace(-edge / 2, edge / 2, max(2, math.ceil(edge / STEP) + 1)) for edge in base.size]
    x, y = (grid.ravel() for grid in np.meshgrid(*axes))
    c, s = math.cos(base.angle), math.sin(base.angle)
    return np.column_stack([c * x - s * y, s * x + c * y]) + np.array(base.center)


def _inside(base: Box | Disc, x: float, y: float) -> bool:
    dx, dy = x - base.center[0], y - base.center[1]
    if isinstance(base, Disc):
        return math.hypot(dx, dy) <= base.radius
    c, s = math.cos(base.angle), math.sin(base.angle)
    return abs(c * dx + s * dy) <= base.size[0] / 2 and abs(c * dy - s * dx) <= base.size[1] / 2


def _brute(base: Box | Disc, heights: Heights, point: Points) -> float:
    """Least distance to a point of the solid, found among points at most STEP apart in each axis."""
    flat = _filled(base)
    levels = np.linspace(heights.bottom, heights.top, max(2, math.ceil((heights.top - heights.bottom) / STEP) + 1))
    across = np.hypot(*(flat - point[:2]).T)
    return float(np.hypot.outer(across, levels - point[2]).min())


def _drawn(rng: np.random.Generator) -> tuple[Box | Disc, Heights, Points]:
    centre = rng.uniform(-0.5, 0.5, 2)
    base = (
        Disc(centre, rng.uniform(0.1, 0.5)) if rng.random() < 0.5 else Box(centre, rng.uniform(0.1, 1, 2), rng.normal())
    )
    bottom = rng.uniform(-1, 0)
    return base, Heights(bottom, bottom + rng.uniform(0.1, 0.8)), rng.uniform(-1.5, 1.5, 3)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.integers(0, 10**6))
def test_the_distance_is_that_to_the_nearest_point_of_the_solid(seed: int) -> None:
    base, heights, point = _drawn(np.random.default_rng(seed))
    found, nearest = Prism(base, heights).distance(*point.tolist()), _brute(base, heights, point)
    if _inside(base, point[0], point[1]) and heights.bottom <= point[2] <= heights.top:
        assert found <= 0 and nearest <= STEP
    else:
        assert found > 0
        assert found - 1e-9 <= nearest <= found + STEP


@settings(derandomize=True, deadline=None, max_examples=40)
@given(st.integers(0, 10**6), st.floats(0.05, 0.5))
def test_a_spherical_hull_touches_where_a_point_of_the_solid_lies_in_it(seed: int, hull: float) -> None:
    base, heights, point = _drawn(np.random.default_rng(seed))
    clearance = Prism(base, heights).distance(*point.tolist()) - hull
    nearest = _brute(base, heights, point) - hull
    if nearest <= 0:
        assert clearance <= 0
    if clearance <= 0:
        assert nearest <= STEP


def test_inside_it_is_the_way_to_the_nearest_face() -> None:
    slab = Prism(Box((0.0, 0.0), (2.0, 4.0)), Heights(-1.0, 1.0))
    assert slab.distance(0.0, 0.0, 0.9) == pytest.approx(-0.1)
    assert slab.distance(0.7, 0.0, 0.0) == pytest.approx(-0.3)
    assert slab.distance(0.0, 0.0, 1.5) == pytest.approx(0.5)
    assert slab.distance(1.3, 0.0, 1.4) == pytest.approx(0.5)


def test_the_whole_column_is_planar_to_the_last_digit() -> None:
    rng = np.random.default_rng(0)
    for base in (Disc((0.1, 0.2), 0.3), Box((0.1, 0.2), (0.3, 0.4), 0.5), Wall((0.0, 0.0), (1.0, 2.0))):
        for x, y, z in rng.uniform(-1, 1, (20, 3)).tolist():
            assert Prism(base).distance(x, y, z) == base.foot(x, y)[0]
    assert WHOLE.whole and not Heights(top=-1.0).whole and not Heights(bottom=-1.0).whole


def test_heights() -> None:
    sill = Heights(top=-1.8)
    assert sill.gap(-1.5) == pytest.approx(0.3) and sill.gap(-2.0) == pytest.approx(-0.2)
    assert sill.crosses(-1.5, 0.31) and not sill.crosses(-1.5, 0.29) and sill.crosses(-9.0, 0.0)
    assert sill.shares(Heights(-2.0, 0.0)) and not sill.shares(Heights(bottom=-1.8))
    assert WHOLE.shares(sill) and WHOLE.crosses(1e9, 0.0)


@pytest.mark.parametrize("ends", [(-1.0, -2.0), (-1.0, -1.0), (math.nan, 0.0), (-1.0, math.nan)])
def test_ends_the_wrong_way_round_are_named(ends: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="z is up"):
        Heights(*ends)
