"""MAVLink frames: messages that count or are ignored, modes, thrust to stick axes (needs pymavlink).

Thrust is sent as RC_CHANNELS_OVERRIDE by default. ArduSub multiplies the axes of MANUAL_CONTROL by the pilot's gain,
which a button changes while the vehicle swims, so that a thrust in newtons would have no fixed deflection; an override
of the channels has no gain. Both count as pilot input, whose loss ArduSub notices after FS_PILOT_TIMEOUT. Velocity
targets (mode guided) stop after 3 s by themselves, so neutral channels go with them, which ArduSub supervises sooner.

ArduSub maps a stick deflection to motor outputs linearly. The deflection n of an axis is found from the thrust F and
the largest thrust F_max of the axis in the vehicle file (astern: the largest thrust astern). Without thrusters in the
file, n = F / F_max. If all thrusters of the file have one curve f from command to share of the largest force, then
n = f⁻¹(F / F_max), which is exact while one axis acts alone; a small thrust begins at the edge of the dead band.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import atan2, isfinite, pi, radians
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from surctl.errors import ToolMissing, check_known, check_number
from surctl.marine.vehicle import Thruster, Vehicle
from surctl.marine.vehicle.motion_log import roll_pitch_heading


class Beat(NamedTuple):
    """Heartbeat of the autopilot: whether it is armed, the number of its mode, and whether it is an ArduSub."""

    armed: bool
    mode: int
    sub: bool


class Position(NamedTuple):
    """Position (3,) [m] and velocity (3,) [m/s] in NED of a system, at the time `boot` [s] since its start."""

    system: int
    boot: float
    place: tuple[float, float, float]
    velocity: tuple[float, float, float]


class Gone(NamedTuple):
    """A moving obstacle has left the water: its system reports a position that is no number."""

    system: int


class Attitude(NamedTuple):
    """Roll, pitch, yaw [rad] of FRD in NED, and the rates (3,) [rad/s] in FRD, at `boot` [s]."""

    boot: float
    roll: float
    pitch: float
    yaw: float
    rates: tuple[float, float, float]


class Ranges(NamedTuple):
    """Distances [m] from the hull by direction: (azimuth in {B} [rad], counter-clockwise from forward; distance).

    The distance is inf for a direction without an echo. Directions without a measurement are left out. `boot` is the
    time of the measurement since the autopilot's start [s]; None if the sender has another clock.
    """

    boot: float | None
    rays: tuple[tuple[float, float], ...]


class Reply(NamedTuple):
    """Reply to a TIMESYNC request: the time of the request on the bridge's clock, and of the reply since start [s]."""

    sent: float
    boot: float


class Text(NamedTuple):
    """A text of the autopilot for the operator, with its severity (0: emergency, 7: debug)."""

    severity: int
    text: str


Event: TypeAlias = Beat | Position | Gone | Attitude | Ranges | Reply | Text


Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Mode:
    """A mode of ArduSub in which the bridge can steer.

    Attributes:
        name: name for options.
        number: ArduSub's number of the mode (`custom_mode` of its heartbeat).
        thrust: axes that are thrusts, as indices of surge, sway, heave, yaw.
        rate: whether the yaw axis is a yaw rate.
        what: who controls what.
    """

    name: str
    number: int
    thrust: tuple[int, ...]
    rate: bool
    what: str


MODES: dict[str, Mode] = {
    "alt_hold": Mode("alt_hold", 2, (0, 1), True, "surge and sway by thrust, yaw rate; the autopilot holds its depth"),
    "manual": Mode("manual", 19, (0, 1, 2, 3), False, "all four axes by thrust; nothing holds roll and pitch"),
    "guided": Mode("guided", 4, (), True, "velocity and yaw rate; the autopilot controls all axes"),
}
"""Modes by name. In `alt_hold` the heave stick is neutral: the operator brings the vehicle to the mission's depth."""


def mode_of(name: str) -> Mode:
    """Return a mode by name; InputError if there is no such mode."""
    check_known(name, MODES, key="--mode")
    return MODES[name]


