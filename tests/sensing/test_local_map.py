"""The map: its twin, its window, what fades when, and what it says of a world that stands still."""

from __future__ import annotations

import itertools
import math
from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.ir import Call, Layout, Routine, compile_block, lower, replay
from surctl.ir.batch import compile_batch
from surctl.marine.sensing import LocalMap
from surctl.marine.sensing.mapping.firing import BLIND, READING, RING
from surctl.marine.world import Disc
from tests.oracles.local_map import map_step
from tests.raycasting import heard_along
from tests.sensing.mapped import EDGE, EMPTY, HULL, OPEN, SPIN, directions, firing, journey
from tests.sensing.plain_map import plain_map
from tests.tools import need_compiler

DT, FAR = 0.05, 1e6
CHARTS = {
    "the law's": {},
    "small": {"slots": 3, "blocks": 4, "block": 3, "sectors": 8, "mark_time": 2.0, "free_time": 1.0, "known": 0.6},
    "blocks of one cell": {"slots": 1, "blocks": 11, "block": 1, "sectors": 4},
    "short memory": {"blocks": 6, "mark_time": 8.0},
    "one block": {"blocks": 1, "block": 7, "sectors": 12, "free_time": 0.12},
}
SITE = (0.1, 2.9, -2.75, 30.0)
WIDE = (75.0,)  # other beams: study 40


def random_readings(rng, chart, place, heading):
    """Firings of every kind: none, blind, without an echo, explained, short or long of what was there."""
    told, kinds = [], []
    for slot in range(chart.slots):
        kind = rng.choice(["empty", "blind", "silent", "echo"])
        half, axis = math.radians(rng.choice([15, 75, 120])) / 2, heading + math.pi * slot
        apex = place + HULL * np.array([math.cos(axis), math.sin(axis)])
        distance = {"blind": 0.1, "silent": 9.0}.get(kind, rng.uniform(0.2, 4.3))
        told += EMPTY if kind == "empty" else firing(apex, axis, distance, half=half)
        kinds.append(kind)
    return told, kinds


def flight(chart, steps, seed, walls):
    """Inputs of each step, and the twin's outputs, of a robot that wanders, turns, and jumps once."""
    rng = np.random.default_rng(seed)
    place, heading = np.array([1.0, -2.0]), 0.0
    cells, corner = np.zeros(chart.side**2), np.full(2, 1e6)
    given, made = [], []
    for k in range(steps):
        place, heading = place + rng.normal(0, 0.03, 2) + 20.0 * (k == steps // 2), heading + 0.3
        told, _ = random_readings(rng, chart, place, heading)
        given.append((cells, corner, np.array([*place, HULL, EDGE]), np.array(walls), np.array(told, dtype=float)))
        made.append(map_step(chart, *given[-1]))
        cells, corner = made[-1][:2]
    return given, made


def same(chart, found, expected):
    """Equal to 1e-12; of two cells at one distance either may be told."""
    for a, b in zip(found[:2], expected[:2], strict=True):
        assert np.abs(a - b).max() <= 1e-12
    for a, b in zip(found[2:], expected[2:], strict=True):
        left, right = np.reshape(a, (chart.sectors, 3)), np.reshape(b, (chart.sectors, 3))
        assert np.abs(left[:, 2] - right[:, 2]).max() <= 1e-12
        differ = np.abs(left - right).max(axis=1) > 1e-12
        assert np.abs(np.sum(left[differ, :2] ** 2, axis=1) - right[differ, 2]).max(initial=0.0) <= 1e-12


@pytest.mark.parametrize(
    ("name", "walls"),
    [
        ("small", OPEN),
        ("short memory", OPEN),
    ],  # the law's: `test_maps_side_by_side_have_the_same_bits`; others: study 40
)
def test_the_routine_and_the_numbers_agree(name, walls):
    need_compiler()
    chart = LocalMap(dt=DT, **CHARTS[name])
    given, made = flight(chart, 50, seed=3, walls=walls)
    stacked = [np.array(column) for column in zip(*given, strict=True)]
    for found, expected in zip(zip(*compile_block(chart.routine())(*stacked), strict=True), made, strict=True):
        same(chart, found, expected)
    few = slice(None, None, 12)
    for found, expected in zip(
        zip(*replay(chart.routine(), *(column[few] for column in stacked)), strict=True), made[few], strict=True
    ):
        same(chart, found, expected)
    cells, nearest = np.array([m[0] for m in made]), np.array([m[2:] for m in made])[:, :, 2::3]
    # several directions; between near walls no cell has them, and the smallest map holds what is blind alone
    assert cells.max() > 3 + 2 * 32 or walls != OPEN or chart.side < 13
    cells -= 2 * np.floor(np.maximum(cells, 0) / 2)
    assert cells.min() == -1.0 and cells.max() in (BLIND, 1.0)
    assert np.any((cells > 0) & (cells < 1)) and np.any((cells < 0) & (cells > -1))
    if chart.side > 7 and walls == OPEN:  # otherwise the hull is all of it
        assert all(np.any(nearest[:, k] < FAR) and np.any(nearest[:, k] == FAR) for k in range(2))


def test_of_two_cells_at_one_distance_one_is_told():
    chart = LocalMap(dt=DT, slots=1)
    given = np.zeros(chart.side**2), np.zeros(2), np.array([0.0, 0.0, HULL, EDGE]), np.array(OPEN), np.array(EMPTY)
    found, expected = replay(chart.routine(), *given), map_step(chart, *given)
    assert np.unique(expected[3].reshape(-1, 3)[:, 2]).size < chart.sectors
    same(chart, found, expected)


def test_arrays_of_another_size_are_refused():
    chart = LocalMap(dt=DT, slots=1)
    good = [np.zeros(chart.side**2), np.zeros(2), np.ones(4), np.ones(4), np.zeros(10)]
    for k, name in enumerate(("cells", "corner", "place", "walls", "readings")):
        bad = [part[:-1] if j == k else part for j, part in enumerate(good)]
        with pytest.raises(InputError, match=name):
            map_step(chart, *bad)


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("dt", {"dt": 0.0}),
        ("mark_time", {"mark_time": math.nan}),
        ("free_time", {"free_time": -1.0}),
        ("slots", {"slots": 0}),
        ("blocks", {"blocks": 1.5}),
        ("block", {"block": 0}),
        ("sectors", {"sectors": 6}),
        ("sectors", {"sectors": 0}),
        ("known", {"known": 1.0}),
    ],
)
def test_mistakes_are_named(key, values):
    with pytest.raises(InputError, match=rf"map\.{key}"):
        LocalMap(**{"dt": DT, **values})


