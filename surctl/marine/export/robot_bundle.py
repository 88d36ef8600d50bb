"""The bundle of a law of the robot: wiring of its sensors in the README, and missions as C data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from math import cos, degrees, expm1, log1p, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.export import bundle as core
from surctl.export.contract import DATA, MISSION_FILES, Exportable
from surctl.export.envelope import Envelope, Records
from surctl.export.evidence import ReplayedRun
from surctl.export.supplement import Listed, Supplement
from surctl.ir import Real, c_literal
from surctl.marine.control import ARC_LENGTHS, FED
from surctl.marine.control.beams import SURE
from surctl.marine.export.origin import Origin, check_belonging, origin_entries
from surctl.marine.guidance import AT_CORNER, MAX_WAYPOINTS, ROW
from surctl.marine.guidance.following import SHORTEST
from surctl.marine.sensing import INCIDENCE_LIMIT, SonarArray
from surctl.marine.sensing.localisation.own_state import LONGEST_AGE, LONGEST_LATENCY
from surctl.marine.simulation import Run
from surctl.marine.simulation.explanation import failure
from surctl.marine.vehicle import Vehicle


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


def _robot_wiring(law: Exportable, origin: Origin | None) -> dict[str, Any]:
    """Return what is known of the wiring of a law of the robot, beyond `wiring_values`."""
    vehicle, equipment = (None, None) if origin is None else (origin.vehicle, origin.equipment)
    actuators = None if vehicle is None else vehicle.actuators
    return {
        "wiring": "robot_wiring.md.j2",
        "equipment": equipment,
        "vehicle": vehicle,
        "apex": [] if equipment is None or vehicle is None else _apex(equipment.array, vehicle),
        "incidence": degrees(INCIDENCE_LIMIT),
        "sure": degrees(SURE),
        "thrusters": actuators.thrusters if actuators is not None and "working" in law.inputs else (),
        "own_age": "own_age" in law.state,
        "own_known": "own_known" in law.state,
        "oldest_fix": f"{LONGEST_LATENCY:g}",
        "never_fixed": f"{LONGEST_AGE:g}",
        "arriving": "progress" in law.state,
        "stalling": [count for count in ("stalled", "searching") if count in law.state],
        "listening": "samples" in law.inputs,
        "coasting": () if vehicle is None else _coasting(vehicle),
    }


def _apex(array: SonarArray, vehicle: Vehicle) -> list[tuple[tuple[float, float], float]]:
    """Return the place on the hull (2,) [m] and the direction [deg] of each sonar."""
    radius = vehicle["radius"]
    places = array.mounts or [(radius * cos(a), radius * sin(a)) for a in array.azimuths]
    return [((x + 0.0, y + 0.0), degrees(a)) for (x, y), a in zip(np.round(places, 6), array.azimuths, strict=True)]


def _coasting(vehicle: Vehicle, speed: float = 0.2) -> tuple[float, ...]:
    """Return how far the robot coasts in 10 s and in 60 s [m] from this speed [m/s] in still water, without thrust."""
    # m du/dt = -(D + D₂ u) u along x: a = D / m, b = D₂ / m
    mass, linear, quadratic = (float(v[0]) for v in (vehicle.mass, vehicle.linear_drag, vehicle.quadratic_drag))
    a, b = linear / mass, quadratic / mass
    return () if a <= 0.0 or b <= 0.0 else tuple(log1p(b * speed * -expm1(-a * t) / a) / b for t in (10.0, 60.0))


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
