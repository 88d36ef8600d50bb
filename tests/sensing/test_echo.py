"""The echo of whole scenes against brute-force ray casting, and the compiled loop's twin against the reference."""

from __future__ import annotations

import math
from functools import cache

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.sensing import SonarArray
from surctl.marine.sensing.sonar.echo import beam_of, echo_range, echo_samples
from surctl.marine.sensing.sonar.solids import SolidBox, SolidDisc, SolidWalls
from surctl.marine.world import Box, Disc, site_walls
from tests.oracles.echoes import firing_samples, nearest_echo, true_range
from tests.oracles.rays import nearest_in_cone
from tests.raycasting import corners, nearest_by_rays

WEBOTS = math.radians(22.5)
LENGTH, WIDTH = 6.0, 4.0
BOXES, DISCS = 3, 2
BEAMS = (15.0, 120.0)
HULL = 0.27
# on the hull and looking along it, off it and looking past it, behind it and looking across it, and once more
MOUNTS = ((HULL, 0.0), (0.05, HULL + 0.05), (-0.9, 0.1), (0.1, -0.6))
AZIMUTHS = (1.2, 0.4, 0.1, 2.136)


def _outline(shape):
    if isinstance(shape, Disc):
        turn = np.linspace(0, 2 * np.pi, 400)
        return np.array(shape.center) + shape.radius * np.column_stack((np.cos(turn), np.sin(turn)))
    a, s = corners(shape), np.linspace(0, 1, 100)[:, None, None]
    return ((1 - s) * a + s * np.roll(a, -1, axis=0)).reshape(-1, 2)


def _bodies(rng):
    """Bodies in the tank that do not overlap each other or the walls."""
    found = []
    while len(found) < BOXES + DISCS:
        center = rng.uniform((0.5, 0.5), (LENGTH - 0.5, WIDTH - 0.5))
        if len(found) < BOXES:
            new = Box(center, rng.uniform(0.1, 1.6, 2), rng.uniform(-4, 4))
        else:
            new = Disc(center, rng.uniform(0.05, 0.5))
        line = _outline(new)
        within = np.all((line > 0.01) & (line < (LENGTH - 0.01, WIDTH - 0.01)))
        if within and all(
            min(old.nearest(p)[0] for p in line) > 0.01 and min(new.nearest(p)[0] for p in _outline(old)) > 0.01
            for old in found
        ):
            found.append(new)
    return found


@cache
def _scene(seed):
    """Bodies, all shapes, and a pose in the open water."""
    rng = np.random.default_rng(seed)
    bodies = _bodies(rng)
    shapes = [*bodies, *site_walls(WIDTH, LENGTH)]
    while True:
        place = rng.uniform((0, 0), (LENGTH, WIDTH))
        if min(shape.nearest(place)[0] for shape in shapes) > 0.02:
            return bodies, shapes, place, rng.uniform(-7, 7)


@cache
def _twin(array, sensors):
    """The echo in symbols, as a function of turn, place, heading, boxes (n, 6) and discs (n, 4), present last."""
    turn, place, heading = ca.SX.sym("turn"), ca.SX.sym("place", 2), ca.SX.sym("heading")
    boxes, discs = ca.SX.sym("boxes", BOXES, 6), ca.SX.sym("discs", DISCS, 4)
    solids = [SolidBox(boxes[k, :2].T, boxes[k, 2:4].T, boxes[k, 4], boxes[k, 5]) for k in range(BOXES)]
    solids += [SolidDisc(discs[k, :2].T, discs[k, 2], discs[k, 3]) for k in range(DISCS)]
    solids.append(SolidWalls(ca.SX([0.0, LENGTH, 0.0, WIDTH])))
    beam = beam_of(array, sensors, turn, position=place, heading=heading)
    inputs = [turn, place, heading, boxes, discs]
    return ca.Function("echo", inputs, [echo_range(array, beam, solids)], {"cse": True})


def _numbers(bodies, present):
    boxes = [[*b.center, *b.size, b.angle, there] for b, there in zip(bodies[:BOXES], present, strict=False)]
    discs = [[*d.center, d.radius, there] for d, there in zip(bodies[BOXES:], present[BOXES:], strict=True)]
    return ca.DM(np.array(boxes, dtype=float)), ca.DM(np.array(discs, dtype=float))