# --- the window -----------------------------------------------------------------------------------------------------


class Chart:
    """The map with its state."""

    def __init__(self, walls=OPEN, **values):
        self.chart, self.walls = LocalMap(dt=DT, slots=1, **values), walls
        state = Layout(self.chart.ports("map_"))
        self.cells, self.corner = state.unpack(state.pack()).values()

    def __call__(self, place, reading=EMPTY):
        given = self.cells, self.corner, [*place, HULL, EDGE], self.walls, reading
        self.cells, self.corner, self.marked, self.unknown = map_step(self.chart, *given)
        return self

    def at(self, x, y):
        """Value of the cell that holds a place; None outside the window."""
        values, xs, ys = self.chart.view(self.cells, self.corner, edge=EDGE)
        i, j = (int(np.argmin(np.abs(c - v))) for c, v in ((xs, x), (ys, y)))
        return values[j, i] if max(abs(xs[i] - x), abs(ys[j] - y)) <= 0.5 * EDGE + 1e-9 else None


AHEAD = firing((HULL, 0.0), 0.0, 1.0, half=math.radians(5))


def test_it_starts_unknown_but_for_the_place_of_the_hull():
    chart = Chart()((0.3, -0.2))
    values, x, y = chart.chart.view(chart.cells, chart.corner, edge=EDGE)
    away = np.hypot(x - 0.3, (y + 0.2)[:, None])
    assert values.shape == (48, 48) and np.all((values == -1) == (away < HULL)) and set(np.unique(values)) == {-1, 0}
    assert abs(x.mean() - 0.3) <= EDGE and abs(y.mean() + 0.2) <= EDGE
    assert np.allclose(np.diff(x), EDGE) and np.allclose(np.diff(y), EDGE)


@pytest.mark.parametrize("axis", [0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi])
def test_the_view_shows_a_mark_where_it_was_heard(axis):
    ahead, start = np.array([math.cos(axis), math.sin(axis)]), np.array([7.31, -3.77])
    reading = firing(start + HULL * ahead, axis, 1.0, half=math.radians(5))
    chart = Chart()(start, reading)
    mark, short, beyond = (start + (HULL + away) * ahead for away in (1.0, 0.8, 1.2))
    assert chart.at(*mark) == 1.0 and chart.at(*short) == -1.0 and chart.at(*beyond) == 0.0
    row = chart.marked.reshape(-1, 3)[round(axis / (2 * np.pi) * 16) % 16]
    assert np.abs(row[:2] - (mark - start)).max() < 2 * EDGE and row[2] == pytest.approx(row[0] ** 2 + row[1] ** 2)


