"""The directions that a mark of the map stores: which silence clears it."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from surctl.marine.sensing.mapping.firing import (
    BESIDE,
    DIRECTIONS,
    WIDEST,
    bearing,
    confirms,
    includes,
    level,
    sector_with,
)


def number(expression):
    return float(ca.evalf(ca.SX(expression)))


def heard(*directions):
    """A cell heard from these directions, one after another."""
    value = ca.SX(0)
    for direction in directions:
        value = sector_with(value, ca.SX(direction), goes_on=ca.SX(1))
    return value


def admitted(value):
    """Whole directions from which silence clears the cell."""
    return {d for d in range(DIRECTIONS) if number(includes(value, ca.SX(d + 0.5), ca.SX(BESIDE)))}


def test_directions_are_nearly_equal_and_go_round():
    angles = np.radians(np.arange(0.5, 360.0))
    found = np.array([number(bearing(ca.SX(np.cos(a)), ca.SX(np.sin(a)))) for a in angles])
    assert np.all(np.diff(found) > 0) and found[0] > 0 and found[-1] < DIRECTIONS
    assert np.max(np.abs(found - angles * DIRECTIONS / (2 * np.pi))) < 0.15


@pytest.mark.parametrize("start", [0, 3, 30])
def test_a_sector_grows_both_ways_round_the_compass(start):
    at = [(start + k) % DIRECTIONS + 0.5 for k in range(4)]
    around = {(start + k) % DIRECTIONS for k in range(-1, 5)}
    assert admitted(heard(*at)) == admitted(heard(*at[::-1])) == admitted(heard(at[0], at[3])) == around
    assert admitted(heard(at[0])) == {(start + k) % DIRECTIONS for k in range(-1, 2)}


def test_a_direction_too_far_off_begins_another_sector():
    assert admitted(heard(2.5, 2.5 + WIDEST + 1)) == {6, 7, 8}
    assert len(admitted(heard(2.5, 2.5 + WIDEST))) == WIDEST + 3


def test_only_a_mark_of_several_directions_is_confirmed():
    assert not number(confirms(heard(2.5, 2.9))) and number(confirms(heard(2.5, 3.5)))
    assert not number(confirms(ca.SX(1))) and admitted(ca.SX(1)) == set(range(DIRECTIONS))


def test_the_strength_is_apart_from_the_directions():
    value = heard(31.5, 0.5, 1.5)
    assert number(level(value)) == 1 and number(level(value - 0.75)) == 0.25
    assert number(level(ca.SX(-0.75))) == -0.75
    assert admitted(value - 0.75) == admitted(value)
