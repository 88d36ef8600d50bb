"""Which leg a robot is on, in numbers and symbols: paths that close, cross or fold, detours, corners to visit."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from surctl.ir import Layout, on_vectors
from surctl.marine.guidance import FOLLOWING, MAX_WAYPOINTS, SKIPS, Follower, Path, follow
from surctl.marine.guidance.following import follow_on
from tests.oracles.path_follower import PlainFollower

FOLD = Path(np.array([[1.0, 2.5], [6.0, 2.5], [1.0, 2.5]]))
SQUARE = Path(np.array([[2.0, 1.5], [8.0, 1.5], [8.0, 3.5], [2.0, 3.5], [2.0, 1.5]]))


def along(*points: tuple[float, float], step: float = 0.01) -> np.ndarray:
    """Places on a polyline, `step` apart."""
    parts = []
    for a, b in zip(np.array(points[:-1]), np.array(points[1:]), strict=True):
        n = max(int(np.ceil(np.linalg.norm(b - a) / step)), 1)
        parts.append(a + np.linspace(0, 1, n, endpoint=False)[:, None] * (b - a))
    return np.vstack([*parts, [points[-1]]])


def legs(path: Path, places: np.ndarray, **options: float) -> list[int]:
    follower, found = Follower(path, **options), []
    for x, y in places.tolist():
        follower.move(x, y)
        found.append(follower.leg)
    return found


@pytest.mark.parametrize("path", [FOLD, SQUARE, Path(np.array([[2, 1], [8, 4], [8, 1], [2, 4], [2, 1]], float))])
def test_whoever_keeps_to_the_path_is_on_each_leg_in_turn(path: Path) -> None:
    places = along(*map(tuple, path.waypoints.tolist()))
    follower = Follower(path)
    assert follower.track(places) == pytest.approx(0.0, abs=1e-12) and follower.last
    assert follower.missed < 1e-12
    found = np.array(legs(path, places))
    assert (np.diff(found) >= 0).all() and set(found.tolist()) == set(range(len(path.waypoints) - 1))
    ends = np.cumsum(np.linalg.norm(np.diff(path.waypoints, axis=0), axis=1))[:-1]
    where = [np.flatnonzero(found > k)[0] * 0.01 for k in range(len(ends))]
    assert where == pytest.approx(ends, abs=0.06)


def test_at_its_start_a_closed_path_has_not_been_followed() -> None:
    assert set(legs(SQUARE, along((2.0, 1.5), (2.1, 1.7), (1.9, 2.2), (2.0, 1.5)))) == {0}
    assert set(legs(FOLD, along((1.0, 2.5), (1.3, 2.6), (1.0, 2.4)))) == {0}


def test_a_detour_beside_the_leg_back_does_not_leave_out_the_turn() -> None:
    back = Path(np.array([[1.0, 2.5], [6.0, 2.5], [3.0, 2.9]]))
    detour = along((1.0, 2.5), (2.5, 2.5), (3.0, 2.9), (3.5, 2.5), (6.0, 2.5))
    assert set(legs(back, detour)[:-1]) == {0}
    assert legs(back, np.vstack([detour, along((6.0, 2.5), (3.0, 2.9))]))[-1] == 1


def test_a_corner_may_be_cut_and_the_distance_is_told() -> None:
    corner = Path(np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0]]))
    cut = Follower(corner)
    cut.track(along((0.0, 0.0), (3.0, 0.0), (4.0, 1.0), (4.0, 4.0)))
    assert cut.last and cut.missed == pytest.approx(np.sqrt(0.5), abs=1e-4)
    visits = Follower(corner, visit=0.1)
    visits.track(along((0.0, 0.0), (3.0, 0.0), (4.0, 1.0), (4.0, 4.0)))
    assert not visits.last and visits.missed == 0.0
    visits.track(along((4.0, 4.0), (3.95, 0.03), (4.0, 4.0)))
    assert visits.last and visits.missed == pytest.approx(np.hypot(0.05, 0.03), abs=1e-3)


def test_turning_well_before_the_corner_counts_only_once_the_way_back_is_as_long() -> None:
    early = legs(FOLD, along((1.0, 2.5), (5.0, 2.5), (1.0, 2.5)))
    assert early[400 + 95] == 0 and early[400 + 110] == 1
    short = Path(np.array([[1.0, 2.5], [6.0, 2.5], [4.6, 2.5]]))
    assert set(legs(short, along((1.0, 2.5), (5.0, 2.5), (4.6, 2.5)))) == {0}


@pytest.mark.parametrize("visit", [None, 0.15])
def test_numbers_and_symbols_agree(visit: float | None) -> None:
    state = Layout(FOLLOWING)
    old, parts = state.symbols("s")
    points, count, place = ca.SX.sym("w", MAX_WAYPOINTS, 2), ca.SX.sym("n"), ca.SX.sym("x", 2)
    after = follow(parts, points, count, place, visit=ca.SX(visit or 0.0))
    step = on_vectors(ca.Function("follow", [old, points, count, place], [state.join(after)]))
    rng, moved = np.random.default_rng(5), 0
    for _ in range(40):
        nodes = rng.integers(0, 4, (rng.integers(2, MAX_WAYPOINTS + 1), 2)).astype(float)
        nodes[1:][np.linalg.norm(np.diff(nodes, axis=0), axis=1) == 0] += 0.5
        if np.any(np.linalg.norm(np.diff(nodes, axis=0), axis=1) == 0):
            continue
        path = Path(nodes)
        follower, now = PlainFollower(path, visit=visit), state.pack()
        places = along(*map(tuple, nodes.tolist()), step=0.1)
        for x, y in (places + np.cumsum(rng.normal(0, 0.02, places.shape), axis=0)).tolist():
            follower.move(x, y)
            (now,) = step(now, path.slots, len(nodes) - 1, [x, y])
            got = state.unpack(now)
            assert got["leg"][0] == follower.leg
            assert got["along"][0] == pytest.approx(follower.along, abs=1e-12)
            assert np.sqrt(max(got["missed"][0], got["corner_behind"][0])) == pytest.approx(follower.missed, abs=1e-12)
        moved += follower.leg
    assert moved > 50


def test_numbers_and_symbols_agree_on_a_fed_path() -> None:
    state, visit = Layout(FOLLOWING), 0.15
    old, parts = state.symbols("s")
    rows, count, place = ca.SX.sym("r", SKIPS + 2, 5), ca.SX.sym("n"), ca.SX.sym("x", 2)
    after, advanced = follow_on(parts, rows, count, place, visit=ca.SX(visit))
    step = on_vectors(ca.Function("follow", [old, rows, count, place], [state.join(after), advanced]))
    rng, jumps, arrived = np.random.default_rng(6), 0, 0
    for _ in range(20):
        n = int(rng.integers(9, 30))
        nodes = np.cumsum(rng.uniform(-0.4, 0.6, (n, 2)), axis=0)
        path = Path(nodes, rng.uniform(-1, 0, n), kinds=rng.choice([1.0, 0.0, -1.0], n, p=[0.05, 0.6, 0.35]))
        follower, now, table = PlainFollower(path, visit=visit), state.pack(), path.table()
        places = along(*map(tuple, nodes.tolist()), step=0.05)
        for x, y in (places + np.cumsum(rng.normal(0, 0.02, places.shape), axis=0)).tolist():
            leg = follower.leg
            follower.move(x, y)
            piece = table[np.minimum(leg + np.arange(SKIPS + 2), n - 1)]
            now, moved = step(now, piece, n - 1, [x, y])
            got = state.unpack(now)
            assert (got["leg"][0], float(moved[0])) == (follower.leg, follower.leg - leg)
            assert got["along"][0] == pytest.approx(follower.along, abs=1e-12)
            assert np.sqrt(max(got["missed"][0], got["corner_behind"][0])) == pytest.approx(follower.missed, abs=1e-12)
            jumps += follower.leg - leg > 1
        arrived += follower.last
    assert jumps > 10 and arrived > 5


def test_a_dense_track_with_jitter_is_followed_to_its_end() -> None:
    """Points of a recorded track, 0.1 m apart and up to 0.15 m off: the robot smooths them, and still advances."""
    rng = np.random.default_rng(1)
    track = np.stack([0.1 * np.arange(300), np.zeros(300)], axis=1) + rng.uniform(-0.15, 0.15, (300, 2))
    places = along((0.0, 0.0), (30.0, 0.0))
    fed = Follower(Path(track))
    assert max(fed.track(places)) < 0.3 and fed.last and fed.missed < 0.4


def test_points_inside_an_arc_are_no_corners_and_corners_to_visit_are_not_left_out() -> None:
    points, kinds = np.array([[k, 0.3 * (k % 2)] for k in range(12)], float), np.array([0.0, *[-1.0] * 10, 0.0])
    assert Follower(Path(points)).missed == 0.0
    free = Follower(Path(points, kinds=kinds))
    free.track(along((0.0, -0.2), (11.0, -0.2)))
    assert free.last and free.missed == 0.0
    kinds[5] = 1.0
    bound = Follower(Path(points, kinds=kinds), visit=0.15)
    bound.track(along((0.0, -0.2), (11.0, -0.2)))
    assert bound.leg == 4
    bound.track(along((11.0, -0.2), (5.0, 0.3), (11.0, 0.2)))
    assert bound.last