def _array(beam, *, limit, mounted):
    mounts = {"mounts": MOUNTS, "azimuths": AZIMUTHS} if mounted else {}
    return SonarArray(beam_angle=math.radians(beam), incidence_limit=limit, hull_radius=HULL, **mounts)


@pytest.mark.parametrize(("beam", "limit"), [(BEAMS[0], None), (BEAMS[-1], WEBOTS)], ids=["all", "facing"])
def test_scenes_against_ray_casting(beam, limit):
    array, outcomes = _array(beam, limit=limit, mounted=False), {"hit": 0, "miss": 0, "other": 0}
    for seed in range(14):
        _, shapes, place, axis = _scene(seed)
        got = nearest_echo(shapes, place, axis, half_angle=array.half_angle, incidence_limit=limit)
        wanted = nearest_by_rays(shapes, place, axis, array.half_angle, limit=limit)
        assert got == wanted or abs(got - wanted) < 1e-6, (seed, got, wanted)
        outcomes["hit" if math.isfinite(got) else "miss"] += 1
        outcomes["other"] += got != nearest_echo(shapes, place, axis, half_angle=array.half_angle)
    assert outcomes["hit"] >= 5
    # walls all round: only a narrow beam finds nothing that faces it
    assert (outcomes["miss"] > 0) == (limit is not None and beam < 20), outcomes
    assert (outcomes["other"] >= 3) == (limit is not None), outcomes


@pytest.mark.parametrize(("beam", "limit"), [(120.0, WEBOTS)])
def test_the_hulls_shadow_against_ray_casting(beam, limit):
    array, shadowed = _array(beam, limit=limit, mounted=True), 0
    for seed in range(100, 108):
        _, shapes, place, heading = _scene(seed)
        for sensor in range(array.size):
            x, y, axis = array.apex(sensor, position=place, heading=heading)
            got = true_range(array, sensor, position=place, heading=heading, shapes=shapes)
            rays = {"limit": limit, "hull": Disc(place, HULL)}
            wanted = nearest_by_rays(shapes, (x, y), axis, array.half_angle, **rays)
            assert got == wanted or abs(got - wanted) < 1e-6, (seed, sensor, got, wanted)
            without = nearest_by_rays(shapes, (x, y), axis, array.half_angle, limit=limit)
            shadowed += abs(wanted - without) > 1e-6
    assert shadowed >= 2 or beam < 20


@pytest.mark.parametrize(  # the others: study 40
    ("beam", "limit", "mounted"), [(BEAMS[0], None, False), (BEAMS[-1], WEBOTS, True), (BEAMS[0], 1.2, True)]
)
def test_symbols_and_numbers_give_the_same_range(beam, limit, mounted):
    array, sensors = _array(beam, limit=limit, mounted=mounted), (0, 3, 1, 2)
    twin, nothing, heard_some = _twin(array, sensors), 2.0 * array.maximum, 0
    for seed in range(12):
        (bodies, _, place, heading), rng = _scene(seed), np.random.default_rng(seed)
        if seed % 10 == 0:
            place = rng.uniform((0, 0), (LENGTH, WIDTH))  # maybe inside of something
        if seed % 10 == 1:
            place = rng.uniform((-1, -1), (0, 0))  # behind a wall
        present = rng.integers(0, 2, len(bodies))
        there = [b for b, is_there in zip(bodies, present, strict=True) if is_there]
        boxes, discs = _numbers(bodies, present)
        for turn, sensor in enumerate(sensors):
            shapes = [*there, *site_walls(WIDTH, LENGTH)]
            wanted = true_range(array, sensor, position=place, heading=heading, shapes=shapes)
            got = float(twin(turn, ca.DM(place), heading, boxes, discs))
            assert abs(got - min(wanted, nothing)) < 1e-12, (seed, sensor, got, wanted)
            heard_some += 0 < wanted < nothing
    assert heard_some > 12


