"""Inputs and parameters of a law: names, units, values of vehicle and mission, turning side, rules after gaps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import degrees, hypot
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from surctl.ir import Layout, Port
from surctl.marine.control.gains import GAINS, Gains, GainSpec
from surctl.marine.guidance import FAR, MAX_WAYPOINTS, Path
from surctl.marine.guidance.braking import brakes_of
from surctl.marine.sensing import Equipment, SonarArray
from surctl.marine.vehicle import Vehicle
from surctl.marine.vehicle.linearise import ahead_limit

CONTACT_SLOTS = 8

ARC_LENGTHS = ("progress", "furthest", "beyond")
"""Entries of a law's state that are arc lengths of its path, and so change when the window of a mission moves."""

FED = ("waypoints", "depth", "cruise", "visit")
"""Parameters of a law that its host feeds during a mission, see `guidance.following`."""

DEFAULT_ARRAY = SonarArray()
YAW_SHARE = 0.85
"""Share of the largest yaw moment that a planned yaw rate may use."""

_WIDER_SIDE = 0.1  # [m] offset of the site's middle from the path's first segment that makes a side wider

SECTORS = 16
"""Number of direction sectors; in each, a law with a map knows the nearest occupied and the nearest unknown cell."""

LAUNCHED = 0.3
"""Distance [m] from the start, within which obstacles may be in the sonars' blind range, unmeasured."""

_AGES = ("age", "since", "silent")  # ends of the names of the times in the state that grow without a step
_LASTING = ("mover_latest", "sonar_distrust")  # messages, which have an age; and what was found wrong with a sonar

_POSE = (
    Port("eta", (4,), "m, rad", "measured position x, y, z and heading psi in {E} (z up, psi counter-clockwise)"),
    Port("nu", (4,), "m/s, rad/s", "measured ground velocity u, v, w and yaw rate r in {B}"),
)


_COLUMN = Port(
    "column",
    (2,),
    "m",
    "free water above and below the hull from the echo sounders, within the mission's depth range; 0 if unknown",
)


def law_inputs(contacts: int = CONTACT_SLOTS, *, sonar: bool = True, depths: bool = False) -> Layout:
    """Return the layout of the inputs of a law in each control step, with room for `contacts` known obstacles.

    With `depths`, the law may leave a dead end at another depth, for which the robot has echo sounders up and down.
    """
    known = Port(
        "contacts",
        (contacts, 6),
        "m, m/s, 1",
        "known obstacles in {E}, one per row: x, y, radius, vx, vy, valid (0 or 1)",
    )
    sonar_ports = _sonar_ports(DEFAULT_ARRAY) if sonar else ()
    return Layout((*_POSE, *((known,) if contacts else ()), *sonar_ports, *((_COLUMN,) if depths else ())))


def _sonar_ports(array: SonarArray) -> tuple[Port, ...]:
    axes = ", ".join(f"{degrees(azimuth):.4g}" for azimuth in array.azimuths)
    meaning = f"raw ranges of each sonar's last firing, one sonar per row; axes at {axes} deg from x towards y of {{B}}"
    return (
        Port("samples", (array.size, array.samples), "m", meaning, array.maximum),
        Port("fresh", (array.size,), "1", "1 if a firing of the sonar has arrived since the last step, else 0"),
    )


INPUTS = law_inputs()


def sonar_inputs(equipment: Equipment, *, contacts: int = CONTACT_SLOTS, depths: bool = False) -> Layout:
    """Return the layout of the inputs of a law with a sonar map; a message of the base station has `contacts` rows."""
    array, own = equipment.array, equipment.own
    pose: tuple[Port, ...] = _POSE
    if own is not None:
        late = f"{own.fixes.latency:g} s before it arrives"
        pose = (
            Port("fix", (3,), "m", f"position x, y, z in {{E}} that the base station measured {late}"),
            Port("fix_fresh", (1,), "1", "1 if a fix has arrived since the last step, else 0"),
            Port(
                "yaw",
                (1,),
                "rad",
                "heading psi of {B} in {E}, counter-clockwise, from the IMU; whole turns may be added",
            ),
            Port("yaw_rate", (1,), "rad/s", "yaw rate r in {B}, from the IMU"),
        )
    delay = equipment.station.messages.latency
    meaning = f"moving obstacles in {{E}} that the base station measured {delay:g} s before"
    known = (
        Port("contacts", (contacts, 6), "m, m/s, 1", f"{meaning}, one per row: x, y, radius, vx, vy, valid (0 or 1)"),
        Port("contacts_fresh", (1,), "1", "1 if a message with contacts has arrived since the last step, else 0"),
    )
    return Layout((*pose, *(known if contacts else ()), *_sonar_ports(array), *((_COLUMN,) if depths else ())))


def scan_inputs(contacts: int, *, sensors: int, depths: bool = False) -> Layout:
    """Return the layout of perception's outputs, the inputs of the decision; `contacts` points of station and map."""
    return Layout(
        (
            *_POSE,
            Port("contacts", (contacts, 6), "m, m/s, 1", "contacts, one per row: x, y, radius, vx, vy, valid"),
            Port(
                "unknown",
                (SECTORS, 3),
                "1, m",
                "nearest unknown place in each direction: unit vector in {E}, clearance",
                FAR,
            ),
            Port(
                "sonars",
                (sensors, 6),
                "m, m, 1, s, 1",
                "one sonar per row: range, range error bound, healthy (0 or 1), age, axis x and y in {E}",
            ),
            Port("placed", (1,), "1", "1 while the robot knows its position", 1.0),
            Port("echoed", (1,), "1", "1 once a firing of any sonar was plausible", 1.0),
            *((_COLUMN,) if depths else ()),
        )
    )


