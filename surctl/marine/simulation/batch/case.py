"""A case: scenario, vehicle and law of a batch; numbers of the law; parameters that a sweep may change, with bounds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.marine.control import (
    Barrier,
    Gains,
    Law,
    Movers,
    build_law,
    check_forces,
    default_law,
    law_options,
    law_ref,
    law_source,
)
from surctl.marine.control.ports import law_parameters
from surctl.marine.guidance import AvoidanceForm, Guidance
from surctl.marine.simulation.obstacle import Obstacle
from surctl.marine.simulation.run import Sensing
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.simulation.thruster_faults import check_failed
from surctl.marine.vehicle import SPECS, Vehicle
from surctl.priority import Mode

Vector = NDArray[np.float64]


def vehicle_law(vehicle: Vehicle, law: str = "", scenario: Scenario | None = None, **options: Any) -> Law:
    """Build the law that controls a vehicle, with allocation to its thrusters, if it has any.

    Args:
        vehicle: the vehicle.
        law: reference of the law; empty: the law for the vehicle's forces, see `default_law`.
        scenario: the mission, which has the sensors of a law with sonars and may allow other depths; or None.
        options: further arguments of `build_law`.

    Raises:
        InputError: the vehicle lacks a force that the law needs; or as for `build_law`.

    Example:
        >>> from surctl.marine.simulation import vehicle_law
        >>> from surctl.marine.vehicle import load_vehicle
        >>> vehicle_law(load_vehicle("bluerov2-thrusters")).outputs.port("thruster_force").shape
        (6,)
    """
    law = law or default_law(vehicle)
    check_forces(law, vehicle)
    if scenario is not None:
        options |= {"equipment": scenario.sensors.on(vehicle["radius"]), "depths": scenario.depths is not None}
    return build_law(law, actuators=vehicle.actuators, **options)


VISITED = 0.5
"""Share of the visit distance within which the law counts a corner as visited by its measured position (*chosen*).

