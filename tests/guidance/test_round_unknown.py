"""The way past what is unknown: taken where it is free and gains enough, never through a bound."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from surctl.marine.guidance import Sector
from surctl.marine.guidance.sectors import round_unknown, slowed

Array = NDArray[np.float64]
SPEED = 0.2
AHEAD = (SPEED, 0.0)


@cache
def _past(unknown: int, contacts: int) -> ca.Function:
    velocity = ca.SX.sym("v", 2)
    n, b = ca.SX.sym("n", 2, unknown), ca.SX.sym("b", unknown)
    m, c = ca.SX.sym("m", 2, contacts), ca.SX.sym("c", contacts)
    bounds = [(n[:, k], b[k]) for k in range(unknown)]
    sectors = [Sector(m[:, k], c[k], m[:, k]) for k in range(contacts)]
    past = round_unknown(velocity, bounds, sectors)
    return ca.Function("past", [velocity, n, b, m, c], [past, slowed(past, bounds), slowed(velocity, bounds)])


def past(
    velocity: ArrayLike, unknown: dict[float, float], contacts: dict[float, float] | None = None
) -> tuple[Array, Array, Array]:
    """(velocity past the unknown, that as slow as the bounds ask, the given one so); bearing [deg] to bound [m/s]."""
    contacts = contacts or {180.0: 10.0}
    parts: list[ArrayLike] = []
    for given_ones in (unknown, contacts):
        angles = np.radians(list(given_ones))
        parts += [np.vstack([np.cos(angles), np.sin(angles)]), np.array(list(given_ones.values()))]
    found = _past(len(unknown), len(contacts))(np.asarray(velocity), *parts)
    taken, cautious, before = (np.array(v).ravel() for v in found)
    return taken, cautious, before


def test_what_is_known_ahead_is_not_left() -> None:
    """No bound is met: the velocity stays."""
    assert past(AHEAD, {90.0: 0.05, 0.0: 0.3})[0] == pytest.approx(AHEAD)


def test_beside_an_unknown_place_it_goes_along_it_rather_than_waits() -> None:
    """At 45° nothing may be approached: the edge of that sector runs at −45°, and 0.2 cos 45° of way is made."""
    taken, cautious, before = past(AHEAD, {45.0: 0.0})
    assert before == pytest.approx((0, 0))
    assert taken == pytest.approx((SPEED / np.sqrt(2), -SPEED / np.sqrt(2)))
    assert cautious == pytest.approx(taken)


def test_the_edge_may_lie_on_either_side() -> None:
    """The mirror image."""
    assert past(AHEAD, {-45.0: 0.0})[0] == pytest.approx((SPEED / np.sqrt(2), SPEED / np.sqrt(2)))


def test_straight_ahead_it_waits() -> None:
    """No course makes more way along a normal than its bound allows."""
    assert past(AHEAD, {0.0: 0.05})[0] == pytest.approx(AHEAD)


def test_a_little_more_way_is_not_worth_a_turn() -> None:
    """The straight course keeps 0.19 m/s of 0.2; no edge can gain a tenth."""
    assert past(AHEAD, {45.0: 0.19 * np.cos(np.pi / 4)})[0] == pytest.approx(AHEAD)


def test_no_way_past_leads_into_a_contact() -> None:
    """The edge at −45° is closed by a contact there: it waits."""
    assert past(AHEAD, {45.0: 0.0}, {-45.0: 0.1})[0] == pytest.approx(AHEAD)


@given(
    st.dictionaries(st.floats(-180, 180), st.floats(0, 0.3), min_size=4, max_size=4),
    st.dictionaries(st.floats(-180, 180), st.floats(0.05, 0.3), min_size=3, max_size=3),
    st.floats(-np.pi, np.pi),
)
def test_it_never_makes_less_way_nor_misses_a_bound_more(
    unknown: dict[float, float], contacts: dict[float, float], course: float
) -> None:
    """Whatever is around: along the course at least as much way, at the same speed, and no contact nearer."""
    velocity = SPEED * np.array([np.cos(course), np.sin(course)])
    taken, cautious, before = past(velocity, unknown, contacts)
    assert np.hypot(*taken) == pytest.approx(SPEED)
    assert cautious @ velocity >= before @ velocity - 1e-9

    def missed(v: Array) -> float:
        return max(v @ [np.cos(np.radians(a)), np.sin(np.radians(a))] - b for a, b in contacts.items())

    assert missed(taken) <= max(missed(velocity), 0) + 1e-3 + 1e-9
    for angle, bound in unknown.items():
        assert cautious @ [np.cos(np.radians(angle)), np.sin(np.radians(angle))] <= bound + 1e-9
