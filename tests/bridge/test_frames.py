"""Frames and axes: coordinates, the scale of thrust, and what becomes of damaged or foreign messages."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan, pi, radians

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from surctl.errors import InputError
from surctl.marine.bridge.inputs import Inputs, Site, parse_site, yaw_rate
from surctl.marine.bridge.live import parse_address
from surctl.marine.bridge.wire import Attitude, Axes, Beat, Gone, Mapping, Position, Ranges, Reply, Wire, mode_of
from surctl.marine.control import build_law
from surctl.marine.simulation import load_scenario
from surctl.marine.vehicle import load_vehicle
from surctl.marine.vehicle.motion_log import swap_pose
from tests.tools import need_module


def frame(system: int, kind: str, *numbers: object, component: int = 1) -> bytes:
    need_module("pymavlink")
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    out = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
    return bytes(getattr(out, f"{kind}_encode")(*numbers).pack(out))


def test_the_default_site_is_the_project_s_exchange_of_axes() -> None:
    ned = [2.0, 1.0, 0.3, 0.4]
    assert Site().pose(ned) == pytest.approx(swap_pose(ned))


@pytest.mark.parametrize("bearing", [0.0, 90.0, 217.0])
def test_frames_go_there_and_back(bearing: float) -> None:
    site = Site(0.5, 2.5, radians(bearing))
    eta = np.array([3.0, 1.0, -0.2, 0.7])
    assert site.pose(site.to_ned(eta)) == pytest.approx(eta)
    assert site.velocity(site.velocity([0.1, 0.2, 0.3])) == pytest.approx([0.1, 0.2, 0.3])
    along = site.to_ned([1.5, 2.5, 0.0, 0.0])  # one metre along the x axis of {E}, heading along it
    assert np.arctan2(along[1], along[0]) % (2 * pi) == pytest.approx(radians(bearing))
    assert along[3] == pytest.approx(radians(bearing))


def test_the_yaw_rate_is_that_of_the_heading() -> None:
    tilted = yaw_rate(0.0, radians(30), (0.0, 0.0, -0.1))
    assert tilted == pytest.approx(0.1 / np.cos(radians(30)))
    assert yaw_rate(0.0, 0.0, (0.0, 0.0, -0.1)) == pytest.approx(0.1) and np.isnan(yaw_rate(0.0, pi / 2, (0, 0, 1)))


def test_thrust_in_newtons_becomes_sticks() -> None:
    mapping = Mapping.of(load_vehicle("sur540-flooded"), mode_of("manual"))
    tau = np.array([2.5, 1.0, -5.0, 0.1])
    axes = mapping.axes(tau)
    assert (axes.ahead, axes.right, axes.up, axes.clockwise) == pytest.approx((0.5, -0.2, -1.0, -0.2))
    assert mapping.thrust(axes) == pytest.approx(tau)
    level = Mapping.of(load_vehicle("sur540-flooded"), mode_of("alt_hold"), full_rate=0.5)
    axes = level.axes(tau, yaw_rate=0.1)
    assert (axes.ahead, axes.up, axes.clockwise) == pytest.approx((0.5, 0.0, -0.2))
    assert level.axes(100.0 * tau, yaw_rate=-9.0) == Axes(1.0, -1.0, 0.0, 1.0)


def test_a_common_curve_of_the_thrusters_is_undone() -> None:
    vehicle = load_vehicle("bluerov2-thrusters")
    assert vehicle.actuators is not None
    mapping = Mapping.of(vehicle, mode_of("manual"))
    most = vehicle.actuators.most
    axes = mapping.axes(0.5 * most)
    assert axes.ahead == pytest.approx(0.5 * (1.0 - 0.085) + 0.085)  # straight outside the dead band
    assert mapping.thrust(axes) == pytest.approx(0.5 * most)
    assert mapping.axes(1e-6 * most).ahead == pytest.approx(0.085, abs=1e-5) and mapping.axes(0.0 * most).neutral


@pytest.mark.parametrize("bad", [nan, inf, -inf])
@pytest.mark.parametrize("send", ["rc", "manual"])
def test_no_number_that_is_not_finite_becomes_a_command(bad: float, send: str) -> None:
    need_module("pymavlink")
    mapping, wire = Mapping.of(load_vehicle("sur400"), mode_of("alt_hold")), Wire(send=send)
    for axis in range(4):
        tau = np.full(4, 2.0)
        tau[axis] = bad
        assert mapping.axes(tau).neutral
    assert mapping.axes(np.ones(4), yaw_rate=bad).neutral
    for axes in (Axes(bad, bad, bad, bad), Axes(velocity=(bad, 0.0, 0.0), yaw_rate=1.0)):
        sent, neutral = wire.control(axes), Wire(send=send).control(Axes(velocity=axes.velocity and (0.0, 0.0, 0.0)))
        said = [[m.to_dict() for m in Wire().parse(each)] for each in (b"".join(sent), b"".join(neutral))]
        assert said[0] == said[1]


def test_axes_become_channels_and_manual_control() -> None:
    need_module("pymavlink")
    axes = Axes(0.5, -0.25, 1.0, -1.0)
    (rc,) = Wire().parse(Wire().control(axes)[0])
    assert (rc.chan5_raw, rc.chan6_raw, rc.chan3_raw, rc.chan4_raw) == (1700, 1400, 1900, 1100)
    assert (rc.chan1_raw, rc.chan2_raw, rc.chan7_raw, rc.chan8_raw, rc.chan9_raw) == (1500, 1500, 65535, 65535, 0)
    (manual,) = Wire().parse(Wire(send="manual").control(axes)[0])
    assert (manual.x, manual.y, manual.z, manual.r, manual.buttons) == (500, -250, 1000, -1000, 0)
    guided = Wire().parse(b"".join(Wire().control(Axes(velocity=(0.1, 0.2, 0.0), yaw_rate=0.3))))
    assert guided[1].vx == pytest.approx(0.1) and guided[1].type_mask & 0b100000111 == 0b100000111


def test_messages_become_events() -> None:
    wire = Wire()
    told = [
        *wire.events(frame(1, "heartbeat", 12, 3, 129, 2, 4)),
        *wire.events(frame(1, "attitude", 5000, 0.0, 0.0, 0.5, 0.0, 0.0, 0.25)),
        *wire.events(frame(1, "local_position_ned", 5000, 1.0, 2.0, 0.5, 0.25, 0.0, 0.0)),
        *wire.events(frame(11, "local_position_ned", 7000, nan, nan, nan, nan, nan, nan)),
        *wire.events(frame(1, "distance_sensor", 5000, 20, 450, 100, 1, 0, 2, 255)),
        *wire.events(frame(1, "distance_sensor", 5000, 20, 450, 450, 1, 0, 6, 255)),
        *wire.events(frame(1, "timesync", 5_000_000_000, 9_000_000_064)),
    ]
    assert told[0] == Beat(True, 2, True)
    assert told[1] == Attitude(5.0, 0.0, 0.0, 0.5, (0.0, 0.0, 0.25))
    assert told[2] == Position(1, 5.0, (1.0, 2.0, 0.5), (0.25, 0.0, 0.0)) and told[3] == Gone(11)
    assert told[4] == Ranges(5.0, ((-pi / 2, 1.0),)) and told[5] == Ranges(5.0, ((-3 * pi / 2, inf),))
    assert isinstance(told[6], Reply) and told[6].boot == 5.0 and wire.bad == 0


def test_other_computers_of_the_vehicle_have_clocks_of_their_own() -> None:
    need_module("pymavlink")
    wire = Wire()
    other = wire.mav.MAVLink(None, srcSystem=1, srcComponent=194)  # a sonar's computer, switched on 900 s before
    boxes = [100] + [65535] * 71
    sent = [
        other.distance_sensor_encode(905_000, 20, 450, 100, 1, 0, 2, 255),
        other.obstacle_distance_encode(1_700_000_000_000_000, 1, boxes, 10, 20, 450, 0.0, 90.0, 12),
        other.local_position_ned_encode(905_000, 1.0, 2.0, 0.5, 0.0, 0.0, 0.0),
        other.attitude_encode(905_000, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0),
        other.timesync_encode(905_000_000_000, 9_000_000_064),
    ]
    told = [event for message in sent for event in wire.events(message.pack(other))]
    assert told == [Ranges(None, ((-pi / 2, 1.0),))] * 2


def test_a_moving_obstacle_keeps_its_radius_when_another_leaves() -> None:
    scenario, radii = load_scenario("tank-moving"), iter((1.5, 0.25))
    moving = [o.model_copy(update={"radius_m": next(radii)}) for o in scenario.obstacles if o.shape == "moving"]
    vehicle = load_vehicle("sur540-flooded")
    inputs = Inputs(build_law("closed_form"), replace(scenario, obstacles=tuple(moving)), vehicle, Site())

    def heard(system: int) -> None:
        inputs.obstacle(Position(system, 1.0, (0.0, float(system), 0.0), (0.0, 0.0, 0.0)), 1.0)

    def radius() -> float:
        return float(inputs._rows(1.0, np.array([20.0, 0.0, 0.0, 0.0]), still=False)[0, 2])

    heard(21), heard(12)
    assert radius() == 0.25
    inputs.gone(12)
    assert radius() == 0.25
    heard(30)
    assert radius() == 1.5, "three systems, two obstacles: which is which is unknown"


def test_odometry_and_many_distances_are_read() -> None:
    wire = Wire()
    half = radians(15)  # of the pitch: bow up, ahead to the east
    q = (Rotation.from_euler("z", 90, degrees=True) * Rotation.from_euler("y", 2 * half)).as_quat(scalar_first=True)
    pose = (1.0, 2.0, 0.5, q.tolist(), 0.25, 0.0, 0.0, 0.0, 0.0, 0.5, [0.0] * 21, [0.0] * 21)
    position, attitude = wire.events(frame(1, "odometry", 5_000_000, 1, 12, *pose))
    assert isinstance(position, Position) and position[:3] == (1, 5.0, (1.0, 2.0, 0.5))
    assert position.velocity == pytest.approx((0.0, 0.25 * np.cos(2 * half), -0.125))
    assert attitude == Attitude(5.0, *map(pytest.approx, (0.0, 2 * half, pi / 2)), rates=(0.0, 0.0, 0.5))
    assert wire.events(frame(1, "odometry", 5_000_000, 0, 12, *pose)) == [], "another frame is not taken for NED"
    distances = [100, 500, 65535] + [65535] * 69
    (ranges,) = wire.events(frame(1, "obstacle_distance", 5_000_000, 1, distances, 10, 20, 450, 0.0, 90.0, 12))
    assert ranges.rays == ((-pi / 2, 1.0), (-radians(100.0), inf))


def test_a_sensor_that_points_down_or_nowhere_is_no_sonar_ahead() -> None:
    wire, half = Wire(), 0.5**0.5
    for q, azimuths in (
        ([half, 0.0, 0.0, half], [-pi / 2]),  # to starboard
        ([0.0, 0.0, 0.0, 0.0], []),  # MAVLink: 0 if invalid
        ([half, 0.0, -half, 0.0], []),  # down
        ([half, 0.0, half, 0.0], []),
    ):
        events = wire.events(frame(1, "distance_sensor", 5000, 20, 450, 100, 1, 0, 100, 255, 0.0, 0.0, q, 0))
        assert [event.rays[0][0] for event in events] == pytest.approx(azimuths, abs=1e-6), q


def test_foreign_and_invalid_messages_change_nothing() -> None:
    wire = Wire()
    assert wire.events(frame(2, "heartbeat", 12, 3, 129, 2, 4)) == []
    assert wire.events(frame(1, "heartbeat", 6, 8, 129, 2, 4, component=190)) == [], "a ground station"
    assert wire.events(frame(1, "heartbeat", 12, 12, 129, 2, 4)) == [Beat(True, 2, False)], "PX4"
    assert wire.events(frame(1, "attitude", 5000, 0.0, 0.0, nan, 0.0, 0.0, 0.0)) == [] and wire.bad == 1
    assert wire.events(frame(1, "local_position_ned", 5000, 1.0, inf, 0.5, 0.0, 0.0, 0.0)) == [] and wire.bad == 2
    assert wire.events(frame(1, "timesync", 5_000_000_000, 9_000_000_000)) == [], "the reply to another's request"


def test_a_cut_or_damaged_frame_does_not_swallow_the_next() -> None:
    wire, good = Wire(), frame(1, "heartbeat", 12, 3, 129, 2, 4)
    rng = np.random.default_rng(0)
    for k in range(300):
        damaged = bytearray(good)
        damaged[int(rng.integers(len(good)))] ^= int(rng.integers(1, 256))
        wire.events(bytes(damaged[: 1 + k % len(good)]) if k % 2 else bytes(damaged))
        assert wire.events(good) == [Beat(True, 2, True)], k
    wire.events(rng.integers(0, 256, 2000, dtype=np.uint8).tobytes())
    assert wire.events(good) == [Beat(True, 2, True)] and wire.bad > 200


@pytest.mark.parametrize("text", ["0,0", "a,b,c", "0,0,nan", "", "1,2,3,4"])
def test_a_wrong_origin_is_one_line(text: str) -> None:
    with pytest.raises(InputError, match="X,Y,DEG"):
        parse_site(text)


@pytest.mark.parametrize("text", ["tcp:127.0.0.1:1", "udp:127.0.0.1", "udp:127.0.0.1:0", "udp::99", "udp:h:99999999"])
def test_a_wrong_address_is_one_line(text: str) -> None:
    with pytest.raises(InputError, match="--mavlink"):
        parse_address(text)
