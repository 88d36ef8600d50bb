"""Collision cones: which velocities meet what moves, and the choice beside them."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from surctl.marine.guidance import Contact, Sector, inside
from surctl.marine.guidance.contacts import collision_cone
from surctl.marine.guidance.sectors import choose_velocity

Array = NDArray[np.float64]
REACH, APART, STANDOFF, HORIZON = 0.54, 0.15, 0.05, 12.0


def _cone(offset: ca.SX, motion: ca.SX, there: ca.SX | float = 1.0) -> tuple[Contact, object]:
    distance = ca.sqrt(ca.sumsqr(offset))
    contact = Contact(offset / distance, distance - REACH, motion, ca.SX(REACH))
    cone = collision_cone(
        contact,
        apart=ca.SX(APART),
        standoff=ca.SX(STANDOFF),
        horizon=ca.SX(HORIZON),
        there=ca.SX(there),
        point=offset * (1 - 0.27 / distance),
    )
    return contact, cone


@cache
def _depth() -> ca.Function:
    offset, motion, velocity = (ca.SX.sym(n, 2) for n in ("offset", "motion", "velocity"))
    _, cone = _cone(offset, motion)
    _, absent = _cone(offset, motion, 0.0)
    return ca.Function("depth", [offset, motion, velocity], [inside(velocity, cone), inside(velocity, absent)])


@cache
def _choice() -> ca.Function:
    wish, offset, motion, side, blocker = (
        ca.SX.sym(n, k) for n, k in (("desired", 2), ("offset", 2), ("motion", 2), ("side", 1), ("blocker", 2))
    )
    _, cone = _cone(offset, motion)
    wall = Sector(ca.SX([0, 1]), ca.SX(10.0), ca.SX([0, 9]))
    c = choose_velocity(
        wish, [wall], side=side, blocker=blocker, cruise=ca.SX(0.2), cap=ca.SX(0.22), same=1e3, cones=[cone]
    )
    return ca.Function("choice", [wish, offset, motion, side, blocker], [c.velocity, c.side, c.blocked])


def _nearest_pass(offset: Array, relative: Array) -> tuple[float, float]:
    """Least distance of centres from now on, and when the stand-off would be used up at the present rate."""
    speed = float(relative @ relative)
    when = max(float(offset @ relative) / speed, 0.0) if speed > 0 else 0.0
    distance = float(np.linalg.norm(offset))
    towards = float(offset @ relative) / distance
    met = (distance - REACH - STANDOFF) / towards if towards > 0 else np.inf
    return float(np.linalg.norm(offset - when * relative)), met


_speed = st.floats(-0.3, 0.3)


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.floats(0.72, 5.0), st.floats(-3.1, 3.1), _speed, _speed, _speed, _speed)
def test_inside_is_what_passes_too_near_and_soon(
    distance: float, bearing: float, vx: float, vy: float, ox: float, oy: float
) -> None:
    offset = distance * np.array([np.cos(bearing), np.sin(bearing)])
    relative = np.array([vx - ox, vy - oy])
    least, met = _nearest_pass(offset, relative)
    assume(abs(least - REACH - APART) > 1e-6 and abs(met - HORIZON) > 1e-6 and np.linalg.norm(relative) > 1e-3)
    depth, absent = (float(d) for d in _depth()(offset, [ox, oy], [vx, vy]))
    assert (depth > 0) == (least < REACH + APART and met < HORIZON)
    assert absent == -10.0


def test_within_the_passing_distance_only_going_nearer_is_inside() -> None:
    offset = np.array([0.6, 0.0])  # 0.06 m off: nearer than it may be passed
    assert float(_depth()(offset, [0, 0], [0.01, 0.2])[0]) > 0
    assert float(_depth()(offset, [0, 0], [-0.01, 0.2])[0]) < 0


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.floats(1.0, 2.5), st.floats(-1.0, 1.0), st.sampled_from([-1.0, 0.0, 1.0]))
def test_the_velocity_chosen_passes_at_the_distance_asked_for(distance: float, bearing: float, side: float) -> None:
    """Head-on or nearly so, at the robot's own speed: an edge of the cone, on the latched side if there is one."""
    offset = distance * np.array([np.cos(bearing), np.sin(bearing)])
    motion = -0.1 * offset / distance
    velocity, chosen, blocked = (np.asarray(m).ravel() for m in _choice()([0.2, 0.0], offset, motion, side, [0, 0]))
    least, _ = _nearest_pass(offset, velocity - motion)
    if not blocked[0]:
        np.testing.assert_allclose(velocity, [0.2, 0.0], atol=1e-12)
        return
    np.testing.assert_allclose(np.hypot(*velocity), 0.2, atol=1e-9)
    assert least >= REACH + APART - 0.02  # as far as a course may miss a bound and still be free
    if side:
        assert chosen[0] == side


def test_a_sidestep_does_not_ask_for_retreat() -> None:
    """What a range barrier does not allow: going on, sideways, towards what comes head-on."""
    velocity, side, blocked = (np.asarray(m).ravel() for m in _choice()([0.2, 0], [2.0, 0], [-0.25, 0], 0, [0, 0]))
    assert blocked[0] and side[0] == 1.0  # head-on: it stays on the right
    assert velocity[0] > 0.1 and velocity[1] > 0.05
