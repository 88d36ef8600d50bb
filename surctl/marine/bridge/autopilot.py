"""A simulated ArduSub for rehearsals: modes, arming, failsafe and telemetry, with surctl's plant behind it.

It is for rehearsals of a session and for tests. It models what the bridge depends on: heartbeats, clock, streams,
modes, arming, the pilot-input failsafe, and the response to sticks and velocity targets. It is not ArduSub: loops for
depth, yaw rate and velocity are simple, and the estimates are exact.
"""

from __future__ import annotations

from math import cos, degrees, inf, isfinite, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.marine.bridge.inputs import Site
from surctl.marine.bridge.wire import MODES, Axes, Mapping, Parser, dialect
from surctl.marine.simulation import Body, OwnPhysics, Scenario
from surctl.marine.simulation.sensors import FIRING, firing_plan
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import Vehicle
from surctl.marine.world import Disc

Vector = NDArray[np.float64]

_ARDUPILOT, _SUBMARINE, _ARMED, _OWN_MODES = 3, 12, 128, 1
_INTERVAL = 511  # MAV_CMD_SET_MESSAGE_INTERVAL
_FIRST_OTHER = 10  # difference between the system ids of the first moving obstacle and the vehicle
_DEPTH, _DEPTH_RATE, _RATE = 0.5, 1.5, 3.0  # [1/s², 1/s, 1/s] loops of the simulated autopilot
_GUIDED_TIMEOUT = 3.0  # [s] after which a velocity target ends