def test_what_stands_still_stays_where_it_is_while_the_window_moves():
    chart = Chart()((0.0, 0.0), AHEAD)
    for way in np.arange(0, 0.9, 0.02):
        chart((way, -0.5 * way))
        assert chart.at(HULL + 1.0, 0.0) > 0.9
    assert math.hypot(*(chart.marked.reshape(-1, 3)[1:3, :2].min(axis=0))) < 0.8


def test_a_cell_that_leaves_and_comes_back_is_unknown():
    chart = Chart()((0.0, 0.0), AHEAD)
    assert chart.at(HULL + 1.0, 0.0) == 1.0
    there = [*np.arange(0, -1.0, -0.1), *np.arange(-1.0, 0.01, 0.1)]
    values = [chart((x, 0.0)).at(HULL + 1.0, 0.0) for x in there]
    assert None in values and values[-1] == 0.0
    assert all(v > 0.9 for v in values[: values.index(None)])


@pytest.mark.parametrize("jump", [(5.0, 0.0), (0.0, -5.0), (48 * EDGE, 0.0), (-100.0, 48 * EDGE), (1e5, 1e5)])
def test_a_jump_of_the_pose_empties_it(jump):
    chart = Chart()((0.01, 0.01), AHEAD)((0.01 + jump[0], 0.01 + jump[1]))
    assert not np.any(chart.cells > 0)
    assert np.sum(chart.cells < 0) == pytest.approx(math.pi * (HULL / EDGE) ** 2, abs=8)


def test_neither_its_size_nor_what_it_holds_depends_on_the_site():
    """A robot 10,000 cells away finds the same."""
    rng, here, there = np.random.default_rng(5), Chart(), Chart()
    offset = EDGE * np.array([10_000.0, -7_777.0])
    place = np.zeros(2)
    for k in range(60):
        place = place + rng.uniform(-0.04, 0.04, 2)
        at = place + HULL * np.array([math.cos(k), math.sin(k)])
        reading = (rng.uniform(0.3, 2.0), math.radians(37.5))
        near = firing(at, k, reading[0], half=reading[1])
        here(place, near)
        there(place + offset, firing(at + offset, k, reading[0], half=reading[1]))
    views = [c.chart.view(c.cells, c.corner)[0] for c in (here, there)]
    np.testing.assert_allclose(*views, atol=1e-9)
    assert {port.size for port in here.chart.ports()} == {48**2, 2}


# --- walls ----------------------------------------------------------------------------------------------------------

ROOM = (0.0, 64 * EDGE, -20 * EDGE, 20 * EDGE)  # longer than the window, and narrower


@pytest.mark.parametrize(
    ("x", "lowest"), [(0.3, 0), (32 * EDGE - 0.01, 7), (64 * EDGE - 0.3, 16), (-0.5, 0), (64 * EDGE + 9.0, 16)]
)
def test_the_window_stays_inside_the_walls(x, lowest):
    """It ends at the nearer wall; across, where the site is narrower than it, it begins at the lower wall."""
    assert Chart(ROOM)((x, 0.1)).corner.tolist() == [lowest, -20]


def test_near_a_wall_more_of_what_is_ahead_is_kept():
    """A mark 2.2 m away, beyond the half of a window in whose middle the robot is."""
    far = firing((0.3 + HULL, 0.0), 0.0, 2.2, half=math.radians(5))
    for walls, held in ((ROOM, 1.0), (OPEN, None)):
        chart = Chart(walls)((0.3, 0.0), far)
        assert chart.at(0.3 + HULL + 2.2, 0.0) == held


def known_but_for(chart, low, hidden):
    """All the window from `low` on (2,) [m] is known to be free, but the cells of which `hidden`, of their middles."""
    chart.corner = np.array(low) / EDGE
    _, x, y = chart.chart.view(chart.cells, chart.corner, edge=EDGE)
    many, size, side = chart.chart.blocks, chart.chart.block, chart.chart.side
    torus = np.empty((side, side))
    rows, columns = (np.mod(np.floor(axis / EDGE), side).astype(int) for axis in (y, x))
    torus[np.ix_(rows, columns)] = np.where(hidden(x, y[:, None]), 0.0, -1.0)
    chart.cells = torus.reshape(many, size, many, size).swapaxes(1, 2).reshape(-1)
    return chart


@pytest.mark.parametrize("cells", [2, 3])
@pytest.mark.parametrize("wall", range(4))
def test_what_is_unknown_in_the_two_cells_beside_a_wall_does_not_count(wall, cells):
    axis, sign = wall // 2, 1 - 2 * (wall % 2)
    from_wall = [lambda x, y: sign * (x - ROOM[wall]) + 0 * y, lambda x, y: sign * (y - ROOM[wall]) + 0 * x][axis]
    at, low = ((50 * EDGE, 0.0), 16 * EDGE) if wall == 1 else ((15 * EDGE, 0.0), 0.0)
    chart = known_but_for(Chart(ROOM), (low, ROOM[2]), lambda x, y: from_wall(x, y) < cells * EDGE)(at)
    assert bool(np.any(chart.unknown.reshape(-1, 3)[:, 2] < FAR)) == (cells > 2)


