"""The window of a long path: numbers against CasADi expressions, and what a law sees through it."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from surctl.marine.guidance import AHEAD, MAX_WAYPOINTS, Path
from surctl.marine.guidance.following import window_next, window_values
from surctl.marine.guidance.path import leg_end, next_leg, path_target
from tests.oracles.mission_window import Window, last_first

RNG = np.random.default_rng(4)
POINTS = np.cumsum(RNG.uniform([-1.1, -1.5], [1.9, 1.5], (30, 2)), axis=0)
POINTS[17] = POINTS[0]  # the path crosses its start
KINDS = RNG.choice([1.0, 0.0, -1.0], 30)
LONG = Path(POINTS, RNG.uniform(-1, 1, 30), RNG.choice([0.0, 0.3, 0.5], 30), KINDS)
OF_MISSION = {"depth": -2.0, "cruise": 0.2, "visit": 0.05}


def test_a_short_path_fits_and_never_moves() -> None:
    for n in (2, 5, MAX_WAYPOINTS):
        path = Path(POINTS[:n])
        window = Window(path.table(), **OF_MISSION)
        assert np.array_equal(window.waypoints(), path.slots) and not path.fed
        assert window.move(1e9) == 0.0 and window.first == 1 == last_first(n)
        assert window.values(path.length) == (-2.0, 0.2, 0.0)
    assert Path(POINTS[:9]).fed and Path(POINTS[:3], speeds=[0, 0, 0.1]).fed


def test_through_the_window_a_law_sees_the_whole_path() -> None:
    """Target point, direction, end of the segment and next segment are those of the whole path, at each arc length."""
    n = len(POINTS)
    s, here = ca.SX.sym("s"), ca.SX.sym("here", 2)

    def seen(rows: int) -> ca.Function:
        w = ca.SX.sym("w", rows, 2)
        point, tangent, _ = path_target(w, s)
        onward = next_leg(w, s, here, near=ca.SX(0.8)) - s
        return ca.Function("seen", [w, s, here], [ca.vertcat(point, tangent, leg_end(w, s) - s, onward)])

    whole, part = seen(n), seen(MAX_WAYPOINTS)
    points = ca.SX.sym("w", n, 2)
    point_at = ca.Function("at", [points, s], [path_target(points, s)[0]])
    window = Window(LONG.table(), **OF_MISSION)
    corners = np.concatenate([[0.0], np.cumsum(LONG.lengths)])
    progress = -0.08
    for arc in np.arange(0.0, LONG.length, 0.08):
        progress += 0.08
        progress += window.move(progress)
        place = point_at(POINTS, arc).full().ravel() + RNG.normal(0, 0.3, 2)
        found, wanted = part(window.waypoints(), progress, place), whole(POINTS, arc, place)
        assert np.allclose(found.full(), wanted.full(), atol=1e-12), arc
        leg = max(int(np.searchsorted(corners + 1e-4, arc)) - 1, 0)
        share = (arc - corners[leg]) / LONG.lengths[leg]
        low, high = LONG.rises[leg : leg + 2]
        z, speed, visit = window.values(progress)
        assert z == pytest.approx(-2.0 + low + (high - low) * share, abs=1e-10)
        assert speed == (LONG.speeds[leg + 1] or 0.2) and visit == 0.05 * (KINDS[leg + 1] > 0)
    assert window.first == last_first(n)


def test_numbers_and_expressions_agree() -> None:
    table, n = LONG.table(), len(POINTS)
    first, progress = ca.SX.sym("f"), ca.SX.sym("s")
    rows, start, all_rows = ca.SX.sym("r", 3, 5), ca.SX.sym("a", 2), ca.SX.sym("w", MAX_WAYPOINTS, 5)
    moves = ca.Function(
        "m", [first, progress, rows, start], [*window_next(first, progress, rows, start, ca.SX(last_first(n)))]
    )
    symbols = {name: ca.SX(value) for name, value in OF_MISSION.items()}
    values = ca.Function("v", [all_rows, progress], [*window_values(all_rows, progress, **symbols)])
    window, at = Window(table, **OF_MISSION), 0.0
    for step in RNG.uniform(0.0, 0.2, 800):
        at += step
        before = window.first
        padded = table[np.minimum(np.arange(before, before + 3), n - 1)]
        after, shift = moves(before, at, padded, POINTS[0])
        expected = window.move(at)
        assert (float(after), float(shift)) == (window.first, expected)
        at += expected
        listed = [0, *np.minimum(window.first + np.arange(AHEAD), n - 1), n - 1]
        assert [float(v) for v in values(table[listed], at)] == list(window.values(at))
    assert window.first == last_first(n)
