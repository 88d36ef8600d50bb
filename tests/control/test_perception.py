"""What the senses tell the decision: the pose, sonars that may be believed, movers, marks, doubt; and what it costs."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.ir import Gather, Loop, Routine
from surctl.marine.control import NONFINITE, build_law
from surctl.marine.control.decision import Scan, lower_levels
from surctl.marine.control.perception import CELLS_A_HULL, LAST_THRUST, build_perception
from surctl.marine.control.ports import SECTORS, scan_inputs, sonar_inputs
from surctl.marine.sensing import BaseStation, Delivery, Equipment, OwnState, RangeTracker, SonarArray
from surctl.marine.sensing.localisation.movers import MoverTracker
from surctl.marine.world import Disc
from tests.control.robot import CONTACTS, DT, EDGE, HULL, TRUTH, Robot, exact, parameters, senses
from tests.tools import need_compiler

FREE = -0.3  # below it a cell is known to be free
# of the equipment one routine each, compiled once
EXACT = exact(bias=0.06, calibrated_for=1600.0)
LATE_OVER_A_FLOOR = replace(EXACT, floor=0.65, station=BaseStation(messages=Delivery(latency=0.5)))
OFF_CENTRE = (1.2, 1.7, -0.15, 0.2)  # no two sonars hear the same


@pytest.fixture(autouse=True, scope="module")
def _compiler():
    need_compiler()


def around(robot):
    """Values, x and y of the map in {E}."""
    return robot.chart.view(robot.state("map_cells"), robot.state("map_corner"), edge=EDGE)


def marks(told):
    """(k, 3) x, y, radius of the contacts that the map gives."""
    rows = told["contacts"][CONTACTS:]
    return rows[rows[:, 5] > 0.5, :3]


# --- layouts --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("equipment", "contacts"),
    [(TRUTH, CONTACTS), (Equipment(array=SonarArray(azimuths=(0.0, 2.0, 4.0), order=(0, 1, 2))), 0)],
)
def test_layouts(equipment, contacts):
    n = equipment.array.size
    given, told = sonar_inputs(equipment, contacts=contacts), scan_inputs(contacts + SECTORS, sensors=n)
    made = senses(equipment)[0] if contacts else build_perception(equipment, given, told, dt=DT)
    assert made.state.ports[0] == LAST_THRUST
    assert made.block.inputs[0][1] == made.state.size and made.block.inputs[1][1] == given.size
    assert [size for _, size in made.block.outputs] == [made.state.size - LAST_THRUST.size, told.size]
    names = [port.name for port in made.state]
    assert len(set(names)) == len(names) and {"map_cells", "map_corner", "silent"} <= set(names)
    assert any(name.startswith("own_") for name in names) == (equipment.own is not None)
    assert ("mover_latest" in names) == (contacts > 0)
    assert told.port("sonars").shape == (n, 6) and told.port("contacts").shape == (contacts + SECTORS, 6)
    assert made.state.port("map_cells").size == 48**2


def test_a_beam_that_the_hull_cuts_in_two_is_refused():
    array = SonarArray(azimuths=(0.0,), mounts=((-0.9, 0.0),), order=(0,))
    with pytest.raises(InputError, match=r"array\.mounts.*two"):
        build_perception(
            Equipment(array=array), sonar_inputs(Equipment(array=array)), scan_inputs(SECTORS, sensors=1), dt=DT
        )


# --- where it is ----------------------------------------------------------------------------------------------------


def test_before_the_first_fix_it_knows_of_nothing():
    """Not even that the place of the hull is free: that place is the origin of {E}, where it is not."""
    robot = Robot(Equipment(), at=(1.0, 1.0, -0.15, 0.0), shapes=[Disc((1.8, 1.0), 0.1)])
    for _ in range(40):
        told = robot.step(fix_fresh=0.0)
        assert told["placed"][0] == 0.0 and not len(marks(told))
    assert not robot.state("map_cells").any()
    assert told["sonars"][:, 2].all()  # and no echo is too long for a wall, seen from nowhere
    told = robot.step()
    assert told["placed"][0] == 1.0 and told["eta"][:2] == pytest.approx([1.0, 1.0])
    assert len(marks(robot.steps(4.0)))


def test_without_any_echo_it_does_not_turn_to_scan():
    """Turning would scan nothing; the first plausible firing starts the turn, and silence does not end it."""
    robot = Robot(Equipment(), spin=0.0)
    robot.wrong = {k: lambda honest, tick: None for k in range(4)}
    assert robot.steps(3.0)["echoed"][0] == 0.0
    robot.wrong = {k: lambda honest, tick: -1.0 + 0.0 * honest for k in range(4)}
    assert robot.steps(3.0)["echoed"][0] == 0.0
    robot.wrong = {}
    assert robot.steps(0.2)["echoed"][0] == 1.0
    robot.wrong = {k: lambda honest, tick: None for k in range(4)}
    assert robot.steps(3.0)["echoed"][0] == 1.0
    p = {"depth": 0.0, "k2": 0.3, "spin": ca.SX(0.45), "spin_limit": ca.SX(0.69)}
    for heard, turn in ((1.0, 0.45), (0.0, 0.0)):
        scan = Scan(ca.SX(0), ca.SX(0), ca.SX(1), ca.SX(heard))
        level = lower_levels(ca.SX.sym("eta", 4), SimpleNamespace(heading=ca.SX(0)), p, scan)[1]
        assert float(ca.evalf(ca.SX(level.reference))) == turn


def test_it_is_told_the_truth_where_nothing_measures_it():
    robot = Robot(TRUTH, at=OFF_CENTRE)
    eta = robot.eta.copy()
    told = robot.step()
    assert told["placed"][0] == 1.0
    np.testing.assert_array_equal(told["eta"], eta)
    np.testing.assert_array_equal(told["nu"], robot.nu)


def test_doubt_about_the_own_position_grows_every_contact():
    """Fixes fail: what is around comes nearer, until the robot does not know where it is."""
    robot = Robot(Equipment(), at=OFF_CENTRE, shapes=[Disc((2.4, 1.9), 0.15)], spin=0.0)
    message = np.zeros((CONTACTS, 6))
    message[0] = 3.0, 3.0, 0.2, 0.0, 0.0, 1.0
    robot.steps(4.0)
    told = robot.step(contacts=message, contacts_fresh=1.0)
    least = 0.8 * EDGE
    assert marks(told)[:, 2] == pytest.approx(least, abs=1e-12)  # a doubt that the margin has room for
    radii, places, free = [], [], told["unknown"][:, 2]
    for _ in range(600):
        told = robot.step(fix_fresh=0.0, contacts=message, contacts_fresh=1.0)
        radii.append((marks(told)[0, 2], told["contacts"][0, 2]))
        places.append(told["placed"][0])
        if not places[-1]:
            break
    mark, mover = np.array(radii).T
    assert np.all(np.diff(mark) >= 0) and mark[-1] > least + 0.5
    doubt = mark - least
    np.testing.assert_allclose(mover - mover[0], doubt - doubt[0], atol=1e-12)
    assert doubt[0] < 0.02 and doubt[-1] == pytest.approx(3 * 0.2 - 0.02, abs=1e-9)  # no more than where it is lost
    assert places[0] == 1.0 and places[-1] == 0.0
    assert free.min() >= 0 and np.median(told["unknown"][:, 2]) < np.median(free) - 0.5


# --- which sonars it believes ---------------------------------------------------------------------------------------


def stuck(times=10**9):
    """What a converter gives that hangs: the first set again and again, so many times."""
    kept = []

    def wrong(honest, tick):
        kept.append(kept[0] if kept else honest.copy())
        return kept[0] if len(kept) <= times else None

    return wrong


FAULTS = {
    "dead": (lambda: lambda honest, tick: None, 0.35),
    "zero": (lambda: lambda honest, tick: 0.0 * honest, 0.35),
    "silent": (lambda: lambda honest, tick: 0.0 * honest + 4.5, 0.35),
    "beyond a wall": (lambda: lambda honest, tick: honest + 0.8, 0.35),
    "stuck": (stuck, 0.55),
}


def with_fault(wrong, start, spin, **world):
    robot = Robot(TRUTH, at=OFF_CENTRE, spin=spin, seed=start, **world)
    told = robot.steps(3.0 + start * DT)
    assert told["sonars"][:, 2].all()
    robot.wrong[0] = wrong
    return robot


@pytest.mark.parametrize(
    ("fault", "spin", "start"),
    [("dead", 0.27, 0), ("zero", 0.0, 1), ("silent", 0.27, 0), ("beyond a wall", 0.0, 1), ("stuck", 0.27, 1)],
)
def test_a_faulty_sonar_is_told_and_changes_no_map(fault, spin, start):
    """Three cycles and a step after its last honest firing; one that hangs repeats itself twice before.

    The map is that of a robot with a dead sonar, at every step.
    """
    make, within = FAULTS[fault]
    robot = with_fault(make(), start, spin)
    repeats = RangeTracker(array=robot.array, dt=DT).repeats
    other = with_fault(stuck(repeats) if fault == "stuck" else FAULTS["dead"][0](), start, spin)
    healthy = []
    for _ in range(30):
        told, reference = robot.step(), other.step()
        healthy.append(told["sonars"][0, 2])
        assert told["sonars"][1:, 2].all() and reference["sonars"][1:, 2].all()
        np.testing.assert_array_equal(robot.state("map_cells"), other.state("map_cells"))
        np.testing.assert_array_equal(told["unknown"], reference["unknown"])
    lost = healthy.index(0.0)
    assert lost * DT <= within - DT + 1e-9 and not any(healthy[lost:])
    robot.wrong.clear()
    assert robot.steps(2.0)["sonars"][0, 2] == 1.0  # and is believed again


def test_what_lies_beyond_a_wall_is_never_cleared():
    """All four read 0.8 m too much: nothing past the walls becomes free. The site is narrower than the window."""
    site = (0.0, 2.9, 0.0, 2.9)
    robot = Robot(TRUTH, at=OFF_CENTRE, walls=site, spin=0.45)
    robot.wrong = {k: FAULTS["beyond a wall"][0]() for k in range(4)}
    told = robot.steps(15.0)
    values, x, y = around(robot)
    outside = (np.minimum(x, 2.9 - x) < -EDGE) | (np.minimum(y, 2.9 - y) < -EDGE)[:, None]
    assert outside.sum() > 100 and not np.any(values[outside] < 0) and not told["sonars"][:, 2].any()
    honest = Robot(TRUTH, at=OFF_CENTRE, walls=site, spin=0.45)
    honest.steps(15.0)
    values, x, y = around(honest)
    assert np.mean(values[((x > 0.2) & (x < 2.5)) & ((y > 0.3) & (y < 2.7))[:, None]] < FREE) > 0.95


@pytest.mark.parametrize(("at", "lowest"), [((0.5, 0.5), (0, 0)), ((3.5, 2.0), (12, 5)), ((2.0, 3.7), (5, 12))])
def test_the_map_stays_inside_the_site(at, lowest):
    """4 m are 60 cells of 6.75 cm, the map has 48 a side."""
    robot = Robot(TRUTH, at=(*at, -0.15, 0.0))
    robot.step()
    assert robot.state("map_corner").tolist() == list(lowest)


def test_what_two_sonars_read_alike_to_the_last_code_is_not_believed():
    """One hears the other's ping. A single code apart it is believed, and marks what is not there: a known limit."""
    robot = Robot(TRUTH, at=(2.6, 1.5, -0.15, 0.2), spin=0.0)
    assert robot.steps(3.0)["sonars"][:, 2].all()
    robot.wrong[1] = lambda honest, tick: robot.samples[0].copy()
    told = robot.steps(1.0)
    assert told["sonars"][:2, 2].tolist() == [0.0, 0.0] and not len(marks(told))
    robot.wrong[1] = lambda honest, tick: robot.samples[0] + robot.array.resolution * np.array([0, 0, 1, 0, 0])
    told = robot.steps(1.0)
    assert told["sonars"][:2, 2].tolist() == [1.0, 1.0] and len(marks(told))