class SimulatedSub:
    """A simulated vehicle with its autopilot, and the system that reports moving obstacles.

    Attributes:
        physics: the plant; its state is the vehicle's.
        system_id, pilot_id: system ids of the autopilot, and of the system from which it takes control.
        armed, mode: armed state and name of the mode; only `arm`, `disarm`, `set_mode` and failsafes change them.
        sticks: deflections that act now.
        blind: whether the autopilot has no position and attitude.
        events: (time, text) of failsafes and changes.
        begun: time at which the operator first armed the vehicle [s]: moving obstacles begin to move.

    Args:
        scenario: mission; the vehicle begins at its start.
        site: place of the autopilot's NED frame in {E}.
        full_rate: yaw rate [rad/s] at full deflection.
        pilot_timeout: ArduSub's FS_PILOT_TIMEOUT [s].
        rate: rate of attitude and position [Hz].
        seed: seed of the scenario's world.
        sonars: whether to send DISTANCE_SENSOR messages.
        target: system id of the autopilot.
        system: the system id from which it takes control, ArduSub's MAV_GCS_SYSID.
    """

    def __init__(
        self,
        scenario: Scenario,
        vehicle: Vehicle,
        *,
        site: Site | None = None,
        full_rate: float = radians(45.0),
        pilot_timeout: float = 0.3,
        rate: float = 40.0,
        seed: int = 0,
        sonars: bool = False,
        target: int = 1,
        system: int = 255,
    ) -> None:
        self.scenario, self.vehicle = scenario, vehicle
        self.system_id, self.pilot_id = target, system
        self.site = site or Site()
        self.world = build_world(scenario, vehicle, seed=seed)
        self.array = scenario.sensors.array_on(vehicle["radius"])
        self.physics = OwnPhysics(self.world, vehicle, self.array)
        self.mappings = {name: Mapping.of(vehicle, mode, full_rate=full_rate) for name, mode in MODES.items()}
        self.limit = vehicle.at_speed(scenario.cruise).thrust_range[1]
        self.pilot_timeout, self.rate, self.sonars = pilot_timeout, rate, sonars
        self.armed, self.mode = False, "alt_hold"
        self.sticks, self.target = Axes(), (-inf, (0.0, 0.0, 0.0), 0.0)
        self.last_pilot: float | None = None
        self.booted, self.steps = 0.0, 0
        self.depth = float(self.physics.state[2])
        self.least = inf
        self.begun: float | None = None
        self.blind, self.beat_period = False, 1.0
        self.events: list[tuple[float, str]] = []
        self.commands: set[int] = set()
        self._mav = dialect()
        self._parser = Parser()
        self._outs: dict[int, Any] = {}
        self._firings = firing_plan(self.array)
        self._failed = True  # no pilot has been heard yet

    @property
    def state(self) -> tuple[Vector, Vector]:
        """True pose η (4,) in {E} and velocity ν (4,) in {B}."""
        return self.physics.state[:4], self.physics.state[4:8]

    def arm(self, now: float) -> None:
        """Arm the vehicle, as the operator does."""
        self.armed, self.depth = True, float(self.physics.state[2])
        self.begun = now if self.begun is None else self.begun
        self.events.append((now, "armed by the operator"))

    def disarm(self, now: float, why: str = "by the operator") -> None:
        """Disarm the vehicle."""
        self.armed, self.sticks = False, Axes()
        self.events.append((now, f"disarmed {why}"))

    def set_mode(self, mode: str, now: float) -> None:
        """Change the mode, as the operator does."""
        self.mode, self.depth = mode, float(self.physics.state[2])
        self.events.append((now, f"mode {mode}"))

    def reboot(self, now: float) -> None:
        """Restart the autopilot: disarmed, its clock at 0, silent for one second."""
        self.armed, self.sticks, self.last_pilot, self._failed = False, Axes(), None, True
        self.beat_period = 1.0
        self.booted, self.target = now + 1.0, (-inf, (0.0, 0.0, 0.0), 0.0)
        self.events.append((now, "restart"))

    def hear(self, data: bytes, now: float) -> list[bytes]:
        """Take a datagram at `now` [s]; return the frames of the reply."""
        if now < self.booted:
            return []
        replies: list[bytes] = []
        for m in self._parser.parse(data)[0]:
            kind = m.get_type()
            if kind == "TIMESYNC" and m.tc1 == 0:
                replies.append(self._frame(self.system_id, "timesync", int((now - self.booted) * 1e9) or 1, m.ts1))
            elif kind in ("COMMAND_LONG", "COMMAND_INT"):
                self.commands.add(int(m.command))
                if m.command == _INTERVAL and m.param1 == 0:
                    self.beat_period = m.param2 * 1e-6
            elif kind == "RC_CHANNELS_OVERRIDE" and m.get_srcSystem() == self.pilot_id:
                pwm = (m.chan5_raw, m.chan6_raw, m.chan3_raw, m.chan4_raw)
                self._piloted(Axes(*((v - 1500) / 400 for v in pwm)), now)
            elif kind == "MANUAL_CONTROL" and m.get_srcSystem() == self.pilot_id:
                self._piloted(Axes(m.x / 1000, m.y / 1000, (m.z - 500) / 500, m.r / 1000), now)
            elif kind == "SET_POSITION_TARGET_LOCAL_NED":
                self.target = now, (m.vx, m.vy, m.vz), m.yaw_rate
        return replies

    def bodies(self, now: float) -> list[Body]:
        """Return the obstacles at `now` [s]; the scenario begins when the operator first arms the vehicle."""
        return self.world.bodies(0.0 if self.begun is None else now - self.begun)

    def _piloted(self, sticks: Axes, now: float) -> None:
        self.sticks, self.last_pilot, self._failed = sticks, now, False

    def advance(self, now: float) -> list[bytes]:
        """Move the vehicle on by 25 ms from `now` [s]; return the frames that its systems send in this time."""
        self._failsafe(now)
        thrust = self.thrust(now) if self.armed else np.zeros(4)
        frames = self._telemetry(now)
        self.physics.advance(self.world.thrust(thrust, self.limit), now)
        clear, wall = self.physics.clearance(self.bodies(now))
        self.least = min(self.least, clear, wall)
        self.steps += 1
        return frames

    def pilot_thrust(self, now: float) -> Vector:
        """Thrust (4,) that sticks or velocity targets command now; 0 if they are neutral or the vehicle is disarmed."""
        if not self.armed:
            return np.zeros(4)
        if self.mode == "guided":
            fresh = now - self.target[0] <= _GUIDED_TIMEOUT
            return np.array([*self.target[1], self.target[2]]) if fresh else np.zeros(4)
        mapping = self.mappings[self.mode]
        thrust = mapping.thrust(self.sticks)
        if mapping.mode.rate:
            thrust[3] = -self.sticks.clockwise * mapping.full_rate
        return thrust

    def thrust(self, now: float) -> Vector:
        """Return the thrust (4,) [N, N m] of the armed vehicle."""
        eta, nu = self.state
        mapping, model = self.mappings[self.mode], self.vehicle
        least, most = self.mappings["manual"].limits
        command = self.pilot_thrust(now)
        if self.mode == "guided":
            v = self.site.velocity(command[:3])
            c, s = cos(eta[3]), sin(eta[3])
            command = np.array([c * v[0] + s * v[1], c * v[1] - s * v[0], v[2], -command[3]])
            drag = model.linear_drag * command + model.quadratic_drag * np.abs(command) * command
            return np.clip(_RATE * model.mass * (command - nu) + drag, least, most)
        if mapping.mode.rate:
            pull = _DEPTH * (self.depth - eta[2]) - _DEPTH_RATE * nu[2]
            rate = command[3]
            drag = model.linear_drag[3] * rate + model.quadratic_drag[3] * abs(rate) * rate
            command = np.array([*command[:2], model.mass[2] * pull, model.mass[3] * _RATE * (rate - nu[3]) + drag])
        return np.clip(command, least, most)

    def _failsafe(self, now: float) -> None:
        if self._failed or self.last_pilot is None or now - self.last_pilot <= self.pilot_timeout:
            return
        self._failed, self.sticks = True, Axes()
        self.events.append((now, "lost manual control"))
        if self.armed:
            self.disarm(now, "by the pilot-input failsafe")

    def _telemetry(self, now: float) -> list[bytes]:
        if now < self.booted:
            return []
        boot = round((now - self.booted) * 1000)
        frames = []
        if self._each(self.beat_period):
            base = _OWN_MODES | (_ARMED if self.armed else 0)
            number = MODES[self.mode].number if self.mode in MODES else 0
            frames.append(self._frame(self.system_id, "heartbeat", _SUBMARINE, _ARDUPILOT, base, number, 4))
        if self._each(1.0 / self.rate) and not self.blind:
            frames += self._state(boot)
        if self._each(0.1):
            frames += self._obstacles(now)
        return frames + (self._ranges(now, boot) if self.sonars else [])

    def _each(self, period: float) -> bool:
        return self.steps % max(1, round(period / FIRING)) == 0

    def _state(self, boot: int) -> list[bytes]:
        eta, nu = self.state
        north, east, down, yaw = self.site.to_ned(eta).tolist()
        c, s = cos(eta[3]), sin(eta[3])
        velocity = self.site.velocity([c * nu[0] - s * nu[1], s * nu[0] + c * nu[1], nu[2]]).tolist()
        attitude = self._frame(
            self.system_id, "attitude", boot, 0.0, 0.0, (yaw + np.pi) % (2 * np.pi) - np.pi, 0.0, 0.0, -float(nu[3])
        )
        return [attitude, self._frame(self.system_id, "local_position_ned", boot, north, east, down, *velocity)]

    def _obstacles(self, now: float) -> list[bytes]:
        there = {b.name: b for b in self.bodies(now) if b.moving}
        frames = []
        names = [o.name for o in self.scenario.obstacles if o.shape == "moving"]
        for k, name in enumerate(names):
            numbers = [float("nan")] * 6
            if name in there:
                shape, v = there[name].shape, there[name].velocity * (self.begun is not None)
                assert isinstance(shape, Disc)
                place = self.site.to_ned([*shape.center, self.scenario.depth, 0.0])
                numbers = [*place[:3].tolist(), *self.site.velocity([*v, 0.0]).tolist()]
            system = (self.system_id + _FIRST_OTHER + k - 1) % 255 + 1  # ids end at 255 and begin at 1
            frames.append(self._frame(system, "local_position_ned", int(now * 1000), *numbers))
        return frames

    def _ranges(self, now: float, boot: int) -> list[bytes]:
        frames = []
        bodies = self.bodies(now)
        for sensor in self._firings.at(self.steps):
            distance, axis = self.physics.echo(sensor, bodies), degrees(self.array.azimuths[sensor])
            cm = round(100 * distance) if isfinite(distance) else 65535
            far = round(100 * self.array.maximum)
            orientation = round(-axis / 45) % 8
            numbers = (boot, 20, far, min(cm, far), 1, sensor, orientation, 255)
            frames.append(self._frame(self.system_id, "distance_sensor", *numbers))
        return frames

    def _frame(self, system: int, kind: str, *numbers: Any) -> bytes:
        if system not in self._outs:
            self._outs[system] = self._mav.MAVLink(None, srcSystem=system, srcComponent=1)
        out = self._outs[system]
        frame = bytes(getattr(out, f"{kind}_encode")(*numbers).pack(out))
        out.seq = (out.seq + 1) % 256
        return frame