@settings(derandomize=True, deadline=None, max_examples=20)
@given(st.floats(2.01, 6.0), st.floats(5.0, 40.0), st.sampled_from([-1.0, 1.0]))
def test_nothing_larger_than_two_cells_hides_at_a_wall(across, x, side):
    """A disc that touches the wall: the cells that it touches and those beyond the wall are unknown; one is told."""
    radius, wall = 0.5 * across * EDGE, 20 * EDGE
    middle = np.array([x * EDGE, side * (wall - radius)])

    def hidden(cx, cy):
        dx, dy = np.maximum(np.abs(cx - middle[0]) - EDGE / 2, 0), np.maximum(np.abs(cy - middle[1]) - EDGE / 2, 0)
        return (np.hypot(dx, dy) <= radius) | (np.abs(cy) > wall)

    chart = known_but_for(Chart(ROOM), (0.0, ROOM[2]), hidden)((22 * EDGE, 0.0))
    told = chart.unknown.reshape(-1, 3)
    found = told[told[:, 2] < FAR, :2] + [22 * EDGE, 0.0]
    assert len(found) and np.min(np.hypot(*(found - middle).T)) < radius + EDGE


# --- fading ---------------------------------------------------------------------------------------------------------


def test_a_mark_stands_for_its_time_and_then_is_unknown():
    chart = Chart(mark_time=2.0)((0.0, 0.0), AHEAD)
    ages = [chart((0.0, 0.0)).at(HULL + 1.0, 0.0) for _ in range(60)]
    assert ages[0] == pytest.approx(1 - DT / 2.0) and np.all(np.diff(ages[:40]) < 0)
    assert np.all(np.array(ages[:39]) > 0) and np.abs(ages[40:]).max() < 1e-12


def test_what_was_free_is_unknown_again_after_its_time():
    ahead = firing((HULL, 0.0), 0.0, 1.0, half=math.radians(37.5))
    chart = Chart(free_time=2.0, known=0.3)((0.0, 0.0), ahead)
    told, values = [], []
    for _ in range(60):
        chart((0.0, 0.0))
        told.append(math.sqrt(chart.unknown.reshape(-1, 3)[0, 2]))
        values.append(chart.at(HULL + 0.6, 0.0))
    assert np.abs(np.array(values) + np.maximum(1 - DT / 2.0 * np.arange(1, 61), 0)).max() < 1e-12
    near = np.array(told) < HULL + 0.8
    first = int(np.argmax(near))
    assert near[first:].all() and (first + 1) * DT == pytest.approx(0.7 * 2.0, abs=1.01 * DT)


# --- a world that stands still ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("beam", WIDE)
def test_what_one_reading_clears_lies_wholly_in_its_cone(beam):
    """Beyond where the middle of a beam is narrower than a cell: 0.2 m from the apex at 75°, 1 m at 15°."""
    rng, half = np.random.default_rng(1), math.radians(beam) / 2
    narrow = (0.6 * EDGE + 0.01) / (0.4 * math.sin(half))
    seen = 0
    for _ in range(20):
        axis, distance, place = rng.uniform(-3, 3), rng.uniform(0.5, 2.0), rng.uniform(-1, 1, 2)
        ahead = np.array([math.cos(axis), math.sin(axis)])
        apex = place + HULL * ahead
        chart = Chart()(place, firing(apex, axis, distance, half=half))
        values, x, y = chart.chart.view(chart.cells, chart.corner, edge=EDGE)
        j, i = np.nonzero(values == -1)
        for cx, cy in zip(x[i], y[j], strict=True):
            far = (np.array([cx, cy]) - apex) @ ahead
            if far < narrow or math.dist((cx, cy), place) < HULL:
                continue
            seen += 1
            corners = np.array([[cx, cy]]) + 0.5 * EDGE * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]) - apex
            assert np.all(np.hypot(*corners.T) < distance)
            assert np.all(np.abs(np.arctan2(corners @ [-ahead[1], ahead[0]], corners @ ahead)) <= half)
    assert seen > 150


@cache
def journeys(beam):
    """In one world, by the law's chart."""
    return [list(journey(0, beam, chart=LocalMap(dt=DT)))]


