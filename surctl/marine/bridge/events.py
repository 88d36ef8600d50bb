"""What the bridge receives, as plain data: events that `Wire` decodes from MAVLink messages."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

__all__ = ["Attitude", "Beat", "Event", "Gone", "Odometry", "Position", "Ranges", "Reply", "Text"]


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


class Odometry(NamedTuple):
    """Position [m] in NED, attitude as a quaternion (w, x, y, z), velocity and rates in FRD, at `boot` [s]."""

    boot: float
    place: tuple[float, float, float]
    q: tuple[float, float, float, float]
    velocity: tuple[float, float, float]
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


Event: TypeAlias = Beat | Position | Gone | Attitude | Odometry | Ranges | Reply | Text