@dataclass(frozen=True)
class Axes:
    """Deflections in [−1, 1]: ahead, to the right, upwards, and clockwise seen from above (the signs of ArduSub).

    In the mode `guided`, `velocity` (3,) is the desired velocity in NED [m/s] and `yaw_rate` the yaw rate clockwise
    [rad/s]; else it is None.
    """

    ahead: float = 0.0
    right: float = 0.0
    up: float = 0.0
    clockwise: float = 0.0
    velocity: tuple[float, float, float] | None = None
    yaw_rate: float = 0.0

    @property
    def neutral(self) -> bool:
        """Whether every deflection and every velocity is 0."""
        return not any((self.ahead, self.right, self.up, self.clockwise, self.yaw_rate, *(self.velocity or ())))


@dataclass(frozen=True, eq=False)
class Mapping:
    """Maps the law's outputs to stick axes for one vehicle and mode.

    Attributes:
        mode: the autopilot's mode.
        limits: least and largest thrust (2, 4) [N, N m] in surge, sway, heave, yaw.
        thruster: a thruster whose curve, as shares of its largest force, is that of all thrusters; None: linear.
        full_rate: yaw rate [rad/s] at full deflection, 45° times ArduSub's parameter ACRO_YAW_P.

    Example:
        >>> from surctl.marine.bridge.wire import Mapping, mode_of
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mapping = Mapping.of(load_vehicle("sur540-flooded"), mode_of("alt_hold"))
        >>> mapping.axes([2.5, 1.0, 0.0, 0.1], yaw_rate=0.1)  # N, N, N, N m; rad/s
        Axes(ahead=0.5, right=-0.2, up=0.0, clockwise=-0.127..., velocity=None, yaw_rate=0.0)
    """

    mode: Mode
    limits: Vector
    thruster: Thruster | None = None
    full_rate: float = radians(45.0)

    @classmethod
    def of(cls, vehicle: Vehicle, mode: Mode, *, full_rate: float = radians(45.0)) -> Mapping:
        """Return the mapping for a vehicle.

        Raises:
            InputError: the full yaw rate is not a positive number.
        """
        check_number("full_rate", full_rate, unit="rad/s")
        limits = vehicle.thrust_range
        if vehicle.actuators is not None:
            limits = np.array([-vehicle.actuators.most, vehicle.actuators.most])
        return cls(mode, limits, _common(vehicle), full_rate)

    def axes(self, tau: Vector, *, yaw_rate: float = 0.0) -> Axes:
        """Return the stick axes of a thrust (4,) [N, N m] in {B}, and of a yaw rate [rad/s] for modes that take it.

        A number that is not finite makes every axis neutral.
        """
        numbers = [*(float(v) for v in tau), float(yaw_rate)]
        if not all(map(isfinite, numbers)):
            return Axes()
        sticks = [self._stick(axis, numbers[axis]) if axis in self.mode.thrust else 0.0 for axis in range(4)]
        if self.mode.rate:
            sticks[3] = _stick(yaw_rate / self.full_rate)
        ahead, left, up, turn = sticks
        return Axes(ahead, 0.0 - left, up, 0.0 - turn)

    def thrust(self, axes: Axes) -> Vector:
        """Return the thrust (4,) [N, N m] of stick axes, as the motors give it; 0 on axes that are not thrusts."""
        sticks = (axes.ahead, -axes.right, axes.up, -axes.clockwise)
        return np.array([self._force(k, n) if k in self.mode.thrust else 0.0 for k, n in enumerate(sticks)])

    def _stick(self, axis: int, force: float) -> float:
        largest = float(self.limits[1, axis] if force > 0 else -self.limits[0, axis])
        if largest <= 0.0:
            return 0.0
        share = _stick(force / largest)
        one = self.thruster
        return share if one is None else one.command(share * (one.forward if share > 0 else one.reverse))

    def _force(self, axis: int, stick: float) -> float:
        one, share = self.thruster, stick
        if one is not None:
            force = one.force(stick)
            share = force / (one.forward if force > 0 else one.reverse)
        return share * float(self.limits[1, axis] if share > 0 else -self.limits[0, axis])