@pytest.mark.parametrize("beam", WIDE)
def test_a_surface_that_was_heard_is_never_known_to_be_free(beam):
    """Wide beams: never. Of 15°, whose middle clears cells that reach beyond its edge: 1 in 10,000 (25 worlds)."""
    chart, looked, wrong = LocalMap(dt=DT), 0, 0
    for path in journeys(beam):
        heard = set()
        for now in path:
            heard |= {(math.floor(x / EDGE), math.floor(y / EDGE)) for x, y in now.heard}
            values, _, _ = chart.view(now.cells, now.corner)
            at = np.array(sorted(heard)).reshape(-1, 2) - now.corner.astype(int)
            at = at[np.all((at >= 0) & (at < chart.side), axis=1)]
            looked += len(at)
            wrong += int(np.sum(values[at[:, 1], at[:, 0]] < -chart.known))
    assert looked > 5_000
    assert wrong <= (0 if beam in WIDE else 0.001 * looked)


class Around:
    """Every half second once every direction was swept: the true surface, the marks, and what is told of them."""

    def __init__(self, beam):
        self.chart = LocalMap(dt=DT)
        rows, marks = [], []
        for path in journeys(beam):
            for k, now in enumerate(path):
                if now.time * SPIN > 2 * np.pi and k % 10 == 0:
                    rows += self._look(now)
                    marks.append(self.offsets)
        self.rows = np.array(rows)
        self.away, self.mark, self.told, self.unknown = self.rows.T

    def _look(self, now):
        values, x, y = self.chart.view(now.cells, now.corner, edge=EDGE)
        dx, dy = np.meshgrid(x - now.position[0], y - now.position[1])
        self.offsets = dx[values > 0], dy[values > 0]
        bearings = np.linspace(0, 2 * np.pi, 720, endpoint=False)
        ranges = heard_along(now.shapes, now.position, bearings)
        rays = ranges * np.array([np.cos(bearings), np.sin(bearings)])
        inside = np.abs(rays).max(axis=0) < (self.chart.side / 2 - 1) * EDGE
        sector, marked = directions(self.chart, *rays), directions(self.chart, *self.offsets)
        rows = []
        for k in range(self.chart.sectors):
            if np.any(mine := inside & (sector == k)):
                mark = np.hypot(*self.offsets)[marked == k].min(initial=1e3)
                rows.append((ranges[mine].min(), mark, math.sqrt(now.marked[k, 2]), math.sqrt(now.unknown[k, 2])))
        nearest = np.hypot(*self.offsets).min()
        assert math.sqrt(now.marked[:, 2].min()) == pytest.approx(nearest)
        return rows


around = cache(Around)


@pytest.mark.parametrize("beam", WIDE)
def test_once_swept_a_mark_stands_before_every_surface(beam):
    """In each direction the nearest mark is at most 0.06 m beyond a surface within 1.1 m: less than a cell.

    Farther off, a mark elsewhere on the arc, which silence from other directions does not clear, explains some echoes.
    """
    seen = around(beam)
    beyond = seen.mark - seen.away
    assert len(seen.rows) > 60
    assert np.max(beyond[seen.away < 1.1]) < 0.06 < EDGE
    assert 0 < np.mean(beyond > 0.06) < 0.1


@pytest.mark.parametrize("beam", WIDE)
def test_the_nearest_of_all_is_told_but_not_that_of_every_direction(beam):
    """A block tells its nearest cell alone, so a direction that shares it may be told of one further off, or none.

    Where a mark stands in a direction, one further by more than 5 cm is told in some four of ten.
    """
    seen = around(beam)
    hidden = (seen.told - seen.mark > 0.05)[seen.mark < 1e3]
    assert 0 < np.mean(hidden) < 0.45
    assert np.all(seen.told >= seen.mark - 1e-9)


@pytest.mark.parametrize("beam", WIDE)
def test_false_marks_vanish_around_one_thing_alone(beam):
    """One disc in open water, the robot turns once beside it: every mark lies within two cells of its surface."""
    chart, disc, most = LocalMap(dt=DT), Disc((1.1, 0.2), 0.15), 0.0
    path = journey(0, beam, chart=chart, seconds=2.2 * np.pi / SPIN, speed=0.0, shapes=[disc], place=(0.0, 0.0))
    for now in path:
        values, x, y = chart.view(now.cells, now.corner, edge=EDGE)
        off = np.abs(np.hypot(x - 1.1, (y - 0.2)[:, None]) - 0.15)[values > 0]
        most = max(most, off.max(initial=0.0))
    assert off.size
    assert off.max() < 2 * EDGE < most  # there were others


@pytest.mark.parametrize("beam", WIDE)
def test_false_marks_before_a_near_surface_are_few(beam):
    """In a room full of things: in nine of ten directions with a surface within 1.2 m at most two cells short of it."""
    seen = around(beam)
    short = (seen.away - seen.mark)[seen.away < 1.2]
    assert len(short) > 25
    assert np.quantile(short, 0.9) < 2 * EDGE


