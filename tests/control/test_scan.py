"""The law that scans: when it stands, what bounds its speed, how fast it turns."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from surctl.ir import Layout
from surctl.marine.control import build_law
from surctl.marine.control.ports import PARAMETERS, SECTORS, YAW_SHARE
from surctl.marine.guidance import Path
from surctl.marine.sensing import Equipment
from surctl.marine.vehicle import LIBRARY, Parameter, load_vehicle
from tests.control.robot import CONTACTS, HULL, known, parameters

WIDE_OPEN = (-50.0, 50.0, -48.0, 52.0)  # the path in its middle
BEARINGS = 2 * np.pi * np.arange(SECTORS) / SECTORS
CRUISE = 0.2


def law(**kwargs):
    return build_law(sonar=True, contacts=CONTACTS, equipment=Equipment(own=None), **kwargs)


def decided(*, unknown=None, healthy=1.0, placed=1.0, contacts=(), nu=(0, 0, 0, 0), walls=WIDE_OPEN, **more):
    """What the decision gives of what it is told: the horizontal velocity in {E}, yaw rate, and telemetry by name.

    The robot stands at the start of its path along x. `unknown`: (SECTORS,) clearances [m], far unless given;
    `contacts`: {row: x, y, radius, vx, vy}; `more`: psi, at, progress, or gains.
    """
    made, psi, at, progress = law(), more.pop("psi", 0.0), more.pop("at", (0.5, 2.0)), more.pop("progress", 0.0)
    told = made.perception.outputs
    rows = np.zeros((CONTACTS + SECTORS, 6))
    for row, contact in dict(contacts).items():
        rows[row] = *contact, 1.0
    away = np.full(SECTORS, 100.0) if unknown is None else np.asarray(unknown, dtype=float)
    n = made.perception.outputs.port("sonars").shape[0]
    axes = psi + np.arange(n) * np.pi / 2
    heard = np.column_stack(
        [np.full((n, 2), 1.0), np.broadcast_to(healthy, n), np.zeros(n), np.cos(axes), np.sin(axes)]
    )
    u = told.pack(
        {
            "eta": (*at, -0.15, psi),
            "nu": nu,
            "contacts": rows,
            "unknown": np.column_stack([np.cos(BEARINGS), np.sin(BEARINGS), away]),
            "sonars": heard,
            "placed": placed,
        }
    )
    ports = [port for port in made.state if port.name not in {p.name for p in made.perception.state}]
    x = Layout(tuple(ports)).pack({"progress": progress})
    tau, _, _, telemetry = (np.array(v).ravel() for v in made.function(x, u, parameters(walls, **more)))
    seen = made.outputs.unpack(np.concatenate([tau, telemetry]))
    c, s = math.cos(psi), math.sin(psi)
    wanted = seen["nu_reference"]
    return np.array([c * wanted[0] - s * wanted[1], s * wanted[0] + c * wanted[1]]), wanted[3], seen


def stops_within(clearance):
    """Largest speed from which it stops within a clearance [m], by hand: v t + v²/(2a) = clearance."""
    gains, vehicle = known()
    a, t = gains["brake"] * 5.0 / vehicle["m11"], gains["reaction"]
    return -a * t + math.sqrt((a * t) ** 2 + 2 * a * max(clearance, 0.0))


# --- it stands ------------------------------------------------------------------------------------------------------


def test_alone_in_what_it_knows_it_goes_along_its_path_and_turns():
    velocity, rate, seen = decided()
    np.testing.assert_allclose(velocity, [CRUISE, 0.0], atol=1e-9)
    assert seen["stopped"][0] == 0 and seen["healthy"].all()
    assert rate == pytest.approx(load_vehicle("sur540-flooded").steady_yaw(YAW_SHARE))


@pytest.mark.parametrize("clearance", [0.0, -0.3])
def test_it_stands_where_nothing_is_known(clearance):
    velocity, rate, seen = decided(unknown=np.full(SECTORS, clearance))
    assert np.abs(velocity).max() < 1e-9 and seen["stopped"][0] == 1.0 and rate > 0.1


def test_it_stands_while_every_sonar_is_deaf():
    velocity, rate, seen = decided(healthy=0.0)
    assert np.abs(velocity).max() == 0.0 and seen["stopped"][0] == 1.0 and rate > 0.1
    assert seen["healthy"].tolist() == [0.0] * 4


def test_it_stands_while_it_does_not_know_where_it_is():
    velocity, _, seen = decided(placed=0.0)
    assert np.abs(velocity).max() == 0.0 and seen["stopped"][0] == 1.0


def test_one_sonar_that_hears_is_enough_to_grope():
    """Half the cruise speed along the axis of one that is not to be believed; the others' are free."""
    for deaf in range(4):
        healthy = np.ones(4)
        healthy[deaf] = 0.0
        velocity, _, seen = decided(healthy=healthy)
        assert velocity[0] == pytest.approx(CRUISE * (0.5 if deaf == 0 else 1.0)) and seen["stopped"][0] == 0
    velocity, _, _ = decided(healthy=[1.0, 0.0, 0.0, 0.0])
    assert velocity[0] == pytest.approx(CRUISE)


