"""The law's inputs from received messages: place of the NED frame (`--origin`), pose moved on, sonars, obstacles.

Every measurement carries the time at which it was made. Pose and position are moved on to the present by the measured
velocity; a flag of arrival is 1 once for each measurement, and an old measurement never counts as a new one.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from math import cos, inf, isfinite, pi, radians, sin

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.bridge.wire import Attitude, Position, Ranges
from surctl.marine.control import Law
from surctl.marine.simulation import Scenario
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import Vehicle
from surctl.marine.world import Disc

# The scenario's frame {E} and the autopilot's local frame NED


Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Site:
    """Place of the autopilot's local NED frame in the scenario's frame {E}.

    Attributes:
        x, y: position of the origin of NED in {E} [m].
        bearing: compass direction of the x axis of {E} [rad]; π/2: the x axis points east.
    """

    x: float = 0.0
    y: float = 0.0
    bearing: float = pi / 2

    @property
    def turn(self) -> float:
        """Angle [rad] by which a vector in ENU is rotated counter-clockwise to get its coordinates in {E}."""
        return self.bearing - pi / 2

    def pose(self, ned: Iterable[float]) -> Vector:
        """Return the pose η (4,) in {E} of a pose north, east, down [m], ψ clockwise from north [rad]."""
        north, east, down, yaw = (float(v) for v in ned)
        c, s = cos(self.turn), sin(self.turn)
        return np.array([self.x + c * east - s * north, self.y + s * east + c * north, -down, self.bearing - yaw])

    def to_ned(self, eta: Iterable[float]) -> Vector:
        """Return the pose in NED (4,) of a pose η in {E}; inverse of `pose`."""
        x, y, z, psi = (float(v) for v in eta)
        c, s = cos(self.turn), sin(self.turn)
        east, north = c * (x - self.x) + s * (y - self.y), c * (y - self.y) - s * (x - self.x)
        return np.array([north, east, -z, self.bearing - psi])

    def velocity(self, ned: Iterable[float]) -> Vector:
        """Return the velocity (3,) in {E} of a velocity north, east, down [m/s], or the other way; its own inverse."""
        north, east, down = (float(v) for v in ned)
        c, s = cos(self.turn), sin(self.turn)
        return np.array([c * east - s * north, s * east + c * north, -down])

    def body(self, eta: Vector, velocity: Iterable[float], yaw_rate: float) -> Vector:
        """Return ν (4,) in {B} of a velocity (3,) in {E} [m/s] and a yaw rate [rad/s], counter-clockwise from above."""
        vx, vy, vz = (float(v) for v in velocity)
        c, s = cos(eta[3]), sin(eta[3])
        return np.array([c * vx + s * vy, c * vy - s * vx, vz, yaw_rate])


def yaw_rate(roll: float, pitch: float, rates: tuple[float, float, float]) -> float:
    """Return ψ̇ [rad/s], counter-clockwise from above, of a hull with attitude [rad] and rates [rad/s] in FRD."""
    if not abs(pitch) < 0.5 * pi:
        return float("nan")
    return -(sin(roll) * rates[1] + cos(roll) * rates[2]) / cos(pitch)


def parse_site(text: str) -> Site:
    """Return the site of a text "X,Y,DEG": origin of NED in {E} [m], compass direction of the x axis of {E} [deg]."""
    try:
        x, y, bearing = (float(word) for word in text.split(","))
    except ValueError:
        x = y = bearing = float("nan")
    if not all(map(isfinite, (x, y, bearing))):
        raise InputError(
            "is not a place and a direction", key="--origin", value=text, remedy='write "X,Y,DEG", such as 0.5,2.5,90'
        )
    return Site(x, y, radians(bearing))


_NEAR = radians(10.0)  # largest angle between a measured direction and the axis of a sonar of the law
_FIRING = 0.025  # [s] time within which two measurements of one sonar are one firing


@dataclass(frozen=True)
class Estimate:
    """Pose η (4,) in {E} and velocity ν (4,) in {B}, with the times at which position and yaw were measured [s]."""

    eta: Vector
    nu: Vector
    placed: float
    turned: float

    @property
    def measured(self) -> float:
        """Time of the older of the two measurements [s]."""
        return min(self.placed, self.turned)

    def at(self, now: float) -> tuple[Vector, Vector]:
        """Return pose and velocity at the time `now` [s], with constant velocity since the measurements."""
        x, y, z, psi = self.eta.tolist()
        u, v, w, r = self.nu.tolist()
        ahead, turned = now - self.placed, psi + r * (now - self.turned)
        middle = psi + r * (self.placed + 0.5 * ahead - self.turned)
        c, s = cos(middle), sin(middle)
        pose = np.array([x + (c * u - s * v) * ahead, y + (s * u + c * v) * ahead, z + w * ahead, turned])
        return pose, self.nu


@dataclass
class _Track:
    # a moving obstacle: position and velocity (3,) in {E} at the time `received`
    boot: float
    received: float
    place: Vector
    velocity: Vector


@dataclass
class Inputs:
    """Collects measurements, and builds the input vector of the law."""

    law: Law
    scenario: Scenario
    vehicle: Vehicle
    site: Site
    _place: tuple[float, Vector, Vector] | None = field(default=None, init=False)
    _turn: tuple[float, float, float] | None = field(default=None, init=False)
    _fixed: float = field(default=-inf, init=False)
    _last: float = field(default=-inf, init=False)
    _tracks: dict[int, _Track] = field(default_factory=dict, init=False)
    _gone: set[int] = field(default_factory=set, init=False)

    def __post_init__(self) -> None:
        equipment = self.scenario.sensors.on(self.vehicle["radius"])
        self._array = equipment.array
        self._fixes = None if equipment.own is None else equipment.own.fixes
        self._own = equipment.own
        self._samples = np.full((self._array.size, self._array.samples), self._array.maximum)
        self._fresh = np.zeros(self._array.size)
        self._fired = np.full(self._array.size, -inf)
        self._reports = 0
        self._working = np.ones(self.law.inputs.port("working").size if "working" in self.law.inputs else 0)
        world = build_world(self.scenario, self.vehicle, seed=0)
        drifts = {o.name: o.drift_m for o in self.scenario.obstacles}
        self._still = [(b, drifts[b.name]) for b in world.bodies(0.0) if not b.moving]
        self._radii = [o.radius_m or self.vehicle["radius"] for o in self.scenario.obstacles if o.shape == "moving"]

    def forget(self) -> None:
        """Forget every measurement of the vehicle, as after a restart of its autopilot; obstacles stay known."""
        self._place, self._turn = None, None

    def position(self, event: Position, measured: float) -> None:
        """Take a position of the vehicle that was measured at `measured` [s]."""
        if self._place is None or measured > self._place[0]:
            pose = self.site.pose([*event.place, 0.0])
            self._place = measured, pose[:3], self.site.velocity(event.velocity)

    def attitude(self, event: Attitude, measured: float) -> None:
        """Take an attitude of the vehicle that was measured at `measured` [s]."""
        rate = yaw_rate(event.roll, event.pitch, event.rates)
        if np.isfinite(rate) and (self._turn is None or measured > self._turn[0]):
            psi = float(self.site.pose([0.0, 0.0, 0.0, event.yaw])[3])
            self._turn = measured, psi, rate

    def ranges(self, event: Ranges, measured: float) -> None:
        """Take distances that were measured at `measured` [s]: each sonar of the law gets the nearest in its beam."""
        array = self._array
        for k, axis in enumerate(array.azimuths):
            width = _NEAR if len(event.rays) == 1 else array.half_angle
            near = [d for azimuth, d in event.rays if abs((azimuth - axis + pi) % (2 * pi) - pi) <= width]
            if near and measured > self._fired[k] + _FIRING:
                self._samples[k] = min(max(min(near), 0.0), array.maximum)
                self._fresh[k], self._fired[k] = 1.0, measured

    def obstacle(self, event: Position, now: float) -> None:
        """Take the position of a moving obstacle, which its own system reports in the autopilot's NED frame."""
        known = self._tracks.get(event.system)
        if known is not None and known.boot - 1.0 < event.boot <= known.boot:
            return
        place = self.site.pose([*event.place, 0.0])[:3]
        self._gone.discard(event.system)
        self._tracks[event.system] = _Track(event.boot, now, place, self.site.velocity(event.velocity))
        self._reports += 1

    def gone(self, system: int) -> None:
        """Take note that a moving obstacle has left the water."""
        self._gone.add(system)
        self._tracks.pop(system, None)

    def silent(self, now: float, *, longest: float) -> str:
        """Return the name of a moving obstacle that sent nothing for longer than `longest` [s]; empty if none."""
        for system, track in sorted(self._tracks.items()):
            if now - track.received > longest:
                return f"of system {system}"
        missing = len(self._radii) - len(self._tracks) - len(self._gone)
        return f"number {len(self._radii) - missing + 1} of the scenario" if missing > 0 else ""

    @property
    def estimate(self) -> Estimate | None:
        """The newest pose and velocity; None before both position and attitude have been measured."""
        if self._place is None or self._turn is None:
            return None
        (placed, place, velocity), (turned, psi, rate) = self._place, self._turn
        eta = np.array([*place, psi])
        then, _ = Estimate(eta, np.array([0.0, 0.0, 0.0, rate]), placed, turned).at(placed)
        return Estimate(eta, self.site.body(then, velocity, rate), placed, turned)

    def vector(self, now: float) -> Vector:
        """Return the inputs u (nu,) of the law for the time `now` [s]; flags of arrival are then 0 again."""
        known = self.estimate
        assert known is not None
        eta, nu = known.at(now)
        values: dict[str, object] = {"eta": eta, "nu": nu, "working": self._working, "column": np.zeros(2)}
        values |= {"samples": self._samples, "fresh": self._fresh}
        rows = self._rows(now, eta, still=self.law.perception is None)
        values |= {"contacts": rows, "contacts_fresh": float(self._reports > 0), **self._fix(known)}
        values |= {"yaw": eta[3], "yaw_rate": nu[3]}
        u = self.law.inputs.pack({name: value for name, value in values.items() if name in self.law.inputs})
        self._fresh, self._reports = np.zeros(self._array.size), 0
        return u

    def _fix(self, known: Estimate) -> dict[str, object]:
        # a position as old as the law expects; 1 for a new measurement, no more often than the law expects
        if self._fixes is None:
            return {"fix": known.eta[:3], "fix_fresh": 0.0}
        fresh = known.placed > self._last and known.placed - self._fixed >= self._fixes.period - 0.01
        self._last = max(self._last, known.placed)
        if fresh:
            self._fixed = known.placed
        return {"fix": known.eta[:3], "fix_fresh": float(fresh)}

    def _radius(self, system: int) -> float:
        # moving obstacles in the order of their systems' ids; with more systems than obstacles the order says nothing
        systems = sorted({*self._tracks, *self._gone})
        if len(systems) > len(self._radii):
            return max([*self._radii, self.vehicle["radius"]])
        return self._radii[systems.index(system)]

    def _rows(self, now: float, eta: Vector, *, still: bool) -> Vector:
        # (slots, 6): moving obstacles first continued from their last message, then the nearest charted ones
        slots = self.law.inputs.port("contacts").shape[0] if "contacts" in self.law.inputs else 0
        rows = []
        for system, track in sorted(self._tracks.items()):
            x, y = (track.place[:2] + track.velocity[:2] * (now - track.received)).tolist()
            rows.append([x, y, self._radius(system), *track.velocity[:2].tolist(), 1.0])
        for body, drift in self._still if still else ():
            place = body.shape.center if isinstance(body.shape, Disc) else body.shape.nearest(eta[:2])[1]
            radius = body.shape.radius if isinstance(body.shape, Disc) else 0.0
            rows.append([float(place[0]), float(place[1]), radius + drift, 0.0, 0.0, 1.0])
        rows.sort(key=lambda row: float(np.hypot(row[0] - eta[0], row[1] - eta[1])) - row[2])
        out = np.zeros((slots, 6))
        for row, known in zip(out, rows, strict=False):
            row[:] = known
        return out