# --- what it marks --------------------------------------------------------------------------------------------------


def test_walls_are_not_marked_and_what_nobody_told_of_is():
    disc = Disc((2.4, 1.9), 0.15)
    alone, beside = Robot(TRUTH, at=OFF_CENTRE, spin=0.45), Robot(TRUTH, at=OFF_CENTRE, spin=0.45, shapes=[disc])
    assert not len(marks(alone.steps(16.0)))
    found = marks(beside.steps(16.0))
    assert len(found)
    off = np.hypot(found[:, 0] - 2.4, found[:, 1] - 1.9) - 0.15
    assert np.abs(off).max() < 2 * EDGE and found[:, 2] == pytest.approx(0.8 * EDGE)


def test_a_mover_that_the_station_tells_of_is_not_marked():
    disc = Disc((2.4, 1.9), 0.15)
    message = np.zeros((CONTACTS, 6))
    message[0] = 2.4, 1.9, 0.15, 0.0, 0.0, 1.0
    robot = Robot(TRUTH, at=OFF_CENTRE, spin=0.45, shapes=[disc])
    told = robot.steps(16.0, contacts=message, contacts_fresh=1.0)
    assert not len(marks(told)) and told["contacts"][0, 5] == 1.0


def test_a_known_bias_and_scale_are_taken_off_once():
    robot = Robot(LATE_OVER_A_FLOOR, at=OFF_CENTRE, spin=0.0)
    told = robot.steps(3.0)
    x, _, _, psi = OFF_CENTRE
    rear = (x - HULL * math.cos(psi)) / 1.0  # straight back to x = 0 lies inside the beam
    assert told["sonars"][2, 0] == pytest.approx(rear, abs=2e-3)
    assert told["sonars"][:, 2].all()