def test_a_box_along_the_axes_needs_no_angle():
    array = SonarArray(incidence_limit=0.5)
    for angle in (0.0, ca.SX(0)):
        beam = beam_of(array, (0,), 0, position=ca.SX([0, 0]), heading=ca.SX(0.1))
        box = SolidBox(ca.SX([2.0, 0.3]), ca.SX([0.4, 1.6]), angle)
        found = float(ca.DM(echo_range(array, beam, [box])))
        assert found == true_range(
            array, 0, position=(0, 0), heading=0.1, shapes=[Box((2.0, 0.3), (0.4, 1.6))]
        ) or found == pytest.approx(1.8 - 0.27 * math.cos(0.1), abs=1e-12)


def test_a_silent_box_still_hides_the_wall_behind_it():
    walls = site_walls(5.0, 10.0)
    oblique = Box((7.0, 2.5), (1.0, 1.0), math.pi / 4)
    ask = {"half_angle": 0.05, "incidence_limit": WEBOTS}
    assert nearest_echo(walls, (4.0, 2.5), 0.0, **ask) == pytest.approx(6.0)
    assert nearest_echo((oblique, *walls), (4.0, 2.5), 0.0, **ask) == math.inf
    # its echo comes once a face is turned to the listener, and what stands beside it is heard as before
    assert nearest_echo((Box((7.0, 2.5), (1.0, 1.0), 0.1), *walls), (4.0, 2.5), 0.0, **ask) < 2.6
    aside = {"half_angle": 0.4, "incidence_limit": WEBOTS}
    past = nearest_echo((oblique, *walls), (4.0, 2.5), 0.0, **aside)
    assert past == pytest.approx(6.0 / math.cos(math.atan2(math.sqrt(0.5), 3.0)), abs=1e-6)


def test_a_corner_answers_as_the_end_of_a_face_and_not_by_itself():
    # from the diagonal both faces are met at 45° and more
    box, apex, axis = Box((0, 0), (2, 2)), (4.0, 4.0), -3 * math.pi / 4
    corner = math.dist(apex, (1, 1))
    found = {
        degrees: nearest_echo([box], apex, axis, half_angle=0.6, incidence_limit=math.radians(degrees))
        for degrees in (40, 44.9, 45.1, 80)
    }
    assert found[40] == found[44.9] == math.inf
    assert found[45.1] == pytest.approx(corner, abs=1e-7) and found[80] == pytest.approx(corner, abs=1e-7)
    assert nearest_echo([box], apex, axis, half_angle=0.6) == corner


def test_no_limit_is_the_nearest_point_of_each_shape():
    _, shapes, place, axis = _scene(4)
    alone = [nearest_in_cone(shape, place, axis, half_angle=0.6) for shape in shapes]
    assert nearest_echo(shapes, place, axis, half_angle=0.6) == min(alone)
    assert nearest_echo([], place, axis, half_angle=0.6) == math.inf
    assert nearest_echo([], place, axis, half_angle=0.6, incidence_limit=0.5) == math.inf


def test_samples_in_symbols_are_those_of_the_reference():
    rng = np.random.default_rng(3)
    for array in (SonarArray(), SonarArray(calibrated_for=343.0), SonarArray(blind_time=4e-4, temperature=7.0)):
        distance, noise = ca.SX.sym("distance"), ca.SX.sym("noise", array.samples)
        twin = ca.Function("samples", [distance, noise], [echo_samples(array, distance, noise=noise)])
        for far in [0.0, 0.1, 4.49, 4.5, 4.51, 9.0, *rng.uniform(0, 5, 200)]:
            drawn = rng.standard_normal(array.samples)
            wanted = firing_samples(array, far, noise=drawn)
            assert np.allclose(np.asarray(twin(far, drawn)).ravel(), wanted, rtol=0, atol=1e-12)


def test_mistakes_are_named():
    with pytest.raises(InputError, match="incidence_limit"):
        nearest_echo([], (0, 0), 0.0, half_angle=0.5, incidence_limit=math.pi / 2)
    with pytest.raises(InputError, match="half_angle"):
        nearest_echo([], (0, 0), 0.0, half_angle=math.pi / 2, incidence_limit=0.3)
    with pytest.raises(InputError, match="finite"):
        nearest_echo([], (0, math.nan), 0.0, half_angle=0.5, incidence_limit=0.3)
    with pytest.raises(InputError, match="no such sensor"):
        beam_of(SonarArray(), (4,), 0, position=ca.SX(2, 1), heading=ca.SX(0))
