"""The side on which what comes head-on is passed."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from surctl.marine.guidance import Sector, inside
from surctl.marine.guidance.contacts import (
    collision_cone,
    disc_contact,
    passes_left,
    side_costs,
    swap_costs,
    wall_contacts,
)
from surctl.marine.guidance.sectors import choose_velocity

Array = NDArray[np.float64]
HULL, RADIUS, CRUISE = 0.2, 0.2, 0.2
HEAD_ON, RIGHT = 0.03, 0.15
OPEN = (-50.0, 50.0, -50.0, 50.0)
POOL = (0.0, 3.0, 0.0, 2.0)


@cache
def _functions() -> tuple[ca.Function, ca.Function]:
    """(position, wish, other, motion, walls) → costs; the same and (side, blocker) → the choice."""
    here, wish, other, motion, walls = (
        ca.SX.sym(name, size) for name, size in (("here", 2), ("desired", 2), ("other", 2), ("motion", 2), ("walls", 4))
    )
    side, blocker, tried = ca.SX.sym("side"), ca.SX.sym("blocker", 2), ca.SX.sym("tried", 2)
    hull = ca.SX(HULL)
    contact = disc_contact(here, hull, other, ca.SX(RADIUS), motion, ca.SX(1))
    cone = collision_cone(
        contact, apart=ca.SX(0.15), standoff=ca.SX(0.05), horizon=ca.SX(12), there=ca.SX(1), point=other
    )
    around = wall_contacts(here, hull, walls)
    sectors = [Sector(wall.normal, wall.clearance - 0.05, here) for wall in around]
    chosen = choose_velocity(
        wish,
        sectors,
        side=side,
        blocker=blocker,
        cruise=ca.SX(CRUISE),
        cap=ca.SX(0.22),
        same=1e3,
        cones=[cone],
        walls=around,
    )
    given_ = [here, wish, other, motion, walls]
    costs = [*side_costs(cone, wish, around), passes_left(tried, cone), inside(tried, cone)]
    return (
        ca.Function("costs", [*given_, tried], costs),
        ca.Function("choice", [*given_, side, blocker], [chosen.velocity, chosen.side]),
    )


def _costs(here, wish, other, motion, walls=OPEN, tried=(0.0, 0.0)) -> list[float]:
    return [float(v) for v in _functions()[0](here, wish, other, motion, walls, tried)]


def _side(here, wish, other, motion, walls=OPEN, side=0.0) -> int:
    return int(_functions()[1](here, wish, other, motion, walls, side, other)[1])


def _unit(angle: float) -> Array:
    return np.array([np.cos(angle), np.sin(angle)])


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.floats(-3.1, 3.1), st.floats(0.05, 0.3), st.floats(-2, 2), st.floats(1.2, 4.0))
def test_only_what_comes_head_on_costs_and_then_on_the_right(
    bearing: float, speed: float, share: float, away: float
) -> None:
    """Head-on is a relative velocity that misses the bearing by less than 0.03 m/s across."""
    n, across = _unit(bearing), _unit(bearing + np.pi / 2)
    crossing = share * HEAD_ON
    if abs(abs(crossing) - HEAD_ON) < 1e-6:
        return
    left, right, *_ = _costs([1, 1], CRUISE * n, [1, 1] + away * n, -speed * n + crossing * across)
    assert left == 0.0
    assert right == pytest.approx(RIGHT if abs(crossing) < HEAD_ON else 0.0)


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.floats(-3.1, 3.1), st.floats(-3.1, 3.1), st.floats(0.0, 0.2), st.floats(0.9, 3.0), st.floats(-0.2, 0.2))
def test_left_is_where_it_ends_up_on_the_right(
    bearing: float, course: float, speed: float, away: float, crossing: float
) -> None:
    """At the nearest, the contact lies to the right of the way relative to it, and to the left otherwise."""
    n = _unit(bearing)
    motion = -0.1 * n + crossing * _unit(bearing + np.pi / 2)
    velocity = speed * _unit(course)
    relative = velocity - motion
    if relative @ n < 0.01:  # it never comes nearer
        return
    turn = n[0] * relative[1] - n[1] * relative[0]
    if abs(turn) < 1e-6:
        return
    when = away * (n @ relative) / (relative @ relative)
    offset = away * n - when * relative
    *_, left, _ = _costs([0, 0], 0.2 * n, away * n, motion, tried=velocity)
    assert bool(left) == (relative[0] * offset[1] - relative[1] * offset[0] < 0)


def test_a_way_along_a_wall_costs_more_the_nearer_it_is() -> None:
    """From 0.3 m off the wall on: half the way to the passing point; the other side has room."""
    rights, lefts = [], []
    for y in np.arange(0.25, 1.01, 0.05):
        left, right, *_ = _costs([0.25, y], [CRUISE, 0], [2.75, y], [-0.2, 0], POOL)
        rights.append(right)
        lefts.append(left)
    assert rights[0] > RIGHT + 0.5 and rights[-1] == pytest.approx(RIGHT)
    assert np.all(np.diff(rights) <= 0) and lefts[0] == 0.0
    # mirrored, but for E10
    mirrored = [_costs([0.25, 2 - y], [CRUISE, 0], [2.75, 2 - y], [-0.2, 0], POOL)[0] for y in (0.25, 0.5)]
    np.testing.assert_allclose(mirrored, np.array([rights[0], rights[5]]) - RIGHT, atol=1e-9)


@pytest.mark.parametrize(("y", "to", "side"), [(0.25, 1.75, 1), (1.75, 0.25, -1), (1.0, 1.0, 1)])
def test_noise_in_what_is_told_does_not_choose_the_side(y: float, to: float, side: int) -> None:
    """The pool's corners and its middle; 3 cm and 0.03 m/s are three standard deviations of the base station."""
    rng, chosen = np.random.default_rng(1), []
    start, end = np.array([0.26, y]), np.array([2.75, to])
    ahead = (end - start) / np.linalg.norm(end - start)
    for _ in range(300):
        noise, drift = np.clip(rng.normal(0, 0.01, (2, 2)), -0.025, 0.025)
        if abs(ahead[0] * drift[1] - ahead[1] * drift[0]) < 0.029:
            chosen.append(_side(start, CRUISE * ahead, end + noise, -CRUISE * ahead + drift, POOL))
    assert len(chosen) > 280
    assert np.mean(np.array(chosen) == side) > 0.98


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_side_once_taken_is_kept(side: float) -> None:
    assert _side([0.26, 0.5], [CRUISE, 0], [2.75, 0.5], [-0.2, 0], POOL, side) == side


