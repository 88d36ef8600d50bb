"""The path as numbers and inside the law."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.guidance import MAX_WAYPOINTS, Path
from surctl.marine.guidance.path import next_leg, path_target

Array = NDArray[np.float64]
coordinates = st.integers(-60, 60).map(lambda k: k / 10)
polylines = st.lists(st.tuples(coordinates, coordinates), min_size=2, max_size=MAX_WAYPOINTS)


def _path(points: list[tuple[float, float]]) -> Path:
    array = np.array(points)
    assume(np.all(np.linalg.norm(np.diff(array, axis=0), axis=1) > 1e-3))
    return Path(array)


@cache
def _target() -> ca.Function:
    w, s = ca.SX.sym("w", MAX_WAYPOINTS, 2), ca.SX.sym("s")
    return ca.Function("target", [w, s], list(path_target(w, s)))


def _by_interpolation(path: Path, s: float | Array) -> Array:
    lengths = np.linalg.norm(np.diff(path.waypoints, axis=0), axis=1)
    marks = np.concatenate([[0], np.cumsum(lengths)])
    return np.array([np.interp(s, marks, path.waypoints[:, i]) for i in range(2)])


@settings(derandomize=True, deadline=None)
@given(polylines, st.floats(-0.5, 1.5))
def test_the_law_finds_the_same_point_and_length_as_the_numbers(
    points: list[tuple[float, float]], share: float
) -> None:
    path = _path(points)
    s = share * path.length
    point, tangent, length = (np.asarray(m).reshape(-1) for m in _target()(path.slots, s))
    np.testing.assert_allclose(point, _by_interpolation(path, s), atol=1e-9)
    assert length[0] == pytest.approx(path.length, abs=1e-9)
    assert np.linalg.norm(tangent) == pytest.approx(1, abs=1e-12)


@settings(derandomize=True, deadline=None)
@given(polylines, st.floats(0.001, 0.999))
def test_the_tangent_is_the_derivative_of_the_point(points: list[tuple[float, float]], share: float) -> None:
    path = _path(points)
    lengths = np.linalg.norm(np.diff(path.waypoints, axis=0), axis=1)
    k = int(share * len(lengths))
    middle = float(lengths[:k].sum() + 0.5 * lengths[k])
    tangent = np.asarray(_target()(path.slots, middle)[1]).reshape(-1)
    np.testing.assert_allclose(tangent, (path.waypoints[k + 1] - path.waypoints[k]) / lengths[k], atol=1e-9)


def test_before_the_start_and_past_the_end_the_target_stands_still() -> None:
    path = Path(np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]]))
    for s, point, tangent in ((-1.0, [0, 0], [1, 0]), (5.0, [2, 1], [0, 1])):
        found = _target()(path.slots, s)
        np.testing.assert_allclose(np.asarray(found[0]).reshape(-1), point)
        np.testing.assert_allclose(np.asarray(found[1]).reshape(-1), tangent)


def test_slots_repeat_the_last_point() -> None:
    path = Path(np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]]))
    assert path.slots.shape == (MAX_WAYPOINTS, 2)
    np.testing.assert_array_equal(path.slots[3:], np.tile([2.0, 1.0], (MAX_WAYPOINTS - 3, 1)))


def test_waypoints_cannot_be_changed() -> None:
    given_points = np.array([[0.0, 0.0], [2.0, 0.0]])
    path = Path(given_points)
    given_points[0] = 9
    assert path.waypoints[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        path.waypoints[0, 0] = 1


@pytest.mark.parametrize(
    ("points", "problem"),
    [
        ([[0.0, 0.0]], "at least 2 points"),
        ([], "at least 2 points"),
        ([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], "at least 2 points"),
        ([[0.0, 0.0], [np.nan, 0.0]], "not finite"),
        ([[0.0, 0.0], [np.inf, 0.0]], "not finite"),
        ([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0]], "two equal points in a row, number 1 and 2"),
    ],
    ids=["one", "none", "3-D", "nan", "inf", "equal"],
)
def test_what_is_no_path(points: list[list[float]], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        Path(np.array(points))


@cache
def _next_leg() -> ca.Function:
    w, s, here = ca.SX.sym("w", MAX_WAYPOINTS, 2), ca.SX.sym("s"), ca.SX.sym("here", 2)
    near = ca.SX.sym("near")
    return ca.Function("leg", [w, s, here, near], [next_leg(w, s, here, near=near)])


def _distance(path: Path, k: int, here: Array, *, backwards: float = 0.0) -> float:
    """To leg k, prolonged before its start by so much [m]."""
    start, end = path.waypoints[k : k + 2]
    start = start - backwards * (end - start) / np.linalg.norm(end - start)
    along = np.clip((here - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
    return float(np.linalg.norm(here - start - along * (end - start)))


@settings(derandomize=True, deadline=None)
@given(polylines, st.floats(0.0, 0.999), st.tuples(coordinates, coordinates), st.floats(0.1, 5.0))
def test_what_is_left_out_of_a_leg_ends_abreast_of_a_robot_nearer_to_the_next(
    points: list[tuple[float, float]], share: float, place: tuple[float, float], near: float
) -> None:
    path, here = _path(points), np.array(place)
    s = share * path.length
    marks = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path.waypoints, axis=0), axis=1))])
    k = int(np.searchsorted(marks, s, side="right")) - 1
    assume(np.min(np.abs(marks[1:] - s)) > 1e-6)
    answer = float(_next_leg()(path.slots, s, here, near))
    wanted = s
    if k + 2 < len(path.waypoints) and s > marks[k + 1] - near:
        now, after = _distance(path, k, here, backwards=100.0), max(_distance(path, k + 1, here), 0.1)
        assume(abs(now - after) > 1e-9)
        if after < now:
            chord = path.waypoints[k + 2] - path.waypoints[k + 1]
            length = float(np.linalg.norm(chord))
            wanted = marks[k + 1] + float(np.clip((here - path.waypoints[k + 1]) @ chord / length, 0, length))
    assert answer == pytest.approx(wanted, abs=1e-9)


@settings(derandomize=True, deadline=None)
@given(polylines, st.floats(0.0, 0.999), st.floats(0.1, 5.0), st.floats(-0.07, 0.07))
def test_nothing_is_left_out_by_a_robot_on_its_leg(
    points: list[tuple[float, float]], share: float, near: float, off: float
) -> None:
    """Not even where the path leads back along it, and the position is noisy."""
    path = _path(points)
    s = share * path.length
    here = _by_interpolation(path, s) + off
    assert float(_next_leg()(path.slots, s, here, near)) == s
