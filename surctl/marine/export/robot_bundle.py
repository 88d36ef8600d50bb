"""The bundle of a law of the robot: wiring of its sensors in the README, and missions as C data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import cos, degrees, expm1, log1p, sin
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.export import bundle as core
from surctl.export.contract import DATA, MISSION_FILES, Exportable
from surctl.export.envelope import Envelope, Records
from surctl.export.evidence import ReplayedRun
from surctl.export.supplement import UNKNOWN, Listed, Supplement, step_line
from surctl.ir import Real, c_literal
from surctl.marine.control import ARC_LENGTHS, FED
from surctl.marine.control.beams import SURE
from surctl.marine.export.origin import Origin, check_belonging, origin_entries
from surctl.marine.guidance import AT_CORNER, MAX_WAYPOINTS, ROW
from surctl.marine.guidance.following import SHORTEST
from surctl.marine.sensing import INCIDENCE_LIMIT, Equipment, SonarArray
from surctl.marine.sensing.localisation.own_state import LONGEST_AGE, LONGEST_LATENCY
from surctl.marine.simulation import Run
from surctl.marine.simulation.explanation import failure
from surctl.marine.vehicle import Actuators


def _is_fed(law: Exportable) -> bool:
    """Return whether a law follows a path whose waypoints, depth, speed and visits its host can feed."""
    return "progress" in law.state and all(name in law.gains for name in FED)


def _mission_values(law: Exportable, real: Real) -> dict[str, Any]:
    """Return the values of the templates of `MISSION_FILES`."""
    return {
        "window": MAX_WAYPOINTS,
        "at_corner": repr(AT_CORNER),
        "shortest": repr(SHORTEST),
        "root": "sqrt" if real == "float64" else "sqrtf",
        "arcs": [name for name in ARC_LENGTHS if name in law.state],
    }


def _data_rows(law: Exportable, table: NDArray[np.float64], real: Real) -> list[str]:
    """Return the C initialisers of the waypoints (n, 5) of a mission, see `guidance.Path.table`."""
    if not _is_fed(law):
        raise InputError("takes no waypoints, so that it cannot be fed with a mission", key="mission", value=law.name)
    if table.ndim != 2 or table.shape[1] != ROW or len(table) < 2:
        raise InputError(f"has shape {table.shape}, expected (n, {ROW})", key="mission", remedy="give Path.table()")
    literal = partial(c_literal, real=real)
    return [", ".join(literal(float(value)) for value in row) for row in table]


_PLAIN: Mapping[str, str] = MappingProxyType(
    {
        "eta": "Pose of the hull's centre at this instant, from an estimator. Angles may include whole turns.",
        "nu": "Velocity over ground (not through the water) in the body frame, and yaw rate, from the same estimator.",
        "contacts": "One row per obstacle; an unused row is all zeros (valid = 0). Order and number may change.",
        "contacts_fresh": "1 in the one step after a message arrived, else 0. The rows may keep their old numbers. "
        "Without moving obstacles, or without a source of messages: `contacts` all zeros, and 0 in every step.",
        "fix": "The last position of the hull's centre that arrived. Before the first one: any numbers in range, such "
        "as those of the start, with `fix_fresh` = 0. The range is checked in every step, whatever the flag is.",
        "fix_fresh": "1 in the one step after a fix arrived, else 0. Never 1 twice for one fix.",
        "yaw": "The IMU's heading at this instant, in radians. Its zero is the x axis of the world frame, not north. "
        "The range leaves room for whole turns, so that it does not find degrees.",
        "yaw_rate": "The IMU's yaw rate at this instant, rad/s, counter-clockwise seen from above.",
        "fresh": "1 for a sonar whose firing is complete since the last step, else 0. Never 1 twice for one firing.",
        "working": "1 for each thruster that works, in the order of the table below; 0 for one that is known to fail.",
        "column": "Water above and below the hull from echo sounders that look up and down; 0 if there are none.",
    }
)


def _robot_wiring(law: Exportable, origin: Origin | None) -> dict[str, Any]:
    """Return what is known of the wiring of a law of the robot, beyond `wiring_values`."""
    equipment = None if origin is None else origin.equipment
    array = None if equipment is None else equipment.array
    return {
        "wires": [(port.name, _source(port.name, array, listening="samples" in law.inputs)) for port in law.inputs],
        "sonar_lines": _sonars(equipment, origin) if equipment and origin and "samples" in law.inputs else [],
        **({} if equipment is None else {"rate_lines": _rates(law, equipment)}),
        "thruster_rows": _thrusters(origin) if "working" in law.inputs else [],
        "own_age": "own_age" in law.state,
        "own_known": "own_known" in law.state,
        "oldest_fix": f"{LONGEST_LATENCY:g}",
        "never_fixed": f"{LONGEST_AGE:g}",
        "arriving": "progress" in law.state,
        "stalling": [count for count in ("stalled", "searching") if count in law.state],
        "listening": "samples" in law.inputs,
        "coasting": "" if origin is None else _coasting(origin),
        "plant_line": "" if origin is None else _plant(origin),
    }


def _source(name: str, array: SonarArray | None, *, listening: bool) -> str:
    if name == "contacts" and listening:
        return f"Moving obstacles only: the sonars find what stands still, and the walls are gains. {_PLAIN[name]}"
    if name == "samples":
        none = "the longest range" if array is None else f"{array.maximum:g}"
        count = "all columns" if array is None else f"all {array.samples} columns"
        return (
            f"One row per sonar. A row is one echo: {count} are conversions of the same firing. A module that gives "
            "one number per firing is best exported with `samples = 1`; else it fills all columns. Without an echo, "
            f"every column is {none}, not 0 and not −1; the same before the first firing."
        )
    return _PLAIN.get(name, UNKNOWN)


def _sonars(equipment: Equipment, origin: Origin) -> list[str]:
    array = equipment.array
    radius = origin.vehicle["radius"]
    places = array.mounts or [(radius * cos(a), radius * sin(a)) for a in array.azimuths]
    apex = "; ".join(
        f"{k}: ({x + 0.0:.3g}, {y + 0.0:.3g}) m, axis {degrees(a):.4g}°"
        for k, ((x, y), a) in enumerate(zip(np.round(places, 6), array.azimuths, strict=True))
    )
    echo = (
        f"a face answers within {degrees(INCIDENCE_LIMIT):.3g}° of its normal, with the range of its nearest point in "
        "the beam, and may be silent otherwise. A corner that points at the hull may be heard too late or not at all, "
        "and is not covered. A known wall may be silent where a beam meets it obliquely, so a reading counts as a "
        f"fault only beyond a wall that the beam meets within {degrees(SURE):.3g}° of its normal. For 9 s a mark is "
        "cleared only by silence from directions from which it was heard"
    )
    floor = "The law knows neither water surface nor floor: "
    if equipment.floor is not None:
        floor = (
            f"An echo from the range of a floor {equipment.floor:g} m deep, or from beyond, marks no obstacle. The "
            "law does not know the water surface: "
        )
    search = (
        []
        if equipment.search_limit is None
        else [
            f"Search limit: after {equipment.search_limit:g} s without progress along the path the status is TRAPPED, "
            "also while the robot still searches new places, and whatever `patience` is; `searching` in the state "
            "counts. Time near a moving obstacle, at the end of the path, and without thrust does not count."
        ]
    )
    tilt, side = abs(degrees(array.elevation)), "above" if array.elevation > 0 else "below"
    tilted = f", its axis {tilt:.3g}° {side} the horizontal" if tilt else ""
    step = f"{1000 * array.resolution:.4g} mm"
    samples = f"{array.samples} {'sample' if array.samples == 1 else 'samples'} a firing"
    return [
        f"Origin of the ranges: the sonar's place on the hull (x forward, y left of the hull's centre; axis "
        f"counter-clockwise from forward), by row: {apex}. A module that measures from elsewhere: convert its ranges. "
        "Ranges from the centre are too long by these distances, and the robot then passes too close or collides.",
        f"Echoes that the law is designed for: {echo}. {floor}"
        "mount the sonars, or drop echoes, "
        "so that they give none; an echo of theirs counts as an obstacle.",
        f"Ranges: {array.blind:g} to {array.maximum:g} m; nearer than {array.blind:g} m reads {array.lowest:.4g} m; "
        f"beam {degrees(array.beam_angle):.4g}° wide{tilted}. No echo reads {array.maximum:g} m.",
        f"Firing plan: one sonar every {array.firing_period:g} s in the order {', '.join(map(str, array.order))}; each "
        f"fires every {array.cycle:.4g} s. A sonar that answers less often than every 0.3 s counts as unhealthy.",
        f"In the simulated run, each sample of an echo is {array.scale:.4g} r + bias + noise, limited to "
        f"{array.lowest:.4g} to {array.maximum:g} m, then rounded to the conversion step; r is the horizontal distance "
        "from the sonar to the nearest point in the beam that answers.",
        f"Conversion step {step}, noise {1000 * array.noise_sd:.3g} mm (standard deviation of each sample, independent "
        f"also within a firing), bias {1000 * array.bias:.3g} mm, {samples}. A row that repeats exactly "
        "from firing to firing is taken as a stuck sensor. A quiet module in front of a robot at rest repeats "
        "too, and reads unhealthy: export with the true `step_m` and `samples` of the module (`step_m = 0.01`, "
        "`samples = 1` for whole centimetres, one number), which allows for such repeats.",
        f"Speed of sound {array.speed:.0f} m/s (water, {array.temperature:g} °C); readings are "
        f"{array.scale:.4g} times the true range.",
        *search,
    ]


def _rates(law: Exportable, equipment: Equipment) -> list[str]:
    lines = [step_line(law)]
    if "fix" in law.inputs and equipment.own is not None:
        own, fixes = equipment.own, equipment.own.fixes
        lines.append(f"Fixes: every {fixes.period:g} s, {fixes.latency:g} s old when they arrive (`fix_fresh` = 1).")
        lines.append(
            f"Noise that the law is designed for (standard deviation, white): fix {1000 * own.position_sd:g} mm on "
            f"each axis, yaw {own.yaw_sd:g} rad, yaw rate {own.rate_sd:g} rad/s. Larger noise is not covered. The "
            "noise of the fixes decides whether the robot keeps its distances: measure it before the first flight."
        )
    if "contacts_fresh" in law.inputs:
        messages = equipment.station.messages
        lines.append(f"Messages with moving obstacles: every {messages.period:g} s, {messages.latency:g} s old.")
    if "fresh" in law.inputs:
        lines.append(
            "Firings: complete within the period before the step in which their flag is 1. In the simulated run they "
            "are then 0 or 0.025 s old. Which sonar fires first, and when within the period, is free."
        )
    return lines


def _plant(origin: Origin) -> str:
    # the equation of motion of the simulated run
    vehicle = origin.vehicle
    mass, linear, quadratic = (
        ", ".join(f"{v:g}" for v in row) for row in (vehicle.mass, vehicle.linear_drag, vehicle.quadratic_drag)
    )
    more = f"; further terms of the vehicle file: {', '.join(vehicle.form.terms)}" if vehicle.form.terms else ""
    return (
        f"M ν̇ = τ − C(ν) ν − (D + D₂ |ν|) ν with ν = (u, v, w, r) through the water, M = diag({mass}), "
        f"D = diag({linear}), D₂ = diag({quadratic}) in SI units, and C(ν) ν = (−m₂₂ v r, m₁₁ u r, 0, (m₂₂ − m₁₁) u v)"
        f"{more}. τ follows the command, within ± {', '.join(f'{v:g}' for v in vehicle.delivered_limit)} N and N m, "
        f"with a first-order lag of {vehicle['thrust_lag']:g} s. The hull is a sphere of radius "
        f"{vehicle['radius']:g} m around the position; nothing "
        "but the depth of the mission keeps it below the surface and off the floor"
    )


def _coasting(origin: Origin, speed: float = 0.2) -> str:
    # m du/dt = -(D + D₂ u) u along x, in still water: a = D / m, b = D₂ / m
    mass, linear, quadratic = (
        float(v[0]) for v in (origin.vehicle.mass, origin.vehicle.linear_drag, origin.vehicle.quadratic_drag)
    )
    a, b = linear / mass, quadratic / mass
    if a <= 0.0 or b <= 0.0:
        return ""
    after = [log1p(b * speed * -expm1(-a * t) / a) / b for t in (10.0, 60.0)]
    return f" (about {after[0]:.1f} m in 10 s and {after[1]:.1f} m in 60 s from {speed:g} m/s in still water)"


def _thrusters(origin: Origin | None) -> Sequence[tuple[str, ...]]:
    actuators: Actuators | None = None if origin is None else origin.vehicle.actuators
    if actuators is None:
        return []
    return [
        (
            t.name,
            ", ".join(f"{v:.3g}" for v in t.at),
            ", ".join(f"{v:.3g}" for v in t.direction),
            f"{t.forward:.4g}",
            f"{t.reverse:.4g}",
        )
        for t in actuators.thrusters
    ]


Vector = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Robot(Supplement):
    origin: Origin | None
    mission: Vector | None

    @property
    def files(self) -> dict[str, str]:
        return {} if self.origin is None else self.origin.files

    def fed(self, law: Exportable) -> tuple[str, ...]:
        return () if self.mission is None or not _is_fed(law) else tuple(FED)

    def templates(self, law: Exportable) -> dict[str, str]:
        names = (*(MISSION_FILES if _is_fed(law) else ()), *(() if self.mission is None else (DATA,)))
        return {name: f"{name}.j2" for name in names}

    def values(self, law: Exportable, real: Real) -> dict[str, Any]:
        fed = {"fed": True, **_mission_values(law, real)} if _is_fed(law) else {}
        rows = {} if self.mission is None else {"rows": _data_rows(law, self.mission, real)}
        return _robot_wiring(law, self.origin) | fed | rows

    def entries(self, law: Exportable, p: Vector) -> dict[str, Any]:
        return {} if self.origin is None else origin_entries(law, p, self.origin)

    def lists(self, law: Exportable) -> dict[str, Listed]:
        return {} if self.origin is None else self.origin.lists(law)

    def check(self, manifest: Mapping[str, Any], files: Mapping[str, str]) -> None:
        if self.origin is not None:
            check_belonging(manifest, files, self.origin)


def build_bundle(
    law: Exportable,
    gains: Mapping[str, Vector],
    *,
    name: str | None = None,
    real: Real = "float64",
    envelope: Envelope | None = None,
    origin: Origin | None = None,
    mission: Vector | None = None,
) -> core.Bundle:
    """Return the C bundle of a control law with tuned gains.

    Args:
        gains: values of the gains by name; a gain without a value has its default.
        name: prefix of file names and C symbols; by default the name of the law.
        real: "float32" for a processor with a single-precision unit; every number in the C text is then a float.
        envelope: ranges that the input check of the exported C accepts; None accepts any finite number.
        origin: vehicle and certificates to record in the bundle.
        mission: waypoints (n, 5) of a mission for the file `mission_data.h`, see `guidance.Path.table`; None: no file.

    Raises:
        InputError: a name is not a valid C identifier, a gain is unknown or not finite, the sizes that the law declares
            differ from those of its code, a certificate is about another controller, or a float32 law calls functions
            of the C library such as sin.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.export import build_bundle
        >>> from surctl.marine.simulation import law_numbers, load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission, vehicle, gains = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
        >>> law, p = build_law("closed_form"), law_numbers(mission, gains, vehicle)
        >>> bundle = build_bundle(law, law.gains.unpack(p), real="float32")
        >>> bundle.name, bundle.real, len(bundle.sources)
        ('surctl_closed_form', 'float32', 3)
    """
    added = _Robot(origin, mission)
    return core.build_bundle(law, gains, name=name, real=real, envelope=envelope, supplement=added)


def replay_of(run: Run) -> ReplayedRun:
    """Return a run of a law for the comparison of C with Python, and for the manifest of the law's bundle."""
    mission, record, metrics = run.scenario, run.record, run.metrics
    about = {
        "scenario": mission.name,
        "vehicle": run.vehicle.name,
        "sensing": run.sensing,
        "seed": run.seed,
        "path_length_m": mission.path.length,
        "arrival_m": mission.arrival_radius,
        "obstacles": [obstacle.model_dump(mode="json", exclude_defaults=True) for obstacle in mission.obstacles],
        "stopped_because": metrics.stopped_because,
        "time_s": metrics.time_s,
        "failure": failure(run),
    }
    return ReplayedRun(
        about, Records(record.law_state, record.law_input, record.step_parameters), record.status, run.law.dt
    )