_MODEL = (
    Port("mass", (4,), "kg, kg m^2", "diagonal of M in the controller's model", 1.0),
    Port("linear_drag", (4,), "N s/m, N m s", "linear drag Xu, Yv, Zw, Nr"),
    Port("quadratic_drag", (4,), "N s^2/m^2, N m s^2", "quadratic drag Xuu, Yvv, Zww, Nrr"),
    Port("thrust_limit", (4,), "N, N m", "largest thrust on each axis, in both directions", 1.0),
    Port("hull", (1,), "m", "hull radius", 0.1),
    Port(
        "stopping",
        (6,),
        "kg, N, s, N s/m, N s^2/m^2",
        "worst case: least and largest mass, largest thrust, thrust lag, largest linear and quadratic drag",
        1.0,
    ),
    Port(
        "spin_limit",
        (1,),
        "rad/s",
        "yaw rate that 85 % of the yaw moment sustains in the worst case; negative: the robot turns to the right",
        0.1,
    ),
)
_MISSION = (
    Port("waypoints", (MAX_WAYPOINTS, 2), "m", "path in {E}; unused rows repeat the last point"),
    Port("depth", (1,), "m", "desired z in {E}, negative below the surface"),
    Port("cruise", (1,), "m/s", "speed of the target point along the path", 0.1),
    Port("cap", (1,), "m/s", "largest commanded horizontal speed", 0.1),
    Port("walls", (4,), "m", "x_min, x_max, y_min, y_max of the site in {E}"),
    Port("launch", (1,), "m", "width of the water around the hull that is known to be free at the start"),
    Port("visit", (1,), "m", "distance to a corner of the path that counts as a visit; 0: corners may be cut"),
)

PARAMETERS = Layout(
    tuple(Port(name, (1,), spec.unit, spec.meaning, 1.0) for name, spec in GAINS.items()) + _MODEL + _MISSION
)


OF_VEHICLE: Mapping[str, Callable[[Vehicle, float], float]] = MappingProxyType(
    {"fin_share": Vehicle.fin_share, "munk": Vehicle.munk, "centripetal": Vehicle.centripetal}
    | {"ahead_limit": lambda vehicle, _: ahead_limit(vehicle)}
)
"""Numbers of a law with `GainSpec.from_vehicle`, as functions of the vehicle and the cruise speed [m/s]."""


def parameter_ports(own: Mapping[str, GainSpec]) -> Layout:
    """Return the layout of the parameters of a law: `PARAMETERS`, then the law's own gains `own`."""
    ports = (Port(name, (1,), spec.unit, spec.meaning, spec.default or 0.0) for name, spec in own.items())
    return Layout((*PARAMETERS, *ports)) if own else PARAMETERS


def _spin_side(path: Path, walls: tuple[float, float, float, float]) -> int:
    """Return the direction in which a law with sonars turns: +1 left, −1 right.

    The robot turns towards the side on which the site is wider beside the first segment of the path, or left if both
    sides are equally wide. The sonar beams then scan this side first; an obstacle near the start may have to be passed
    on this side.
    """
    start, leg = path.waypoints[0], path.waypoints[1] - path.waypoints[0]
    x, y = (walls[0] + walls[1]) / 2 - start[0], (walls[2] + walls[3]) / 2 - start[1]
    to_the_left = (leg[0] * y - leg[1] * x) / hypot(*leg)
    return -1 if to_the_left < -_WIDER_SIDE else 1


def law_parameters(
    gains: Gains,
    vehicle: Vehicle,
    *,
    path: Path,
    depth: float,
    cruise: float,
    cap: float,
    walls: tuple[float, float, float, float],
    launch: float = 0.0,
    visit: float = 0.0,
) -> NDArray[np.float64]:
    """Return the flat parameter vector of a law: its gains, the vehicle model of the controller, and the mission.

    Args:
        gains: complete gain set.
        vehicle: the controller's vehicle model; the simulated vehicle may have other parameters.
        path: reference path in {E}.
        depth: desired z [m], negative below the surface.
        cruise: desired speed U_d along the path [m/s].
        cap: largest horizontal speed that the law commands [m/s].
        walls: x_min, x_max, y_min, y_max of the site in {E} [m].
        launch: distance from the hull within which the water is known to be free at the start [m].
        visit: distance to a corner of the path [m], at or below which the corner counts as visited; 0: corners may be
            cut.
    """
    vehicle = vehicle.at_speed(cruise)
    brakes = brakes_of(vehicle)
    values: dict[str, object] = {
        **gains.values,
        "mass": vehicle.mass,
        "linear_drag": vehicle.drag_at(cruise),
        "quadratic_drag": vehicle.quadratic_drag,
        "thrust_limit": vehicle.thrust_limit,
        "hull": vehicle["radius"],
        "stopping": (*brakes.masses, brakes.most, brakes.lag, brakes.linear[1], brakes.quadratic[1]),
        "spin_limit": _spin_side(path, walls) * vehicle.steady_yaw(YAW_SHARE, cruise),
        "waypoints": path.slots,
        "depth": depth,
        "cruise": cruise,
        "cap": cap,
        "walls": walls,
        "launch": launch,
        "visit": visit,
    }
    values |= {name: OF_VEHICLE[name](vehicle, cruise) for name, spec in gains.own.items() if spec.from_vehicle}
    return parameter_ports(gains.own).pack(values)


def after_gap(port: Port) -> Port:
    """Return an entry of the perception's state with what a step does with it after periods without a step."""
    if port.unit == "s" and port.name.endswith(_AGES):
        return replace(port, gap="age")
    return port if port.name in _LASTING else replace(port, gap="anew")