@pytest.mark.parametrize("unknown", range(1, 6))
def test_unknown_cells_that_no_disc_two_cells_across_fits_in_are_not_told(unknown):
    """One or two cells of a block, all around known to be free: nothing of that size hides there."""
    chart = LocalMap(dt=DT)
    place = np.array([0.0, 0.0, HULL, EDGE])
    window = np.floor(place[:2] / EDGE) - chart.side // 2
    cells = np.full((chart.blocks**2, chart.block**2), -1.0)
    cells[8 * chart.blocks + 8, :unknown] = 0.0  # more than a metre from the robot
    empty = np.tile(EMPTY, chart.slots)
    *_, told = map_step(chart, cells.reshape(-1), window, place, OPEN, empty)
    assert np.any(told[2::3] < FAR) == (unknown >= 3)


@settings(derandomize=True, deadline=None, max_examples=20)
@given(st.floats(-1.2, 1.2), st.floats(-1.2, 1.2), st.floats(1.0, 3.0))
def test_where_such_a_disc_hides_its_cells_are_told(x, y, radius):
    """All cells that it touches are unknown, all others free: a cell of it is told."""
    assume(np.hypot(x, y) > HULL + (RING + radius + 1.5) * EDGE)
    chart = LocalMap(dt=DT)
    place = np.array([0.0, 0.0, HULL, EDGE])
    window = np.floor(place[:2] / EDGE) - chart.side // 2
    _, xs, ys = chart.view(np.zeros(chart.side**2), window, edge=EDGE)
    dx, dy = (np.maximum(np.abs(axis - at) - EDGE / 2, 0) for axis, at in ((xs, x), (ys, y)))
    touched = np.hypot(dx, dy[:, None]) <= radius * EDGE
    rolled = np.zeros((chart.side, chart.side))
    rows, columns = (np.mod(np.floor(axis / EDGE), chart.side).astype(int) for axis in (ys, xs))
    rolled[np.ix_(rows, columns)] = np.where(touched, 0.0, -1.0)
    many, size = chart.blocks, chart.block
    cells = rolled.reshape(many, size, many, size).swapaxes(1, 2).reshape(-1)
    empty = np.tile(EMPTY, chart.slots)
    *_, told = map_step(chart, cells, window, place, OPEN, empty)
    found = told.reshape(-1, 3)[told[2::3] < FAR]
    assert len(found) and np.min(np.hypot(found[:, 0] - x, found[:, 1] - y)) <= (radius + 0.75) * EDGE


def test_what_went_away_is_cleared_and_what_came_is_marked():
    """A reading that contradicts what is known to be free marks its whole arc."""
    half = math.radians(37.5)
    chart = Chart()((0.0, 0.0), firing((HULL, 0.0), 0.0, 1.0, half=half))
    assert chart.at(HULL + 1.0, 0.0) == 1.0
    for turn in (-0.4, 0.0, 0.4):  # its whole arc, with the edges
        chart((0.0, 0.0), firing((HULL, 0.0), turn, 1.6, half=half))
    assert chart.at(HULL + 1.0, 0.0) < -0.9
    chart((0.0, 0.0), firing((HULL, 0.0), 0.0, 0.7, half=half))
    assert all(chart.at(HULL + 0.7 * math.cos(a), 0.7 * math.sin(a)) == 1.0 for a in np.linspace(-0.6, 0.6, 9))


@pytest.mark.parametrize(
    ("measured", "angle", "stays"), [(9.0, 0.5, True), (0.65, 0.5, True), (0.45, 0.5, False), (0.45, 1.5, True)]
)
def test_a_smooth_mark_silent_from_beside_stays_unless_an_echo_comes_from_close_behind(measured, angle, stays):
    """Heard from two directions, then not from a third, with no echo, one from far behind and one from its new place.

    0.5 rad is beside the sector, which counts only for marks beyond `NEAR`; `MOVED` is 0.135 m.
    """
    mark, half = np.array([0.525, 0.025]), math.radians(20)

    def beam(angle, reading):
        return firing(mark - 0.3 * np.array([math.cos(angle), math.sin(angle)]), angle, reading, half=half)

    chart = Chart()
    for heard in (0.1, 0.3):
        chart((0.0, 0.0), beam(heard, 0.3))
    assert chart.at(*mark) > 0.99
    assert (chart((0.0, 0.0), beam(angle, measured)).at(*mark) > 0) == stays


