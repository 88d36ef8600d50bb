"""Contacts: discs, points, walls, and what a sensor stands for."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from surctl.marine.guidance import Contact
from surctl.marine.guidance.contacts import FAR, disc_contact, nearest_in_quadrants, point_contact, wall_contacts

Array = NDArray[np.float64]
HULL = 0.27
coordinates = st.floats(-5, 5)

_p, _c, _v = (ca.SX.sym(n, 2) for n in "pcv")
_r, _valid = ca.SX.sym("r"), ca.SX.sym("valid")


def _numbers(contact: Contact) -> list[ca.SX]:
    return [contact.normal, contact.clearance, contact.velocity, contact.combined_radius, contact.closing]


_DISC = ca.Function("disc", [_p, _c, _r, _v, _valid], _numbers(disc_contact(_p, ca.SX(HULL), _c, _r, _v, _valid)))
_POINT = ca.Function("point", [_p, _c, _valid], _numbers(point_contact(_p, ca.SX(HULL), _c, _valid)))


def _flat(results: Any) -> list[Array]:
    return [np.asarray(r, dtype=float).reshape(-1) for r in results]


@settings(derandomize=True, deadline=None)
@given(coordinates, coordinates, st.floats(0, 1))
def test_disc(x: float, y: float, radius: float) -> None:
    normal, clearance, velocity, reach, closing = _flat(_DISC([0.4, -0.2], [x, y], radius, [0.1, 0.2], 1))
    offset = np.array([x - 0.4, y + 0.2])
    distance = np.linalg.norm(offset)
    assert clearance[0] == pytest.approx(distance - radius - HULL, abs=1e-12)
    assert reach[0] == pytest.approx(HULL + radius)
    assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-9)
    if distance > 1e-5:
        np.testing.assert_allclose(normal, offset / distance, atol=1e-12)
    np.testing.assert_allclose(velocity, [0.1, 0.2])
    assert closing[0] == pytest.approx(float(normal @ [0.1, 0.2]), abs=1e-15)


def test_a_contact_that_is_not_there_is_far() -> None:
    assert _flat(_DISC([0, 0], [0.5, 0], 0.1, [0, 0], 0))[1][0] == FAR
    assert _flat(_POINT([0, 0], [0.5, 0], 0))[1][0] == FAR


def test_on_top_of_the_centre_the_numbers_stay_finite() -> None:
    for found in _flat(_DISC([1, 1], [1, 1], 0.1, [0, 0], 1)):
        assert np.isfinite(found).all()


def test_a_point_is_a_disc_of_radius_zero_that_stands_still() -> None:
    point, disc = _flat(_POINT([0, 0], [1.0, 2.0], 1)), _flat(_DISC([0, 0], [1.0, 2.0], 0, [0, 0], 1))
    for a, b in zip(point, disc, strict=True):
        np.testing.assert_array_equal(a, b)


def test_walls() -> None:
    walls = ca.SX([0.0, 10.0, 1.0, 5.0])
    normals = [[-1, 0], [1, 0], [0, -1], [0, 1]]
    for contact, normal, distance in zip(wall_contacts(_p, ca.SX(HULL), walls), normals, (3, 7, 1.5, 2.5), strict=True):
        n, clearance, velocity, reach, _ = _flat(ca.Function("wall", [_p], _numbers(contact))([3.0, 2.5]))
        np.testing.assert_array_equal(n, normal)
        assert clearance[0] == pytest.approx(distance - HULL)
        np.testing.assert_array_equal(velocity, 0)
        assert reach[0] == HULL


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.integers(0, 10**6), st.floats(-3.1, 3.1))
def test_each_sensor_stands_for_the_nearest_contact_of_its_quadrant(seed: int, heading: float) -> None:
    rng = np.random.default_rng(seed)
    bearings, clearances = rng.uniform(-np.pi, np.pi, 6), rng.uniform(0, 3, 6)
    contacts = [
        Contact(ca.SX([np.cos(b), np.sin(b)]), ca.SX(c), ca.SX([0.01 * k, 0.0]), ca.SX(0.1 * k))
        for k, (b, c) in enumerate(zip(bearings, clearances, strict=True))
    ]
    angles = heading + np.array([0, 0.5, 1.0, 1.5]) * np.pi
    axes = [ca.SX([np.cos(a), np.sin(a)]) for a in angles]
    for angle, found in zip(angles, nearest_in_quadrants(contacts, axes), strict=True):
        off = np.abs((bearings - angle + np.pi) % (2 * np.pi) - np.pi)
        if np.any(np.abs(off - np.pi / 4) < 1e-3):
            continue  # on the border either answer is right
        inside = np.flatnonzero(off < np.pi / 4)
        normal, clearance, velocity, reach, _ = _flat([ca.evalf(m) for m in _numbers(found)])
        if inside.size == 0:
            assert clearance[0] == FAR
            np.testing.assert_allclose(normal, [np.cos(angle), np.sin(angle)], atol=1e-15)
            continue
        k = inside[np.argmin(clearances[inside])]
        np.testing.assert_allclose(normal, [np.cos(bearings[k]), np.sin(bearings[k])], atol=1e-15)
        np.testing.assert_allclose([clearance[0], velocity[0], reach[0]], [clearances[k], 0.01 * k, 0.1 * k])