The rest of the distance covers the error of that position.
"""


def law_numbers(scenario: Scenario, gains: Gains, model: Vehicle) -> NDArray[np.float64]:
    """Return the law's parameter vector, packed as in `PARAMETERS`, from a scenario, gains and the law's vehicle model.

    If the path is fed (`Path.fed`), waypoints, depth, cruise speed and visits are those of its first window.

    Example:
        >>> from surctl.marine.control import PARAMETERS, load_gains
        >>> from surctl.marine.simulation import law_numbers, load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> p = law_numbers(load_scenario("pool-behind"), load_gains("default"), load_vehicle("sur400"))
        >>> [p[PARAMETERS.slice(name)].tolist() for name in ("cruise", "depth", "walls")]
        [[0.15], [-0.15], [0.0, 3.0, 0.0, 2.0]]
    """
    length, width, _ = scenario.site
    return law_parameters(
        gains,
        model,
        path=scenario.path,
        depth=scenario.depth,
        cruise=scenario.cruise,
        cap=scenario.cap,
        walls=(0.0, length, 0.0, width),
        launch=scenario.launch,
        visit=0.0 if scenario.visit is None else VISITED * scenario.visit,
    )


def fed_ranges(scenario: Scenario) -> dict[str, tuple[float, float]]:
    """Return the range of each parameter that changes along the path; empty if the parameters stay as they are."""
    path = scenario.path
    if not path.fed:
        return {}
    speeds = path.table()[1:, 3]
    cruise = [scenario.cruise, *speeds[speeds > 0].tolist()]
    return {
        "waypoints": (float(path.waypoints.min()), float(path.waypoints.max())),
        "depth": scenario.depth_range,
        "cruise": (min(cruise), max(cruise)),
        "visit": (0.0, 0.0 if scenario.visit is None else VISITED * scenario.visit),
    }


@dataclass(frozen=True)
class Case:
    """One simulation setup: a scenario with one vehicle and one law.

    Attributes:
        scenario: the mission.
        vehicle: the simulated vehicle.
        gains: the law's gains; if the law defines additional gains, missing ones take their defaults.
        law: text that identifies the law, see `law_ref`; empty: the law for the vehicle's forces, see `default_law`.
        avoidance, mode, guidance, barrier, movers: further options of the law, as for `build_law`.
        failed: names of thrusters that have failed from the start, which the law knows.
        sensing: kind of sensing: `truth` (exact positions) or `sonar`, as for `simulate`.
        model: vehicle model of the controller; None: the simulated vehicle.
    """

    scenario: Scenario
    vehicle: Vehicle
    gains: Gains
    law: str = ""
    mode: Mode = "nsb"
    sensing: Sensing = "truth"
    model: Vehicle | None = None
    avoidance: AvoidanceForm = "corrected"
    guidance: Guidance = "los"
    barrier: Barrier = "simple"
    movers: Movers = "predict"
    failed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_failed(self.vehicle, self.failed)
        law = self.law or default_law(self.vehicle)
        object.__setattr__(self, "law", law_ref(law))  # pinned to the text of its file, if it is of the user's own
        check_forces(self.law, self.vehicle)
        object.__setattr__(self, "gains", self.gains.with_own(law_source(self.law).gains))

    @property
    def name(self) -> str:
        """Name of the simulation setup: scenario, vehicle and sensing."""
        return f"{self.scenario.name}/{self.vehicle.name}/{self.sensing}"

    @property
    def known_as(self) -> tuple[str, str]:
        """Names by which a goal may name it: the setup, or its scenario."""
        return self.name, self.scenario.name

    @property
    def options(self) -> dict[str, str]:
        """Options of the law, and the kind of sensing, by their names in files of results."""
        return {
            "avoidance": self.avoidance, "guidance": self.guidance, "priority_mode": self.mode,
            "barrier": self.barrier, "movers": self.movers, "sensing": self.sensing,
        }  # fmt: skip

    def build(self, fallback: str = "exact") -> Law:
        """Build the law of the simulation setup, with a `fallback` as for `build_law`."""
        kind = {"sonar": self.sensing == "sonar", "fallback": fallback, **law_options(self)}
        return vehicle_law(self.vehicle, self.law, self.scenario, **kind)


@dataclass(frozen=True)
class CaseParameter:
    """A parameter (number) of the simulation setup that a batch can change.

    Attributes:
        name: such as `k_v`, `vehicle.m11` (plant and model), `plant.m11` (plant only), `scenario.cruise` or
            `obstacle.NAME.speed`.
        unit, meaning, value: SI unit, description, and value before any change.
        low, high: bounds of the parameter; `low` itself is not allowed if `open_below` is true.
        range: range that the vehicle file states for the parameter, or None.
    """

    name: str
    unit: str
    meaning: str
    value: float
    low: float = -inf
    high: float = inf
    open_below: bool = False
    range: tuple[float, float] | None = None

    def check(self, values: Vector) -> None:
        """Raise InputError unless every value is finite and within the parameter's bounds."""
        good = np.isfinite(values) & (values <= self.high)
        good &= (values > self.low) if self.open_below else (values >= self.low)
        if not good.all():
            least = f"greater than {self.low:g}" if self.open_below else f"at least {self.low:g}"
            bounds = [least] if self.low > -inf else []
            bounds += [f"at most {self.high:.3g}"] if self.high < inf else []
            problem = "must be " + " and ".join(bounds or ["finite"])
            remedy = f"{self.meaning}, in {self.unit}"
            raise InputError(problem, key=self.name, value=float(values[~good][0]), remedy=remedy)


def case_parameters(case: Case) -> Mapping[str, CaseParameter]:
    """Return every parameter of the simulation setup that a batch can change, by name."""
    listed = [
        CaseParameter(name, spec.unit, spec.meaning, case.gains.values[name], 0.0, spec.below, not spec.zero_allowed)
        for name, spec in case.gains.specs.items()
    ]
    for name, known in case.vehicle.parameters.items():
        spec = SPECS[name]
        least, above = -inf if spec.signed else 0.0, not spec.zero_allowed
        only = f"{spec.meaning}, of the simulated vehicle only; the controller keeps its model"
        for kind, meaning in (("vehicle", spec.meaning), ("plant", only)):
            listed.append(
                CaseParameter(f"{kind}.{name}", spec.unit, meaning, known.value, least, inf, above, known.range)
            )
    listed += _scenario_parameters(case.scenario)
    for obstacle in case.scenario.obstacles:
        listed += _obstacle_parameters(obstacle, case.vehicle)
    return {parameter.name: parameter for parameter in listed}