def test_at_its_target_it_is_not_halted():
    """It has no wish to go on: standing is then not for want of knowledge."""
    for placed in (0.0, 1.0):
        velocity, _, seen = decided(placed=placed, at=(3.5, 2.0), progress=3.0)
        assert np.hypot(*velocity) < 1e-9 and seen["stopped"][0] == (placed == 0.0)


# --- the whole law at its start -------------------------------------------------------------------------------------


# --- what bounds its speed ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("clearance", [0.02, 0.1, 0.25])
def test_an_unknown_place_ahead_bounds_its_speed(clearance):
    away = np.full(SECTORS, 100.0)
    away[0] = clearance
    velocity, _, seen = decided(unknown=away)
    assert velocity[0] == pytest.approx(min(CRUISE, stops_within(clearance))) and velocity[0] < CRUISE
    assert abs(velocity[1]) < 1e-9 and seen["stopped"][0] == (velocity[0] < 0.01)


def test_an_unknown_place_aside_bounds_the_speed_towards_it_alone():
    away = np.full(SECTORS, 100.0)
    away[2] = 0.05  # at 45 degrees to the left
    velocity, _, _ = decided(unknown=away)
    towards = velocity @ [math.cos(BEARINGS[2]), math.sin(BEARINGS[2])]
    assert towards == pytest.approx(stops_within(0.05))
    assert abs(velocity[1]) < 1e-9  # slower: the way past it would lead off the path faster than can be stopped
    away[2], away[8], away[4], away[10] = 100.0, 0.0, 0.0, 0.0  # behind, and square to its course
    velocity, _, _ = decided(unknown=away)
    assert velocity[0] == pytest.approx(CRUISE)


@given(st.lists(st.floats(-0.2, 3.0), min_size=SECTORS, max_size=SECTORS), st.floats(-3, 3))
def test_whatever_is_unknown_every_bound_is_kept(away, psi):
    velocity, _, _ = decided(unknown=away, psi=psi)
    along = np.column_stack([np.cos(BEARINGS), np.sin(BEARINGS)]) @ velocity
    assert np.all(along <= np.array([stops_within(c) for c in away]) + 1e-6)


@given(st.floats(-math.pi, math.pi), st.floats(0.03, 1.0), st.integers(0, SECTORS - 1))
def test_a_mark_bounds_the_speed_towards_it(bearing, clearance, row):
    """By its braking distance less the margin; nearer than that it backs off, slowly."""
    away = HULL + 0.054 + clearance
    at = 0.5 + away * math.cos(bearing), 2.0 + away * math.sin(bearing)
    velocity, _, _ = decided(contacts={CONTACTS + row: (*at, 0.054, 0.0, 0.0)})
    margin = known()[0]["margin"]
    towards = velocity @ [math.cos(bearing), math.sin(bearing)]
    assert towards <= stops_within(clearance - margin) + 2e-3
    if clearance < margin:  # as it moves off the command goes down to the speed itself, 0.05 m/s
        off = -0.05 * np.array([math.cos(bearing), math.sin(bearing)])
        moving, _, _ = decided(contacts={CONTACTS + row: (*at, 0.054, 0.0, 0.0)}, nu=(*off, 0, 0))
        least = min(-0.05, CRUISE * math.cos(bearing))
        assert towards < 0 and moving @ [math.cos(bearing), math.sin(bearing)] >= least - 1e-6


def test_only_a_mover_that_comes_too_near_drives_it_into_the_unknown():
    """A mark nearer than the margin does not."""
    away = np.full(SECTORS, 100.0)
    away[0] = 0.05
    beside = 0.5, 2.0 + HULL + 0.054 + 0.03, 0.054, 0.0, 0.0
    velocity, _, _ = decided(unknown=away, contacts={CONTACTS: beside})
    assert velocity[0] <= stops_within(0.05) + 1e-6 and velocity[1] < 0
    behind = 0.5 - HULL - 0.27 - 0.15, 2.0, 0.27, 0.2, 0.0
    velocity, _, _ = decided(unknown=away, contacts={0: behind})
    assert velocity[0] > 0.15


def test_it_is_braked_more_where_it_is_faster_than_a_bound():
    away = np.full(SECTORS, 100.0)
    away[0] = 0.02
    slow, fast = (decided(unknown=away, nu=(v, 0, 0, 0))[0][0] for v in (0.0, 0.2))
    assert slow == pytest.approx(stops_within(0.02))
    assert fast == pytest.approx(max(slow - 4.0 * (0.2 - slow), -0.22))


