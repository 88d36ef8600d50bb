"""The choice among many contacts: free courses, side, latch, retreat."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import casadi as ca
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from surctl.marine.guidance import Sector
from surctl.marine.guidance.avoidance import avoidance_course
from surctl.marine.guidance.sectors import choose_velocity

Array = NDArray[np.float64]
CRUISE, CAP = 0.2, 0.22
OVERTAKE, TOLERANCE = 0.05, 1e-3


class _Chosen(NamedTuple):
    velocity: Array
    side: int
    blocked: bool
    violation: float
    blocker: Array


@cache
def _choice(count: int, *, fan: bool, back: bool) -> ca.Function:
    wish, side, blocker = ca.SX.sym("desired", 2), ca.SX.sym("side"), ca.SX.sym("blocker", 2)
    normals, bounds, points = ca.SX.sym("n", 2, count), ca.SX.sym("b", count), ca.SX.sym("p", 2, count)
    sectors = [Sector(normals[:, k], bounds[k], points[:, k]) for k in range(count)]
    slower, keeps = ca.SX.sym("slower"), ca.SX.sym("keeps")
    known = {"side": side, "blocker": blocker, "cruise": ca.SX(CRUISE), "cap": ca.SX(CAP)}
    c = choose_velocity(wish, sectors, **known, slower=slower if fan else None, keeps=keeps if back else None)
    return ca.Function(
        "choice",
        [wish, normals, bounds, points, side, blocker, slower, keeps],
        [c.velocity, c.side, c.blocked, c.violation, c.blocker],
    )


def _choose(
    wish: ArrayLike,
    bearings: ArrayLike,
    bounds: ArrayLike,
    *,
    points: ArrayLike | None = None,
    side: float = 0.0,
    blocker: ArrayLike = (50.0, 50.0),
    slower: float | None = None,
    keeps: float | None = None,
) -> _Chosen:
    b = np.atleast_1d(np.asarray(bearings, dtype=float))
    normals = np.vstack([np.cos(b), np.sin(b)])
    where = normals if points is None else np.asarray(points, dtype=float).T
    numbers = (
        np.asarray(wish),
        normals,
        np.atleast_1d(bounds),
        where,
        side,
        np.asarray(blocker),
        slower or 0.0,
        keeps or 0.0,
    )
    found = _choice(b.size, fan=slower is not None, back=keeps is not None)(*numbers)
    velocity, chosen_side, blocked, violation, now = (np.asarray(m).reshape(-1) for m in found)
    return _Chosen(velocity, int(chosen_side[0]), bool(blocked[0]), float(violation[0]), now)


def _unit(angle: float) -> Array:
    return np.array([np.cos(angle), np.sin(angle)])


# --- one contact --------------------------------------------------------------------------------------------------


@settings(derandomize=True, deadline=None)
@given(st.floats(-3, 3), st.floats(-0.19, 0.19), st.sampled_from([-1, 1]), st.floats(0.01, 0.6))
def test_the_edge_of_one_sector_is_the_corrected_law(bearing: float, bound: float, side: int, off: float) -> None:
    """ψ = φ ± arccos(bound/u): the `corrected` form with the bound in place of v_o·n + κ(l − R_OB − d_s)."""
    wish = CRUISE * _unit(bearing + side * off)
    found = _choose(wish, bearing, bound)
    symbol = ca.SX.sym("c")
    law = avoidance_course(
        "corrected",
        ca.SX(bearing),
        ca.SX(0),
        radius=ca.SX(0.5),
        side=ca.SX(side),
        delta=ca.SX(0),
        k3=ca.SX(1),
        speed=symbol,
        closing=ca.SX(bound),
        kappa=ca.SX(0.3),
        standoff=ca.SX(0),
    )
    speed = max(CRUISE, min(-bound + OVERTAKE, CAP) if bound < 0 else 0.0)
    if CRUISE * np.cos(off) - bound <= 2 * TOLERANCE:
        return  # the wish itself is (almost) free
    course = float(ca.evalf(ca.substitute(law, symbol, speed)))
    assert found.blocked
    assert found.side == side
    np.testing.assert_allclose(found.velocity, speed * _unit(course), atol=1e-9)
    assert found.velocity @ _unit(bearing) == pytest.approx(bound, abs=1e-9)


@pytest.mark.parametrize("bearing", [0.0, 0.5, np.pi / 2, -2.0, 3.0])
def test_head_on_the_obstacle_stays_on_the_right(bearing: float) -> None:
    found = _choose(CRUISE * _unit(bearing), bearing, 0.05)
    assert found.side == 1
    assert _unit(bearing)[0] * found.velocity[1] - _unit(bearing)[1] * found.velocity[0] > 0.1


@settings(derandomize=True, deadline=None)
@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.0, 0.2))
def test_a_free_wish_is_left_alone(course: float, bearing: float, bound: float) -> None:
    wish = 0.21 * _unit(course)
    if wish @ _unit(bearing) > bound:
        return
    found = _choose(wish, bearing, bound)
    np.testing.assert_allclose(found.velocity, wish, atol=1e-12)
    assert (found.side, found.blocked, found.violation) == (0, False, 0.0)


def test_no_catching_up_while_the_wish_is_blocked() -> None:
    found = _choose([0.22, 0.0], 0.0, 0.05)
    assert np.linalg.norm(found.velocity) == pytest.approx(CRUISE, abs=1e-12)


# --- latch --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("lean", [-0.3, -0.05, 0.05, 0.3])
def test_the_side_is_kept_while_the_same_contact_blocks(side: int, lean: float) -> None:
    """The blocker has moved 0.2 m: the same encounter."""
    found = _choose(CRUISE * _unit(lean), 0.0, 0.05, points=[[1.0, 0.0]], side=side, blocker=[0.8, 0.0])
    assert found.side == side
    assert found.velocity[1] * side > 0.1


@pytest.mark.parametrize("side", [-1, 1])
def test_another_contact_is_another_encounter(side: int) -> None:
    found = _choose(CRUISE * _unit(0.3), 0.0, 0.05, points=[[1.0, 0.0]], side=side, blocker=[1.4, 0.0])
    assert found.side == 1


def test_the_latch_gives_way_only_when_nothing_on_its_side_is_free() -> None:
    """Latched to the left: first the wall on the left leaves the way back along it, then that is closed too."""
    bearings, bounds = [0.0, np.pi / 2], [0.02, 0.0]
    points = [[1.0, 0.0], [0.0, 1.0]]
    back = _choose([CRUISE, 0.0], bearings, bounds, points=points, side=1, blocker=[1, 0])
    assert (back.side, back.violation) == (1, 0)
    np.testing.assert_allclose(back.velocity, [-CRUISE, 0], atol=1e-9)
    right = _choose(
        [CRUISE, 0.0], [*bearings, np.pi], [*bounds, 0.0], points=[*points, [-1.0, 0.0]], side=1, blocker=[1, 0]
    )
    assert (right.side, right.violation) == (-1, 0)
    np.testing.assert_allclose(right.velocity, [0.02, -np.sqrt(CRUISE**2 - 0.02**2)], atol=1e-9)


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(("past", "keeps", "stays"), [(8, None, False), (8, 0, False), (8, 1, True), (20, 1, False)])
def test_the_side_is_kept_on_a_course_just_past_straight_back(
    side: int, past: float, keeps: float | None, stays: bool
) -> None:
    """A face beside the robot leans towards it: the way back along it lies `past` degrees beyond straight back."""
    beside = side * (np.pi / 2 + np.radians(past))
    places = [[1.0, 0.0], _unit(beside)]
    found = _choose([CRUISE, 0.0], [0.0, beside], [0.02, 0.0], points=places, side=side, blocker=[1, 0], keeps=keeps)
    course = beside + side * np.pi / 2 if stays else -side * np.arccos(0.02 / CRUISE)  # back, or past the contact ahead
    assert (found.side, found.violation) == (side if stays else -side, 0)
    np.testing.assert_allclose(found.velocity, CRUISE * _unit(course), atol=1e-9)


@pytest.mark.parametrize("side", [-1, 1])
def test_without_a_side_to_keep_a_course_just_past_straight_back_has_its_own(side: int) -> None:
    """Only the way back is free, 188 to 193 degrees off; the contact ahead is a new one."""
    beside = side * np.radians([98, -77])
    places = [[1.0, 0.0], _unit(beside[0]), _unit(beside[1])]
    found = _choose([CRUISE, 0.0], [0.0, *beside], [0.02, 0.0, 0.0], points=places, side=side, keeps=1)
    assert (found.side, found.violation) == (-side, 0)
    np.testing.assert_allclose(found.velocity, CRUISE * _unit(side * np.radians(193)), atol=1e-9)


def test_the_blocker_is_the_contact_that_blocks_the_wish_most() -> None:
    found = _choose([CRUISE, 0.0], [0.0, 0.2], [0.1, 0.05], points=[[1.0, 0.0], [2.0, 0.4]])
    np.testing.assert_allclose(found.blocker, [2.0, 0.4])


# --- many contacts ------------------------------------------------------------------------------------------------


def _random(seed: int, *, lowest: float) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    wish = rng.uniform(0.02, CAP) * _unit(rng.uniform(-np.pi, np.pi))
    return wish, rng.uniform(-np.pi, np.pi, 6), rng.uniform(lowest, 0.25, 6)


def _speed(wish: Array, normals: Array, bounds: Array) -> float:
    """The speed that the docstring of choose_velocity describes."""
    near = np.any(normals @ wish - bounds > TOLERANCE)
    wished = float(np.linalg.norm(wish))
    speed = min(wished, CRUISE) if near else wished
    retreat = max(0.0, min(CAP, float(-bounds.min())))
    return max(speed, min(retreat + OVERTAKE, CAP) if retreat > 0 else 0.0)


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.integers(0, 10**9), st.sampled_from([-1.0, 0.0, 1.0]), st.sampled_from([-0.1, 0.0]))
def test_all_bounds_hold_whenever_some_course_is_free(seed: int, side: float, lowest: float) -> None:
    """Freedom is judged on 720 courses, not on the candidates that the choice looks at."""
    wish, bearings, bounds = _random(seed, lowest=lowest)
    normals = np.column_stack([np.cos(bearings), np.sin(bearings)])
    # half of the draws are in the encounter of the last step
    found = _choose(wish, bearings, bounds, side=side, blocker=normals[seed % 6])
    fan = np.linspace(-np.pi, np.pi, 720)
    speed = _speed(wish, normals, bounds)
    free = np.any(np.all(speed * np.column_stack([np.cos(fan), np.sin(fan)]) @ normals.T <= bounds, axis=1))
    if free:
        assert np.all(normals @ found.velocity <= bounds + 2 * TOLERANCE)
        assert found.violation <= TOLERANCE


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.integers(0, 10**9), st.sampled_from([None, 1.0]))
def test_bounds_that_ask_for_no_retreat_hold_always(seed: int, slower: float | None) -> None:
    """Free or not: the speed is reduced as far as they ask."""
    wish, bearings, bounds = _random(seed, lowest=0.0)
    bounds[:3] *= 0.1
    found = _choose(wish, bearings, bounds, slower=slower)
    normals = np.column_stack([np.cos(bearings), np.sin(bearings)])
    assert np.all(normals @ found.velocity <= bounds + 2e-4)


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.integers(0, 10**9), st.sampled_from([-1.0, 0.0, 1.0]))
def test_the_speed_never_exceeds_the_cap(seed: int, side: float) -> None:
    wish, bearings, bounds = _random(seed, lowest=-0.5)
    found = _choose(wish, bearings, bounds, side=side, blocker=_unit(bearings[0]))
    assert np.isfinite(found.velocity).all()
    assert np.linalg.norm(found.velocity) <= CAP + 1e-12


# a gap ahead between two contacts: at the whole speed each blocks the courses in which the other is passed
_GAP = np.array([1.25, -1.25]), np.array([0.06, 0.06])


def test_through_a_gap_it_goes_slower_where_it_may() -> None:
    """12° off it, 0.06/cos(1.04) = 0.118 m/s are free; what is free at the whole speed leads back."""
    back, through = (_choose([CRUISE, 0.0], *_GAP, slower=may) for may in (0.0, 1.0))
    assert back.velocity[0] < -0.1
    normals = np.column_stack([np.cos(_GAP[0]), np.sin(_GAP[0])])
    assert np.all(normals @ through.velocity <= _GAP[1] + 1e-9)
    assert through.velocity[0] > 0.09


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.integers(0, 10**9), st.sampled_from([-1.0, 0.0, 1.0]))
@example(1219, -1.0)
@example(1303, 1.0)
def test_slower_courses_only_where_the_others_lead_back(seed: int, side: float) -> None:
    """And never into what the choice without them keeps off."""
    wish, bearings, bounds = _random(seed, lowest=0.0)
    asked = {"side": side, "blocker": _unit(bearings[seed % 6])}
    plain, may = (_choose(wish, bearings, bounds, **asked, slower=slower) for slower in (0.0, 1.0))
    assert may.violation <= max(plain.violation, TOLERANCE)
    toward = plain.velocity @ wish / (np.linalg.norm(plain.velocity) * np.linalg.norm(wish) + 1e-12)
    if plain.violation <= TOLERANCE and toward > -0.5:
        # but where the latched side has nothing free at the whole speed: leaving it costs more than going slower
        assert np.array_equal(plain.velocity, may.velocity) or (side and plain.side == -side)


def test_what_comes_from_ahead_asks_for_a_retreat() -> None:
    found = _choose([CRUISE, 0.0], 0.0, -0.1)
    assert found.velocity[0] == pytest.approx(-0.1, abs=1e-9)
    assert found.violation == 0


def test_boxed_in_it_says_so() -> None:
    found = _choose([CRUISE, 0.0], [0.0, 2.0, -2.0], [-0.1, -0.1, -0.1])
    assert found.blocked
    assert found.violation > 0.1
    assert np.linalg.norm(found.velocity) <= CAP


@settings(derandomize=True, deadline=None, max_examples=24)
@given(st.integers(0, 10**6))
def test_a_trembling_wish_does_not_change_the_side(seed: int) -> None:
    """One contact, ahead of a wish that trembles about it: whatever side is taken first is kept."""
    rng = np.random.default_rng(seed)
    bearing, bound = rng.uniform(-np.pi, np.pi), rng.uniform(0, 0.5 * CRUISE)
    side, blocker, taken = 0, np.array([50.0, 50.0]), []
    for turn in rng.normal(0, 0.1, 40):
        wish = CRUISE * np.array([np.cos(bearing + turn), np.sin(bearing + turn)])
        place = np.array([[np.cos(bearing), np.sin(bearing)]]) + rng.normal(0, 0.02, (1, 2))
        chosen = _choose(wish, [bearing], [bound], points=place, side=side, blocker=blocker)
        side, blocker = chosen.side, chosen.blocker
        taken.append(side)
    assert set(taken) in ({1}, {-1})