def test_what_is_unknown_is_told_with_its_clearance():
    """At first everything beside the hull; of one direction more, where a block tells of its neighbour (0.28 m)."""
    robot = Robot(TRUTH, at=OFF_CENTRE, spin=0.0)
    told = robot.step()["unknown"]
    np.testing.assert_allclose(np.hypot(*told[:, :2].T), 1.0)
    clearance = told[:, 2]
    assert np.all(clearance >= 0) and np.all(clearance < 0.3)
    assert np.all(np.minimum(clearance, np.minimum(np.roll(clearance, 1), np.roll(clearance, -1))) < EDGE)
    robot.spin = robot.nu[3] = 0.45
    assert robot.steps(15.0)["unknown"][:, 2].min() > 0.5


# --- moving obstacles -----------------------------------------------------------------------------------------------


def test_the_water_free_at_the_launch_is_known_once():
    """Nothing is heard: all that is known is the ring that whoever launched it vouches for, and only where it was."""
    quiet = {"fresh": np.zeros(4)}
    for launch in (0.0, 0.5):
        robot = Robot(TRUTH, at=OFF_CENTRE, spin=0.0, launch=launch)
        told = robot.step(**quiet)
        assert abs(told["unknown"][:, 2].min() - launch) < 2 * EDGE
        robot.eta[0] += 0.3
        told = robot.step(**quiet)
        assert abs(told["unknown"][:, 2].min() - max(launch - 0.3, 0.0)) < 2 * EDGE


