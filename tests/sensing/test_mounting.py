"""The parts of a beam that the hull leaves open, by hand and against the definition."""

from __future__ import annotations

import math

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.sensing import SonarArray
from surctl.marine.sensing.sonar.array import open_cones
from surctl.marine.world import Disc
from tests.oracles.echoes import true_range

R = 0.27


def test_on_the_hull_looking_out_nothing_is_hidden():
    for azimuth in np.linspace(-4, 4, 9):
        mount = (R * math.cos(azimuth), R * math.sin(azimuth))
        assert open_cones(mount, azimuth, half_angle=1.5, hull_radius=R) == ((0.0, 1.5),)


def test_on_the_hull_turned_aside_the_beam_ends_at_the_tangent():
    ((offset, half),) = open_cones((R, 0.0), 1.0, half_angle=0.8, hull_radius=R)
    assert offset + half == pytest.approx(math.pi / 2 - 1.0) and offset - half == pytest.approx(-0.8)


def test_from_behind_the_beam_passes_on_both_sides():
    hidden = math.asin(R / 0.9)
    right, left = open_cones((-0.9, 0.0), 0.0, half_angle=0.6, hull_radius=R)
    assert left[0] == pytest.approx(0.5 * (hidden + 0.6)) and left[1] == pytest.approx(0.5 * (0.6 - hidden))
    assert right == pytest.approx((-left[0], left[1]))


def test_the_open_parts_are_those_whose_rays_miss_the_hull():
    rng = np.random.default_rng(2)
    seen = set()
    for _ in range(300):
        bearing, distance = rng.uniform(-4, 4), R * rng.choice([1.0, rng.uniform(1, 4)])
        mount = distance * np.array((math.cos(bearing), math.sin(bearing)))
        azimuth, half = rng.uniform(-30, 30), rng.uniform(0.05, 1.5)
        cones = open_cones(tuple(mount), azimuth, half_angle=half, hull_radius=R)
        seen.add(len(cones))
        looks = np.linspace(-half, half, 2001)
        rays = np.column_stack((np.cos(azimuth + looks), np.sin(azimuth + looks)))
        ahead, beside = rays @ -mount, np.abs(rays[:, 0] * mount[1] - rays[:, 1] * mount[0])
        missed = (ahead <= 0) | (beside >= R)
        within = np.any([np.abs(looks - offset) <= h for offset, h in cones], axis=0) if cones else np.zeros(2001, bool)
        ends = np.array([offset + side * h for offset, h in cones for side in (-1, 1)])
        sure = np.min(np.abs(looks[:, None] - ends), axis=1, initial=np.inf) > 1e-5
        assert np.array_equal(missed[sure], within[sure])
    assert seen == {0, 1, 2}


def test_a_mounted_sensor_sees_from_where_it_stands():
    array = SonarArray(azimuths=(0.0,), mounts=((-0.9, 0.0),), order=(0,), beam_angle=1.2)
    ahead, aside = Disc((2.0, 0.0), 0.1), Disc((2.0, 1.0), 0.1)
    assert true_range(array, 0, position=(0, 0), heading=0.0, shapes=[ahead]) == math.inf  # behind the hull
    assert true_range(array, 0, position=(0, 0), heading=0.0, shapes=[aside]) == pytest.approx(
        math.hypot(2.9, 1.0) - 0.1
    )
    turned = true_range(array, 0, position=(1, 1), heading=math.pi / 2, shapes=[Disc((0.0, 3.0), 0.1)])
    assert turned == pytest.approx(math.hypot(2.9, 1.0) - 0.1)


def test_a_mount_on_the_hull_is_no_mount():
    plain = SonarArray()
    mounts = tuple((R * math.cos(a), R * math.sin(a)) for a in plain.azimuths)
    mounted = SonarArray(mounts=mounts)
    assert mounted.cones == plain.cones
    shapes = [Disc((1.0, 0.4), 0.2), Disc((-1.0, 0.7), 0.3)]
    for sensor in range(4):
        ask = {"position": (0.1, 0.0), "heading": 0.3, "shapes": shapes}
        assert true_range(mounted, sensor, **ask) == pytest.approx(true_range(plain, sensor, **ask), abs=1e-12)


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({"mounts": ((0.3, 0.0),)}, "4 finite points"),
        ({"mounts": ((0.3, 0.0), (0.0, 0.3), (-0.3, 0.0), (0.0, math.nan))}, "4 finite points"),
        ({"mounts": ((0.3, 0.0), (0.0, 0.3), (-0.3, 0.0), (0.0, -0.2))}, "sensor 3 lies inside the hull"),
        ({"mounts": ((0.3, 0.0), (0.0, 0.3), (0.3, 0.0), (0.0, -0.3))}, "sensor 2 looks into the hull"),
    ],
)
def test_mistakes_are_named(values, problem):
    with pytest.raises(InputError, match=problem) as caught:
        SonarArray(**values)
    assert caught.value.key.startswith("array.mounts")