def test_walls_are_kept_whatever_the_braking_asks():
    """Braked away from what is unknown ahead, it is not driven into the wall astern."""
    away = np.full(SECTORS, 100.0)
    away[0] = 0.0
    velocity, _, _ = decided(unknown=away, nu=(0.2, 0, 0, 0), walls=(0.5 - HULL - 0.06, 50.0, -50.0, 50.0))
    assert velocity[0] >= -stops_within(0.06 - 0.05) - 1e-9


# --- how fast it turns ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spin", [0.0, 0.1, 0.45, 2.0])
def test_it_turns_as_fast_as_the_gain_says_and_the_thrust_holds(spin):
    limit = load_vehicle("sur540-flooded").steady_yaw(YAW_SHARE)
    assert parameters()[PARAMETERS.slice("spin_limit")] == pytest.approx(limit)
    assert decided(spin=spin)[1] == pytest.approx(min(spin, limit))


@pytest.mark.parametrize(
    ("floor", "ceiling", "side"), [(1.0, 4.0, 1), (1.0, 3.0, 1), (0.9, 3.0, 1), (0.0, 3.0, -1), (-46.0, 3.0, -1)]
)
@pytest.mark.parametrize("spin", [0.1, 2.0])
def test_it_turns_to_the_side_where_the_site_has_more_room(floor, ceiling, side, spin):
    """The path lies at y = 2 m; both senses as fast, whether gain or thrust decides."""
    limit = load_vehicle("sur540-flooded").steady_yaw(YAW_SHARE)
    walls = (0.0, 4.0, floor, ceiling)
    assert parameters(walls)[PARAMETERS.slice("spin_limit")] == pytest.approx(side * limit)
    assert decided(walls=walls, spin=spin)[1] == pytest.approx(side * min(spin, limit))


@given(st.floats(-3.0, 3.0), st.floats(-np.pi, np.pi), st.floats(-0.9, 0.9))
def test_in_a_mirrored_site_it_turns_the_other_way(across, turn, beside):
    """Whichever way the path points, unless it goes through the middle."""
    assume(abs(beside) > 0.11)
    leg = np.array([np.cos(turn), np.sin(turn)])
    aside = np.array([-leg[1], leg[0]])
    middle = np.array([across, 1.0])
    start = middle - beside * aside - 0.5 * leg
    walls = (middle[0] - 2.0, middle[0] + 2.0, middle[1] - 3.0, middle[1] + 3.0)
    mirror = np.array([1.0, -1.0])
    sides = [
        np.sign(parameters(site, path=Path(np.array([at, at + way])))[PARAMETERS.slice("spin_limit")][0])
        for site, at, way in (
            (walls, start, leg),
            ((*walls[:2], -walls[3], -walls[2]), mirror * start, mirror * leg),
        )
    ]
    assert sides == [np.sign(beside), -np.sign(beside)]


ENDS = st.floats(0.0, 1.0)


DAMPED = [
    name for name in sorted(path.stem for path in LIBRARY.glob("*.toml")) if load_vehicle(name).drag_at(0.0)[3] > 0
]
"""Vehicles whose yaw is damped at rest too."""


@given(st.sampled_from(DAMPED), st.floats(0.05, 1.0), ENDS, ENDS, ENDS)
def test_the_steady_yaw_is_held_anywhere_in_the_ranges(name, share, thrust, linear, quadratic):
    """Drag at that rate is at most the share of the thrust, whatever the vehicle is; at the worst just so much."""
    vehicle = load_vehicle(name)
    rate = vehicle.steady_yaw(share)

    def between(key, part):
        known = vehicle.parameters[key].range or (vehicle[key], vehicle[key])
        return known[0] + part * (known[1] - known[0])

    def left(thrust, linear, quadratic):
        drag = between("Nr", linear) * rate + between("Nrr", quadratic) * rate * rate
        return share * between("Fr_max", thrust) - drag

    assert rate > 0 and left(thrust, linear, quadratic) >= -1e-12
    assert left(0.0, 1.0, 1.0) == pytest.approx(0.0, abs=1e-12)
    assert vehicle.steady_yaw(0.5 * share) < rate


def test_without_quadratic_drag_it_is_linear():
    vehicle = load_vehicle("sur540-flooded")
    known = {"Nrr": 0.0, "Nr": 0.5, "Fr_max": 0.4}
    plain = {k: Parameter(known[k], p.unit, None, "") if k in known else p for k, p in vehicle.parameters.items()}
    assert replace(vehicle, parameters=plain).steady_yaw(0.85) == pytest.approx(0.85 * 0.4 / 0.5)
