from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.ir import Layout
from surctl.marine.sensing import SonarArray
from surctl.marine.sensing.mapping.contacts import ContactMemory, Contacts, expected_range, sonar_contacts
from surctl.marine.world import Disc, site_walls
from tests.oracles.echoes import nearest_echo
from tests.oracles.rays import nearest_in_cone

ARRAY = SonarArray()
SITE = (0.0, 10.0, 0.0, 5.0)


def expected_function(azimuth, discs=3, half_angle=ARRAY.half_angle, incidence=None):
    position, heading, walls = ca.SX.sym("p", 2), ca.SX.sym("h", 2), ca.SX.sym("w", 4)
    table, valid = ca.SX.sym("d", discs, 3), ca.SX.sym("v", discs)
    value = expected_range(
        position,
        heading,
        walls=walls,
        discs=table,
        valid=valid,
        azimuth=azimuth,
        hull_radius=ARRAY.hull_radius,
        half_angle=half_angle,
        maximum=ARRAY.maximum,
        incidence=incidence,
    )
    return ca.Function("e", [position, heading, walls, table, valid], [value])


@pytest.mark.parametrize(("sensor", "degrees"), [(0, 7.5), (1, 37.5), (2, 60.0), (3, 37.5)])
def test_expected_range_is_the_worlds(sensor, degrees):
    half = math.radians(degrees)
    azimuth = ARRAY.azimuths[sensor]
    f = expected_function(azimuth, half_angle=half)
    rng = np.random.default_rng(sensor)
    by_disc = 0
    for _ in range(300):
        position, psi = rng.uniform((0.3, 0.3), (9.7, 4.7)), rng.uniform(-7, 7)
        table = np.column_stack((rng.uniform(0, 10, 3), rng.uniform(0, 5, 3), rng.uniform(0.05, 0.6, 3)))
        valid = rng.integers(0, 2, 3)
        known = [Disc(row[:2], row[2]) for row, there in zip(table, valid, strict=True) if there]
        axis = psi + azimuth
        apex = position + ARRAY.hull_radius * np.array((math.cos(axis), math.sin(axis)))
        ranges = [nearest_in_cone(s, apex, axis, half_angle=half) for s in (*site_walls(5.0, 10.0), *known)]
        by_disc += ranges.index(min(ranges)) >= 4
        got = float(f(position, (math.cos(psi), math.sin(psi)), SITE, table, valid))
        assert got == pytest.approx(min(min(ranges), 2 * ARRAY.maximum), abs=1e-9)
    assert by_disc > 5


@pytest.mark.parametrize("degrees", [7.5, 37.5])
def test_a_specular_wall_answers_only_near_its_normal_and_ends_at_the_next_wall(degrees):
    half, limit = math.radians(degrees), math.radians(22.5)
    f = expected_function(0.0, discs=0, half_angle=half, incidence=limit)
    rng, farther = np.random.default_rng(7), 0
    for _ in range(300):
        position, psi = rng.uniform((0.3, 0.3), (9.7, 4.7)), rng.uniform(-7, 7)
        apex = position + ARRAY.hull_radius * np.array((math.cos(psi), math.sin(psi)))
        if not (0 < apex[0] < 10 and 0 < apex[1] < 5):
            continue
        truth = nearest_echo(site_walls(5.0, 10.0), apex, psi, half_angle=half, incidence_limit=limit)
        got = float(f(position, (math.cos(psi), math.sin(psi)), SITE, np.zeros((0, 3)), np.zeros(0)))
        assert got == pytest.approx(min(truth, 2 * ARRAY.maximum), abs=1e-6)
        farther += truth > min(nearest_in_cone(s, apex, psi, half_angle=half) for s in site_walls(5.0, 10.0)) + 0.1
    assert farther > 50


def test_expected_range_without_anything_in_the_cone():
    f = expected_function(0.0, discs=0)
    far = (-100.0, 100.0, -100.0, 100.0)
    assert float(f((0, 0), (1, 0), far, np.zeros((0, 3)), np.zeros(0))) == 2 * ARRAY.maximum


def test_expected_range_stays_finite_at_the_centre_of_a_disc():
    f = expected_function(0.0, discs=1)
    disc = np.array([[5.0 + ARRAY.hull_radius, 2.0, 0.3]])
    assert float(f((5, 2), (1, 0), SITE, disc, [1.0])) == 0.0


def test_half_angle_is_checked():
    with pytest.raises(InputError) as caught:
        expected_function(0.0, half_angle=math.pi / 2)
    assert caught.value.key == "half_angle"


def contacts_function():
    r, p, h, e = ca.SX.sym("r", 4), ca.SX.sym("p", 2), ca.SX.sym("h", 2), ca.SX.sym("e", 4)
    hull = ca.SX.sym("hull")
    out = sonar_contacts(ARRAY, r, position=p, heading=h, hull_radius=hull, expected=e)
    return ca.Function("c", [r, p, h, hull, e], [out.points, out.valid])


def test_contacts_stand_on_the_axes_and_known_things_explain_theirs():
    psi = 0.3
    ranges, expected = np.array([1.0, 4.45, 2.0, 2.0]), np.array([9.0, 9.0, 2.05, 2.5])
    points, valid = contacts_function()(ranges, (1.0, 2.0), (math.cos(psi), math.sin(psi)), 0.2, expected)
    axes = psi + np.array(ARRAY.azimuths)
    reach = 0.2 + ranges
    want = np.array((1.0, 2.0)) + reach[:, None] * np.column_stack((np.cos(axes), np.sin(axes)))
    assert np.array(points) == pytest.approx(want, abs=1e-12)
    # an echo; nothing heard; explained by the known; nearer than the known
    assert np.array(valid).ravel().tolist() == [1, 0, 0, 1]


def memory_function(memory):
    layout = Layout(memory.ports("m_"))
    x, parts = layout.symbols("x")
    points, valid, fresh = ca.SX.sym("c", 4, 2), ca.SX.sym("v", 4), ca.SX.sym("f", 4)
    after, kept = memory.update(parts, Contacts(points, valid), fresh=fresh, prefix="m_")
    return ca.Function("m", [x, points, valid, fresh], [layout.join(after), kept.points, kept.valid]), layout


def test_an_echo_is_kept_where_it_was_for_half_a_second():
    f, layout = memory_function(ContactMemory(dt=0.05))
    seen = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0], [7.0, 8.0]])
    x, _, valid = f(layout.pack(), seen, np.ones(4), np.zeros(4))
    assert not np.array(valid).any()
    x, points, valid = f(x, seen, [1, 0, 1, 1], [1, 1, 0, 1])
    assert np.array(valid).ravel().tolist() == [1, 0, 0, 1]
    assert np.array_equal(np.array(points)[[0, 3]], seen[[0, 3]])
    for k in range(1, 30):
        x, points, valid = f(x, seen + 1.0, [0, 0, 0, 1], [1, 1, 1, 0])
        assert bool(np.array(valid)[0]) == (k <= 10)
        assert np.array_equal(np.array(points)[0], seen[0])
    x, points, valid = f(x, seen + 1.0, [1, 0, 0, 0], [1, 0, 0, 0])
    assert np.array(valid).ravel().tolist() == [1, 0, 0, 0]
    assert np.array_equal(np.array(points)[0], seen[0] + 1.0)


def test_memory_periods_are_checked():
    with pytest.raises(InputError):
        ContactMemory(dt=0.0)
    with pytest.raises(InputError):
        ContactMemory(dt=0.05, hold=math.nan)