def test_an_echo_that_a_mark_explains_marks_nothing_known_to_be_free():
    half = math.radians(37.5)
    chart = Chart()((0.0, 0.0), firing((HULL, 0.0), 0.0, 1.0, half=half))
    # the edge of a beam that sees past it clears one side
    chart((0.0, 0.0), firing((HULL, 0.0), half + 0.1, 1.5, half=half))
    cleared = HULL + 1.0 * math.cos(0.45), 1.0 * math.sin(0.45)
    assert chart.at(*cleared) == -1.0
    chart((0.0, 0.0), firing((HULL, 0.0), 0.0, 1.0, half=half))
    assert chart.at(*cleared) < -0.9 and chart.at(HULL + math.cos(0.3), -math.sin(0.3)) == 1.0


def test_a_blind_firing_leaves_what_was_ranged_and_clears_what_it_marked_itself():
    """Nearer than its blind range a sonar says no more than that: it must not wipe out what it came near to."""
    half, ahead, axis = math.radians(37.5), 10.5 * EDGE, 0.5 * EDGE  # along the middle of a row of cells
    chart = Chart()((0.0, axis), firing((HULL, axis), 0.0, ahead - HULL, half=half))
    assert chart.at(ahead, axis) == 1.0
    near, blind = ahead - 0.1 - HULL, firing((ahead - 0.1, axis), 0.0, 0.1, half=half)
    chart((near, axis), blind)
    assert chart.at(ahead, axis) > 0.99
    wrong = (*blind[:6], -blind[6], *blind[7:])  # as if it had been ranged
    assert chart((near, axis), wrong).at(ahead, axis) == -1.0
    fresh = Chart()((near, axis), blind)
    assert fresh.at(ahead, axis) == -1.0 and fresh.at(ahead + 2 * EDGE, axis) == BLIND


def test_a_reading_has_the_numbers_that_it_says():
    assert sum(size for _, size, _ in READING) == len(EMPTY) == len(AHEAD)


# --- blocks that are left alone ---------------------------------------------------------------------------------------


def same_bits(found, expected):
    """Whether two lists of arrays are equal to the last bit."""
    return [np.ascontiguousarray(a).tobytes() for a in found] == [np.ascontiguousarray(b).tobytes() for b in expected]


@pytest.mark.parametrize(
    ("name", "real", "walls"),
    [("small", np.float32, (-0.4, 30.0, -30.0, -1.5))],
)
def test_the_routine_has_the_bits_of_whole_arrays(name, real, walls):
    """Replay and compiled C, over periods in which the robot wanders and jumps once."""
    need_compiler()
    chart = LocalMap(dt=DT, **CHARTS[name])
    given, expected = [], []
    cells, corner = np.zeros(chart.side**2), np.full(2, 1e6)
    for _, _, place, sides, readings in flight(chart, 12, 5, walls)[0]:
        given.append([np.asarray(x, dtype=real) for x in (cells, corner, place, sides, readings)])
        expected.append(plain_map(chart, *given[-1], real=real))
        cells, corner = expected[-1][:2]
    stacked = [np.array(column) for column in zip(*given, strict=True)]
    stacked_expected = [np.array(column) for column in zip(*expected, strict=True)]
    assert stacked_expected[0].dtype == real
    assert same_bits(compile_block(chart.routine(), real=np.dtype(real).name)(*stacked), stacked_expected)
    assert same_bits(replay(chart.routine(), *stacked, real=real), stacked_expected)
    # alone, so that no other run in the batch wants a block
    assert same_bits(replay(chart.routine(), *given[5], real=real), expected[5])


def stepping(chart):
    """The map as a tick of a batch: (flag, cells, corner, marked, unknown) and (place, walls, readings)."""
    state = {"flag": 1, "cells": chart.side**2, "corner": 2, "marked": 3 * chart.sectors, "unknown": 3 * chart.sectors}
    parameters = {"place": 4, "walls": 4, "slots": chart.slots * len(EMPTY)}

    def moves(name, inputs, outputs):
        return lower(ca.Function(name, inputs, outputs))

    def cut(name, sizes):
        whole = ca.SX.sym(name, sum(sizes.values()))
        parts = ca.vertsplit(whole, np.cumsum([0, *sizes.values()]).tolist())
        return Call(moves(f"cut_{name}", [whole], parts), (name,), tuple(sizes))

    parts = [ca.SX.sym(name, size) for name, size in state.items()]
    results = ("cells_next", "corner_next", "marked_next", "unknown_next")
    steps = (
        cut("state", state),
        cut("parameters", parameters),
        Call(chart.routine(), ("cells", "corner", *parameters), results),
        Call(moves("join", parts, [ca.vertcat(*parts)]), ("flag", *results), ("state_next",)),
    )
    sizes = (("state", sum(state.values())), ("parameters", sum(parameters.values())))
    return Routine("stepping", sizes, steps, ("state_next",))