def test_while_a_sonar_is_silent_every_mark_is_held_further_off():
    robot = Robot(LATE_OVER_A_FLOOR, at=OFF_CENTRE, shapes=[Disc((2.4, 1.9), 0.15)], spin=0.27)
    told = robot.steps(6.0)
    np.testing.assert_allclose(marks(told)[:, 2], 0.8 * EDGE, atol=1e-12)
    robot.wrong[1] = lambda honest, tick: None
    told = robot.steps(1.0)
    np.testing.assert_allclose(marks(told)[:, 2], 0.8 * EDGE + 0.05, atol=1e-12)
    del robot.wrong[1]
    np.testing.assert_allclose(marks(robot.steps(1.0))[:, 2], 0.8 * EDGE, atol=1e-12)


def test_messages_come_late_and_some_never():
    robot = Robot(TRUTH, at=OFF_CENTRE)
    station = robot.equipment.station
    tracker = MoverTracker(dt=DT, slots=CONTACTS)
    message = np.zeros((CONTACTS, 6))
    message[1] = 1.0, 3.0, 0.2, 0.1, -0.2, 1.0
    first = robot.step(contacts=message, contacts_fresh=1.0)
    rows = [told["contacts"][:CONTACTS] for told in (first, *(robot.step() for _ in range(70)))]
    for k, row in enumerate(rows):
        age = station.messages.latency + k * DT
        assert not row[0].any()
        if age > tracker.forget + 0.5 * DT:
            assert not row[1].any()
            continue
        bound = 3 * (station.position_sd + station.velocity_sd * age) + 0.5 * tracker.acceleration * age**2
        expected = 1.0 + 0.1 * age, 3.0 - 0.2 * age, 0.2 + bound, 0.1, -0.2, 1.0
        np.testing.assert_allclose(row[1], expected, atol=1e-9)
    assert rows[50][1].any() and not rows[-1].any()