def _scenario_parameters(scenario: Scenario) -> list[CaseParameter]:
    d, chances, radius = scenario.disturbance, scenario.sensors.chances, scenario.arrival_radius
    # name, unit, meaning, value; then low, high, and whether low is excluded
    rows: tuple[tuple[Any, ...], ...] = (
        ("cruise", "m/s", "desired speed along the path", scenario.cruise, 0.0, inf, True),
        ("cap", "m/s", "largest commanded horizontal speed", scenario.cap, 0.0, inf, True),
        ("depth", "m", "desired z, negative below the surface", scenario.depth, -scenario.site[2], 0.0),
        ("arrival_radius", "m", "distance to the target that counts as arrived", radius, 0.0, inf, True),
        ("time_limit", "s", "longest duration of a run", scenario.time_limit, 0.0, 1e6, True),
        ("current_x", "m/s", "current along x of {E}", d.current_m_per_s[0]),
        ("current_y", "m/s", "current along y of {E}", d.current_m_per_s[1]),
        ("wave_force", "N", "amplitude of the wave force", d.wave_force_n, 0.0),
        ("wave_period", "s", "period of the waves", d.wave_period_s, 0.0, inf, True),
        ("drift_force", "N", "amplitude of the slow drift force", d.drift_force_n, 0.0),
        ("drift_period", "s", "period of the slow drift force", d.drift_period_s, 0.0, inf, True),
        ("thrust_error", "1", "largest relative thrust error of an axis", d.thrust_error, 0.0, 1.0),
        ("thrust_bias", "1", "largest thrust bias of an axis, as a share of its limit", d.thrust_bias, 0.0, 1.0),
    )
    return [
        *(
            CaseParameter(f"sonar.{kind}", "1", f"probability of fault {kind} per sonar firing", chance, 0.0, 1.0)
            for kind, chance in zip(chances.kinds(), chances.numbers, strict=True)
        ),
        *(CaseParameter(f"scenario.{name}", *rest) for name, *rest in rows),
    ]


def _obstacle_parameters(obstacle: Obstacle, vehicle: Vehicle) -> list[CaseParameter]:
    # name, unit, meaning, value; then low, high, and whether low is excluded
    positive = (0.0, inf, True)
    rows: list[tuple[Any, ...]] = [
        ("x", "m", "centre of the obstacle at the start, x in {E}", obstacle.centre_m[0]),
        ("y", "m", "centre of the obstacle at the start, y in {E}", obstacle.centre_m[1]),
        ("there", "1", "1 if the obstacle is in the water, 0 if it is left out", 1.0, 0.0, 1.0),
    ]
    if obstacle.size_m is not None:
        edges = zip("xy", obstacle.size_m, strict=True)
        rows += [(f"size_{k}", "m", f"edge length of the box along {k} of {{E}}", edge, *positive) for k, edge in edges]
    else:
        rows.append(("radius", "m", "radius of the obstacle", obstacle.radius_m or vehicle["radius"], *positive))
    if obstacle.shape == "moving":
        to_x, to_y = obstacle.to_m or obstacle.centre_m
        rows += [
            ("to_x", "m", "end of the obstacle's motion, x in {E}", to_x),
            ("to_y", "m", "end of the obstacle's motion, y in {E}", to_y),
            ("speed", "m/s", "speed of the obstacle", float(obstacle.speed_m_per_s or 0.0), *positive),
        ]
    else:
        rows += [
            ("drift", "m", "amplitude of the obstacle's drift", obstacle.drift_m, 0.0),
            ("drift_period", "s", "period of the obstacle's drift", obstacle.drift_period_s, *positive),
        ]
    return [CaseParameter(f"obstacle.{obstacle.name}.{name}", *rest) for name, *rest in rows]


def check_values(case: Case, values: Mapping[str, Vector]) -> None:
    """Raise InputError for an unknown parameter, or for a value outside its bounds."""
    known = case_parameters(case)
    for name, column in values.items():
        if name not in known:
            raise InputError("no such parameter in the case", key=name, value=case.name, remedy=nearest(name, known))
        known[name].check(column)
    check_speeds(case, values)


def check_speeds(case: Case, values: Mapping[str, Vector]) -> None:
    """Raise InputError if the cruise speed is above the speed cap, the largest speed that the law may command."""
    at = {name: values.get(f"scenario.{name}", getattr(case.scenario, name)) for name in ("cruise", "cap")}
    if np.any(np.greater(at["cruise"], at["cap"])):
        raise InputError(
            "is above scenario.cap", key="scenario.cruise", value=float(np.max(at["cruise"])), remedy="lower it"
        )