def test_what_crosses_is_passed_on_the_nearer_side() -> None:
    """Though it is the right, and though that way lies along the wall."""
    assert _side([0.3, 0.4], [CRUISE, 0], [2.0, 0.4], [-0.1, 0.04], POOL) == -1
    assert _side([0.3, 1.6], [CRUISE, 0], [2.0, 1.6], [-0.1, -0.04], POOL) == 1


@cache
def _moving() -> ca.Function:
    """(wish, other, motion, now, acceleration) from (0, 0), no walls near → swap costs, velocity."""
    wish, other, motion, now = (ca.SX.sym(name, 2) for name in ("desired", "other", "motion", "now"))
    acceleration = ca.SX.sym("acceleration")
    contact = disc_contact(ca.SX.zeros(2), ca.SX(HULL), other, ca.SX(RADIUS), motion, ca.SX(1))
    cone = collision_cone(
        contact, apart=ca.SX(0.15), standoff=ca.SX(0.05), horizon=ca.SX(12), there=ca.SX(1), point=other
    )
    chosen = choose_velocity(
        wish,
        [Sector(ca.SX([1, 0]), ca.SX(10.0), ca.SX([9, 0]))],
        side=ca.SX(0),
        blocker=ca.SX.zeros(2),
        cruise=ca.SX(CRUISE),
        cap=ca.SX(0.22),
        cones=[cone],
        now=now,
        acceleration=acceleration,
    )
    costs = swap_costs(cone, now, ca.SX(CRUISE), acceleration)
    return ca.Function("moving", [wish, other, motion, now, acceleration], [*costs, chosen.velocity])


@settings(derandomize=True, deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(-0.1, 0.1), st.floats(0.8, 1.5))
def test_at_rest_what_crosses_is_passed_behind(bearing: float, crossing: float, away: float) -> None:
    """To its left if it goes right: that costs nothing, the way before it does; and nothing if it comes head-on."""
    n, left = _unit(bearing), _unit(bearing + np.pi / 2)
    found = _moving()([0.2, 0], away * n, -0.1 * n + crossing * left, [0, 0], 100.0)
    on_left, on_right = (float(cost) for cost in found[:2])
    turn = abs(crossing) if abs(crossing) > HEAD_ON else 0.0
    assert (on_left if crossing > 0 else on_right) == pytest.approx(2.0 * turn / CRUISE, abs=1e-9)
    assert (on_right if crossing > 0 else on_left) == 0.0


def test_a_side_that_the_thrust_does_not_reach_in_time_counts_as_missed() -> None:
    """0.1 m/s to the left, 0.4 m of room at 0.2 m/s: 2 s, of which 1 s counts."""
    place, motion, now = [0.85, 0], [-0.1, 0], [0.1, 0.1]
    slow, quick = (float(_moving()([0.2, 0], place, motion, now, a)[1]) for a in (0.02, 0.2))
    assert quick == pytest.approx(2.0 * 0.1 / CRUISE)
    assert slow == pytest.approx(quick + 10 + 100 * (0.1 - 0.02))


def test_what_has_been_begun_is_carried_on() -> None:
    """The same wish and the same contact: it is passed on the side to which the robot already goes."""
    for sign in (1.0, -1.0):
        velocity = np.asarray(_moving()([0.2, 0], [1.2, 0], [-0.1, 0], [0.1, 0.12 * sign], 0.05)[2]).ravel()
        assert velocity[1] * sign > 0.05


def test_what_crosses_soon_is_waited_for_where_every_way_round_leads_back() -> None:
    """It goes from left to right, near and broad before the robot, which stands clear of its way."""
    velocity = np.asarray(_moving()([0.2, 0], [0.6, 0.1], [0.0, -0.1], [0, 0], 0.05)[2]).ravel()
    assert velocity[0] < 0.2 * 0.95