def test_the_station_s_latency_is_the_equipment_s():
    message = np.zeros((CONTACTS, 6))
    message[0] = 1.0, 3.0, 0.2, 0.1, 0.0, 1.0
    told = Robot(LATE_OVER_A_FLOOR, at=OFF_CENTRE).step(contacts=message, contacts_fresh=1.0)
    assert told["contacts"][0, 0] == pytest.approx(1.05)


# --- cost -----------------------------------------------------------------------------------------------------------


def largest_stack(block):
    """Numbers in the local arrays of the deepest chain of calls of the C text, outputs of the last block included."""

    def below(inner):
        if not isinstance(inner, Routine):
            return sum(size for _, size in inner.outputs) if inner is block else 0
        given = {name for name, _ in inner.inputs}
        own = sum(size for name, size in inner.sizes().items() if name not in given)
        return own + max(below(step.block) for step in inner.steps if not isinstance(step, Gather))

    return below(block)


def test_it_fits_a_small_processor():
    """A Cortex-M4F of 168 MHz, two instructions an operation: two fifths of 50 ms. Its 64 kB beside the main memory
    hold the state and every array, in float32."""
    law = build_law(sonar=True)
    block = law.perception.block
    instructions = 2 * block.operations
    assert instructions * 20 < 0.4 * 168e6
    assert 4 * (law.perception.state.size + largest_stack(block)) <= 64 * 1024
    cells = law.perception.state.port("map_cells").size
    assert 4 * 2 * cells < 32 * 1024  # both copies of the map alone


def test_the_count_of_operations_is_that_of_its_loops():
    """By hand: the map's two passes over its cells dominate, where every block is touched."""
    block = build_law(sonar=True).perception.block
    chart = next(step.block for step in block.steps if step.block.name == "local_map")
    loops = {step.block.name: step for step in chart.steps if isinstance(step, Loop)}
    rows = [step.count * step.block.operations for step in loops.values()]
    assert 0.9 * block.operations < chart.operations
    assert loops["seek_row"].count == loops["change_row"].count == 12
    assert max(rows) < chart.operations


