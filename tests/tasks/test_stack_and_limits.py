"""The ordered stack, and limits as rows."""

import math

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.tasks import HalfPlane, Stack, VelocityBox, depth_task, heading_task, velocity_task

ETA = ca.SX.sym("eta", 4)


def test_levels_come_in_order_of_priority():
    stack = Stack((depth_task(ETA, -0.15), velocity_task(ETA, [0.1, 0.0]), heading_task(ETA, 0.0)))
    assert stack.names == ("depth", "velocity", "heading")
    assert [J.shape for J, _ in stack.levels()] == [(1, 4), (2, 4), (1, 4)]
    assert [x.shape for _, x in stack.levels()] == [(1, 1), (2, 1), (1, 1)]


def test_two_tasks_with_one_name_are_refused():
    with pytest.raises(InputError, match=r"'depth': names both task 1 and task 3"):
        Stack((depth_task(ETA, 0.0), heading_task(ETA, 0.0), depth_task(ETA, 1.0)))


def test_tasks_over_different_symbols_are_refused():
    with pytest.raises(InputError, match="task heading"):
        Stack((depth_task(ETA, 0.0), heading_task(ca.SX.sym("eta", 4), 0.0)))


def test_an_empty_stack_is_refused():
    with pytest.raises(InputError, match="contains no task"):
        Stack(())


def test_a_box_is_four_named_actuator_rows():
    rows = VelocityBox([-1, -2, -3, -4], [1, 2, 3, math.inf]).rows()
    assert [r.name for r in rows] == ["velocity.u", "velocity.v", "velocity.w", "velocity.r"]
    assert {r.kind for r in rows} == {"actuator"}
    assert np.array_equal(np.vstack([np.array(ca.DM(r.a)) for r in rows]), np.eye(4))
    assert [float(r.upper) for r in rows] == [1, 2, 3, math.inf]
    assert [float(r.lower) for r in rows] == [-1, -2, -3, -4]


def test_a_half_plane_is_one_barrier_row_and_may_be_symbolic():
    bound = ca.SX.sym("bound")
    (row,) = HalfPlane("wall", [1, 0, 0, 0], bound).rows()
    assert row.kind == "barrier"
    assert row.a.shape == (1, 4)
    assert float(row.lower) == -math.inf
    assert ca.is_equal(row.upper, bound)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: VelocityBox([1, 0, 0, 0], [0, 1, 1, 1]), "velocity.u"),
        (lambda: VelocityBox([0, 0, 0], [1, 1, 1, 1]), "upper"),
        (lambda: VelocityBox([0, 0, 0, math.nan], [1, 1, 1, 1]), "lower"),
        (lambda: HalfPlane("wall", [], 1.0), "wall: normal"),
        (lambda: HalfPlane("wall", [1, 0, 0, 0], [1.0, 2.0]), "wall: bound"),
        (lambda: HalfPlane("wall", [1, 0, 0, 0], -math.inf), "wall"),
        (lambda: HalfPlane("wall", [1, 0, 0, 0], 1.0, kind="barier"), "did you mean 'barrier'"),
    ],
)
def test_bad_limits_are_refused_by_name(make, says):
    with pytest.raises(InputError) as caught:
        make()
    assert says in str(caught.value)