def _common(vehicle: Vehicle) -> Thruster | None:
    # a thruster that stands for all; None if they differ, or if one pushes in one direction only, swivels or is a fin
    thrusters = vehicle.actuators.thrusters if vehicle.actuators is not None else ()
    if not thrusters or any(t.reverse <= 0.0 or t.fin is not None or t.swivel is not None for t in thrusters):
        return None
    shapes = [[(c, round(f / (t.forward if f > 0 else t.reverse), 9)) for c, f in t.curve] for t in thrusters]
    return thrusters[0] if all(shape == shapes[0] for shape in shapes) else None


Send = Literal["rc", "manual"]
SENDS: tuple[Send, ...] = get_args(Send)

_ARDUPILOT, _SUBMARINE, _NO_AUTOPILOT, _COMPUTER = 3, 12, 8, 18
_ARMED, _OWN_MODES = 128, 1
_AUTOPILOT, _BRIDGE = 1, 191  # components
_INTERVAL = 511  # MAV_CMD_SET_MESSAGE_INTERVAL, the only command that the bridge ever sends
_HEARTBEAT, _STREAMED = 0, (30, 32)  # ATTITUDE, LOCAL_POSITION_NED
_IGNORED = 65535
_VELOCITY_AND_RATE = 0b010111000111
_EPOCH = 1e9  # [s] a time beyond it counts from 1970, not from the start of the autopilot
_MARK = 64  # ns: requests of the bridge end with it, so that replies to others are not taken for its own


def dialect() -> Any:
    """Return pymavlink's module of the messages of ArduPilot.

    Raises:
        ToolMissing: pymavlink is not installed.
    """
    try:
        return importlib.import_module("pymavlink.dialects.v20.ardupilotmega")
    except ImportError:
        problem = "needs the package pymavlink, which is not installed"
        raise ToolMissing(problem, key="--mavlink", remedy="install it: pip install 'surctl[field]'") from None


class Parser:
    """Decoder of datagrams, each of which holds whole frames."""

    def __init__(self) -> None:
        self._mav = dialect()
        self._begin()

    def _begin(self) -> None:
        self._in = self._mav.MAVLink(None)
        self._in.robust_parsing = True

    def parse(self, data: bytes) -> tuple[list[Any], int]:
        """Return the valid messages in a datagram, and the number of invalid pieces."""
        before = self._in.total_receive_errors
        try:
            messages = self._in.parse_buffer(data) or []
        except Exception:  # a decoder of pymavlink that fails on a frame with a valid checksum
            self._begin()
            return [], 1
        bad = self._in.total_receive_errors - before
        if self._in.buf_len():  # the rest of a cut frame must not swallow the frames of the next datagram
            self._in.buf, self._in.buf_index = bytearray(), 0
            bad += 1
        return [message for message in messages if message.get_type() != "BAD_DATA"], bad