# --- numbers that are none ------------------------------------------------------------------------------------------


def test_a_number_that_is_not_finite_stops_the_robot():
    law, p = build_law(sonar=True), parameters()
    x, u = law.initial_state(), law.inputs.pack({"fix": (1, 1, -0.15), "fix_fresh": 1.0})
    assert law.step(x, u, p).status != NONFINITE
    vectors = {"x": (0, law.state), "u": (1, law.inputs), "p": (2, law.gains)}
    for (at, layout), bad in itertools.product(vectors.values(), (np.nan, np.inf, -np.inf)):
        for port in layout:
            given = [x.copy(), u.copy(), p.copy()]
            given[at][layout.slice(port.name).stop - 1] = bad
            step = law.step(*given)
            assert step.status == NONFINITE, port.name
            np.testing.assert_array_equal(step.tau, np.zeros(4))
            np.testing.assert_array_equal(step.x_next, given[0])


def test_any_finite_numbers_give_finite_ones():
    law, p = build_law(sonar=True), parameters()
    rng = np.random.default_rng(0)
    x = law.initial_state()
    for scale in (1.0, 1e3, 1e6) * 8:
        u = scale * rng.standard_normal(law.inputs.size)
        step = law.step(x, u, p)
        assert step.status != NONFINITE
        assert np.isfinite(step.tau).all() and np.all(np.abs(step.tau) <= [5, 5, 5, 0.5])
        x = step.x_next


def test_cells_are_a_quarter_of_the_hull():
    assert CELLS_A_HULL * EDGE == HULL and OwnState().fixes.latency == pytest.approx(0.1)


@pytest.mark.parametrize(("side", "sense"), [(0.0, 1.0), (1.0, 1.0), (-1.0, -1.0)])
def test_the_beams_sweep_past_a_smooth_obstacle_from_back_to_front(side, sense):
    """An obstacle on the right: the robot turns to the left. The path's side decides if no obstacle is passed."""
    p = {name: ca.SX(value) for name, value in {"spin_limit": 0.5, "spin": 0.2, "depth": -0.15, "k2": 0.4}.items()}
    scan = Scan(ca.SX(), ca.SX(), ca.SX(1), ca.SX(1))
    turning = lower_levels(ca.SX.sym("eta", 4), None, p, scan, ca.SX(side))[1]
    assert float(ca.evalf(turning.reference)) == 0.2 * sense


@pytest.mark.parametrize(("distance", "marked"), [(0.5, True), (0.8, False)])
def test_an_echo_from_the_range_of_the_floor_marks_nothing(distance, marked):
    """A disc ahead of a sonar, which hears the floor, 0.65 m deep, at 0.82 m."""
    disc = Disc((2.0 + HULL + distance + 0.2, 2.0), 0.2)
    robot = Robot(LATE_OVER_A_FLOOR, shapes=[disc], spin=0.0)
    assert bool(len(marks(robot.steps(2.0)))) == marked


@pytest.mark.parametrize(("x", "stays"), [(0.5, True), (2.0, False)])
def test_near_the_start_marks_of_what_was_never_measured_stay_ahead_of_the_robot(x, stays):
    """A disc within the blind range: as the robot comes nearer, every reading is the same."""
    robot = Robot(TRUTH, at=(x, 2.0, -0.15, 0.0), spin=0.0)
    robot.shapes.append(Disc((x + HULL + 0.15 + 0.2, 2.0), 0.2))

    def nearest_ahead():
        values, places, rows = around(robot)
        return places[values[np.abs(rows - 2.0).argmin()] > 0].min()

    robot.steps(2.0)
    first = nearest_ahead()
    for _ in range(10):
        robot.eta[0] += 0.01
        robot.steps(0.4)
    assert nearest_ahead() == first if stays else nearest_ahead() > first