def test_maps_side_by_side_have_the_same_bits():
    """Runs of a batch, of which some have a block touched and others not."""
    need_compiler()
    chart = LocalMap(dt=DT)
    given, _ = flight(chart, 21, seed=11, walls=OPEN)
    expected = [plain_map(chart, *one) for one in given]
    none = np.zeros(6 * chart.sectors)
    state = np.array([np.concatenate([[0.0], one[0], one[1], none]) for one in given])
    parameters = np.array([np.concatenate(one[2:]) for one in given])
    after = compile_batch(stepping(chart)).run(state, parameters, steps=1)
    assert same_bits([after[:, 1:]], [np.array([np.concatenate(one) for one in expected])])


def grazing(rng, chart):
    """A firing, or a hull, that reaches one cell in a corner of a block, or just does not."""
    side, size = chart.side, chart.block
    place = np.array([*rng.uniform(-3, 3, 2), HULL, EDGE])
    low = np.floor(place[:2] / EDGE) - side // 2
    tied = rng.random() < 0.5  # a seam inside of blocks, or along their sides
    low = low if tied else size * np.floor(low / size)
    place[:2] += (low + side // 2 - np.floor(place[:2] / EDGE)) * EDGE
    first = size * rng.integers(1, chart.blocks - 1, 2) - low % size
    cell = (low + first + (size - 1) * rng.integers(0, 2, 2) + 0.5) * EDGE
    half = math.radians(rng.choice([15, 75, 120])) / 2
    axis = rng.choice([rng.uniform(-3, 3), 0.5 * math.pi * rng.integers(0, 4)])
    away, off = rng.uniform(2 * EDGE, 20 * EDGE), rng.choice([0.0, 1e-15, 1e-7, 1e-3]) * rng.choice([-1, 1])
    kind = rng.choice(["side", "far", "near", "clear", "hull"])
    beside = half + math.asin(0.5 * EDGE / away) if kind == "side" else rng.uniform(0, half)
    bearing = axis + beside * rng.choice([-1, 1]) + off * (kind == "side")
    apex = cell - away * np.array([math.cos(bearing), math.sin(bearing)])
    reach = away + off * (kind != "side")
    readings = {
        "side": (rng.choice([0.0, away + 0.1]), away - 0.05, away + 0.05, away + 0.2),
        "far": (max(reach - 0.2, 0.0), reach - 0.1, reach, reach),
        "near": (0.0, reach, reach + 0.05, reach + 0.1),
        "clear": (reach * rng.choice([-1, 1]), 0.0, -1.0, 0.0),
        "hull": EMPTY[6:],
    }[kind]
    if kind == "hull":
        place[2] = math.dist(cell, place[:2]) + off
    reading = (*apex, math.cos(axis), math.sin(axis), math.cos(half), math.sin(half), *readings)
    slots = [reading, *[EMPTY] * (chart.slots - 1)]
    cells = rng.choice([-1.0, -0.8, 0.0, 0.5], chart.side**2)
    return [cells, low, place, np.array(OPEN), np.concatenate([slots[k] for k in rng.permutation(chart.slots)])]


@pytest.mark.parametrize("real", [np.float64])
def test_a_block_that_is_only_grazed_is_not_left_alone(real):
    """Cones, arcs and hulls that end at the centre of a block's corner cell, to the last bit and beside it."""
    need_compiler()
    rng, chart = np.random.default_rng(4), LocalMap(dt=DT)
    given = [[np.asarray(x, dtype=real) for x in grazing(rng, chart)] for _ in range(150)]
    expected = [plain_map(chart, *one, real=real) for one in given]
    stacked = [np.array(column) for column in zip(*given, strict=True)]
    found = compile_block(chart.routine(), real=np.dtype(real).name)(*stacked)
    for now, right in zip(zip(*found, strict=True), expected, strict=True):
        assert same_bits(now, right)


@pytest.mark.parametrize("half", [0.0, 100.0, 180.0, 250.0])
def test_a_cone_that_the_bounds_do_not_know_leaves_no_block_alone(half):
    """A ray, and one of more than half a circle."""
    need_compiler()
    rng, chart = np.random.default_rng(5), LocalMap(dt=DT)
    run = compile_block(chart.routine())
    for axis, distance in itertools.product(range(4), (0.4, 1.0, 9.0)):
        readings = np.concatenate([firing((0.1, 0.2), axis + k, distance, half=math.radians(half)) for k in range(2)])
        given = rng.choice([-1.0, 0.0, 0.5], chart.side**2), np.full(2, -24.0), [0.01, 0.01, HULL, EDGE], OPEN, readings
        assert same_bits(run(*given), plain_map(chart, *given))