class Wire:
    """Encoder and decoder for one autopilot.

    Attributes:
        target: system id of the autopilot.
        system: system id of the bridge; ArduSub accepts control from its SYSID_MYGCS alone (255 by default).
        send: message for thrust, "rc" (RC_CHANNELS_OVERRIDE) or "manual" (MANUAL_CONTROL).
        bad: number of bytes and messages that were not valid.
    """

    def __init__(self, *, target: int = 1, system: int = 255, send: Send | str = "rc") -> None:
        check_known(send, SENDS, key="--send")
        self.target, self.system, self.send, self.bad = target, system, send, 0
        self.mav = dialect()
        self._out = self.mav.MAVLink(None, srcSystem=system, srcComponent=_BRIDGE)
        self._parser = Parser()
        self._decoders: dict[str, Callable[[Any], Iterator[Event]]] = {
            "HEARTBEAT": self._beat,
            "LOCAL_POSITION_NED": self._position,
            "ATTITUDE": self._attitude,
            "ODOMETRY": self._odometry,
            "DISTANCE_SENSOR": self._distance,
            "OBSTACLE_DISTANCE": self._distances,
            "TIMESYNC": self._reply,
            "STATUSTEXT": self._text,
        }

    def parse(self, data: bytes) -> list[Any]:
        """Return the valid messages in a datagram; other bytes are counted in `bad`."""
        messages, bad = self._parser.parse(data)
        self.bad += bad
        return messages

    def events(self, data: bytes) -> list[Event]:
        """Return the events in a datagram; messages with numbers that are not finite are counted in `bad`."""
        events: list[Event] = []
        for message in self.parse(data):
            decode = self._decoders.get(message.get_type())
            if decode is not None:
                events += decode(message)
        return events

    def _own(self, message: Any) -> bool:
        return bool(message.get_srcSystem() == self.target)

    def _autopilot(self, message: Any) -> bool:
        # other computers of the vehicle share the system id, but have clocks and frames of their own
        return self._own(message) and bool(message.get_srcComponent() == _AUTOPILOT)

    def _boot(self, message: Any, time: float) -> float | None:
        # time since start of the autopilot [s]; None: on another clock, or since 1970
        return time if self._autopilot(message) and time < _EPOCH else None

    def _beat(self, m: Any) -> Iterator[Event]:
        if self._autopilot(m) and m.autopilot != _NO_AUTOPILOT:
            sub = m.autopilot == _ARDUPILOT and m.type == _SUBMARINE and bool(m.base_mode & _OWN_MODES)
            yield Beat(bool(m.base_mode & _ARMED), int(m.custom_mode), sub)

    def _position(self, m: Any) -> Iterator[Event]:
        numbers = (m.x, m.y, m.z, m.vx, m.vy, m.vz)
        system = m.get_srcSystem()
        if self._own(m) and not self._autopilot(m):
            return
        if all(map(isfinite, numbers)):
            yield Position(system, m.time_boot_ms * 1e-3, numbers[:3], numbers[3:])
        elif system != self.target and not isfinite(m.x) and not isfinite(m.y):
            yield Gone(system)
        else:
            self.bad += 1

    def _attitude(self, m: Any) -> Iterator[Event]:
        numbers = (m.roll, m.pitch, m.yaw, m.rollspeed, m.pitchspeed, m.yawspeed)
        if self._autopilot(m) and self._finite(numbers):
            yield Attitude(m.time_boot_ms * 1e-3, *numbers[:3], numbers[3:])

    def _odometry(self, m: Any) -> Iterator[Event]:
        numbers = (m.x, m.y, m.z, *m.q, m.vx, m.vy, m.vz, m.rollspeed, m.pitchspeed, m.yawspeed)
        local_ned, body_frd = 1, (8, 12)
        boot = self._boot(m, m.time_usec * 1e-6)
        if boot is None or m.frame_id != local_ned or m.child_frame_id not in body_frd:
            return
        if self._finite(numbers) and abs(sum(v * v for v in m.q) - 1.0) < 0.1:
            w, *axis = np.array(m.q) / np.linalg.norm(m.q)
            across = 2.0 * np.cross(axis, numbers[7:10])
            north, east, down = (numbers[7:10] + w * across + np.cross(axis, across)).tolist()
            roll, pitch, yaw = roll_pitch_heading(np.array([[*axis, w]]))[0].tolist()
            yield Position(m.get_srcSystem(), boot, numbers[:3], (north, east, down))
            yield Attitude(boot, roll, pitch, yaw, numbers[10:])

    def _distance(self, m: Any) -> Iterator[Event]:
        if not self._own(m) or m.signal_quality == 1:
            return
        if m.orientation < 8:
            azimuth = -m.orientation * pi / 4
        elif m.orientation == 100 and self._finite(tuple(m.quaternion)) and _is_level(m.quaternion):
            azimuth = _axis(m.quaternion)
        else:
            return
        far = m.current_distance >= m.max_distance
        boot = self._boot(m, m.time_boot_ms * 1e-3)
        yield Ranges(boot, ((azimuth, float("inf") if far else 0.01 * m.current_distance),))

    def _distances(self, m: Any) -> Iterator[Event]:
        step = m.increment_f if m.increment_f else float(m.increment)
        if not self._own(m) or m.frame != 12 or not self._finite((step, m.angle_offset)):
            return
        rays = [
            (-radians(m.angle_offset + k * step), float("inf") if d > m.max_distance else 0.01 * d)
            for k, d in enumerate(m.distances)
            if d != _IGNORED
        ]
        yield Ranges(self._boot(m, m.time_usec * 1e-6), tuple(rays))

    def _reply(self, m: Any) -> Iterator[Event]:
        if self._autopilot(m) and m.tc1 > 0 and m.ts1 > 0 and m.ts1 % 1000 == _MARK:
            yield Reply(m.ts1 * 1e-9, m.tc1 * 1e-9)

    def _text(self, m: Any) -> Iterator[Event]:
        if self._own(m):
            yield Text(int(m.severity), str(m.text).rstrip("\0"))

    def _finite(self, numbers: tuple[float, ...]) -> bool:
        fine = all(map(isfinite, numbers))
        self.bad += not fine
        return fine

    def _frame(self, message: Any) -> bytes:
        frame: bytes = bytes(message.pack(self._out))
        self._out.seq = (self._out.seq + 1) % 256
        return frame

    def heartbeat(self) -> bytes:
        """Return the heartbeat of the bridge."""
        return self._frame(self._out.heartbeat_encode(_COMPUTER, _NO_AUTOPILOT, 0, 0, 4))

    def request_time(self, now: float) -> bytes:
        """Return a TIMESYNC request at `now` [s]."""
        return self._frame(self._out.timesync_encode(0, int(now * 1e6) * 1000 + _MARK))

    def request_rates(self, rate: float, *, beats: float) -> list[bytes]:
        """Return requests to send attitude and position at a rate [Hz], and heartbeats at the rate `beats` [Hz]."""
        return [
            self._frame(
                self._out.command_long_encode(
                    self.target, _AUTOPILOT, _INTERVAL, 0, float(kind), 1e6 / each, 0.0, 0.0, 0.0, 0.0, 0.0
                )
            )
            for kind, each in ((_HEARTBEAT, beats), *((kind, rate) for kind in _STREAMED))
        ]

    def control(self, axes: Axes) -> list[bytes]:
        """Return the frames that command stick axes, and in the mode `guided` a velocity."""
        sticks = tuple(_stick(v) for v in (axes.ahead, axes.right, axes.up, axes.clockwise))
        frames = [self._manual(*sticks) if self.send == "manual" else self._override(*sticks)]
        if axes.velocity is not None:
            v, rate = axes.velocity, axes.yaw_rate
            if not all(map(isfinite, (*v, rate))):
                v, rate = (0.0, 0.0, 0.0), 0.0
            frames.append(
                self._frame(
                    self._out.set_position_target_local_ned_encode(
                        0, self.target, _AUTOPILOT, 1, _VELOCITY_AND_RATE, 0, 0, 0, *v, 0, 0, 0, 0, rate
                    )
                )
            )
        return frames

    def _override(self, ahead: float, right: float, up: float, clockwise: float) -> bytes:
        pitch = roll = 1500
        sticks = (round(1500 + 400 * v) for v in (up, clockwise, ahead, right))
        rest = (_IGNORED,) * 2 + (0,) * 10
        return self._frame(self._out.rc_channels_override_encode(self.target, _AUTOPILOT, pitch, roll, *sticks, *rest))

    def _manual(self, ahead: float, right: float, up: float, clockwise: float) -> bytes:
        return self._frame(
            self._out.manual_control_encode(
                self.target, round(1000 * ahead), round(1000 * right), round(500 + 500 * up), round(1000 * clockwise), 0
            )
        )


def _stick(value: float) -> float:
    return min(1.0, max(-1.0, value)) if isfinite(value) else 0.0


def _is_level(q: list[float]) -> bool:
    # whether a quaternion is a rotation (zeros: it is not set) that turns a sensor to within 30° of the horizontal
    w, x, y, z = q
    return abs(sum(v * v for v in q) - 1.0) < 0.1 and abs(2 * (x * z - w * y)) < 0.5


def _axis(q: list[float]) -> float:
    # azimuth in {B} of the x axis of a sensor, turned by a quaternion from FRD
    w, x, y, z = q
    return -atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
