"""ENU/FLU and NED/FRD: each change is its own inverse, and the motion is the same motion."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from surctl.errors import InputError
from surctl.marine.vehicle import FRAME_TEXT, FRAMES
from surctl.marine.vehicle.motion_log import check_frame, swap_body, swap_pose

POSES = arrays(float, st.tuples(st.integers(0, 5), st.just(4)), elements=st.floats(-1e3, 1e3))
BODY = arrays(float, st.tuples(st.integers(0, 5), st.just(4)), elements=st.floats(-1e3, 1e3))


@given(POSES)
def test_a_pose_comes_back(eta: np.ndarray) -> None:
    back = swap_pose(swap_pose(eta))
    np.testing.assert_array_equal(back[:, :3], eta[:, :3])
    np.testing.assert_allclose(back[:, 3], eta[:, 3], rtol=4e-16, atol=4e-16)


@given(BODY)
def test_velocity_and_thrust_come_back(vector: np.ndarray) -> None:
    np.testing.assert_array_equal(swap_body(swap_body(vector)), vector)


def test_by_hand() -> None:
    # 2 m east, 3 m north, 1 m deep, heading north-east of east by 30 degrees: 60 degrees from north, clockwise
    np.testing.assert_allclose(swap_pose([2.0, 3.0, -1.0, np.pi / 6]), [3.0, 2.0, 1.0, np.pi / 3], rtol=1e-15)
    np.testing.assert_array_equal(swap_body([1.0, 2.0, 3.0, 4.0]), [1.0, -2.0, -3.0, -4.0])
    assert not np.signbit(swap_body(np.zeros(4))).any() and not np.signbit(swap_pose(np.zeros(4))[2])


@given(
    arrays(float, 4, elements=st.floats(-10, 10)),
    arrays(float, 4, elements=st.floats(-1, 1)),
    st.floats(-1, 1).filter(lambda s: abs(s) > 1e-3),
)
def test_a_body_that_moves_moves_alike_in_both(eta: np.ndarray, nu: np.ndarray, dt: float) -> None:
    """(1)–(2) have one form: the change of the rate is the rate of the change."""

    def rate(pose: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        u, v, w, r = velocity
        c, s = np.cos(pose[3]), np.sin(pose[3])
        return np.array([u * c - v * s, u * s + v * c, w, r])

    moved = swap_pose(eta + dt * rate(eta, nu))
    there = swap_pose(eta)
    np.testing.assert_allclose(moved, there + dt * rate(there, swap_body(nu)), atol=1e-12)


def test_nan_stays_with_its_quantity() -> None:
    pose = swap_pose([[1.0, np.nan, 2.0, 0.0]])
    np.testing.assert_array_equal(np.isnan(pose), [[True, False, False, False]])


def test_mistakes() -> None:
    with pytest.raises(InputError, match=r"shape \(3,\)"):
        swap_pose([1.0, 2.0, 3.0])
    with pytest.raises(InputError, match=r"frame.*'nde'.*ned"):
        check_frame("nde")
    assert set(FRAME_TEXT) == set(FRAMES)
