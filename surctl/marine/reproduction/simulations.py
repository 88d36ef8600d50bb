"""The simulations of the scenarios for the comparisons with the paper; each is computed once and stored."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from surctl.errors import InputError
from surctl.marine.control import Gains, load_gains
from surctl.marine.reproduction.motion import Vector
from surctl.marine.simulation import BatchResult, Case, Run, Scenario, Sensing, load_scenario, simulate, simulate_batch
from surctl.marine.simulation.scenario import LIBRARY
from surctl.marine.vehicle import load_vehicle

__all__ = ["TILTING", "Factors", "Simulations", "scenario_names"]

Factors = tuple[tuple[str, float], ...]
"""Names of vehicle parameters, and the factor for each."""

TILTING = {"sur400": "sur400-tilting", "sur540-flooded": "sur540-tilting"}
"""The vehicles of the scenarios with stated centres of gravity, buoyancy and thrust."""


def scenario_names() -> list[str]:
    """Return the names of the scenarios in the library."""
    return sorted(path.stem for path in LIBRARY.glob("*.toml"))


@dataclass(frozen=True)
class Simulations:
    """Simulations of the library's scenarios with the given gains; stored results are used again.

    Attributes:
        seeds: number of seeds (0, 1, …) that the compiled loop simulates, at least 1.
        threads: number of threads of the compiled loop.
        gains: gains of the control law.
        independent: whether each scenario is simulated in MuJoCo, too.
        webots: whether each scenario with sonars is simulated with echoes as in the paper's simulator, too.
    """

    seeds: int = 20
    threads: int = 2
    gains: Gains = field(default_factory=lambda: load_gains("default"), repr=False)
    independent: bool = False
    webots: bool = False
    _batches: dict[tuple[str, Sensing, str, Factors], BatchResult] = field(
        default_factory=dict, repr=False, compare=False
    )
    _runs: dict[tuple[str, Sensing], Run] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.seeds < 1:
            raise InputError("must be at least 1", key="seeds", value=self.seeds)

    def scenario(self, name: str) -> Scenario:
        """Return the library's scenario with the given name."""
        return load_scenario(name)

    def batch(self, name: str, sensing: Sensing, vehicle: str = "", factors: Factors = ()) -> BatchResult:
        """Return the metrics of the runs with all seeds; `vehicle` names another vehicle than the scenario's.

        The parameters of the vehicle are multiplied by `factors`.
        """
        key = (name, sensing, vehicle, factors)
        if key not in self._batches:
            scenario = self.scenario(name)
            robot = load_vehicle(vehicle or scenario.vehicle)
            robot = robot.with_values({number: factor * robot[number] for number, factor in factors})
            case = Case(scenario, robot, self.gains, sensing=sensing)
            self._batches[key] = simulate_batch(case, seeds=np.arange(self.seeds), threads=self.threads)
        return self._batches[key]

    def in_webots(self, name: str) -> BatchResult:
        """Return the metrics of the runs with sonars to which surfaces answer within 22.5° of their normal, as Webots.

        The law assumes the surface model `smooth`.
        """
        scenario = self.scenario(name)
        sensors = scenario.sensors.hearing("webots")
        sensors = replace(sensors, equipment=replace(sensors.equipment, surface_model="smooth"))
        case = Case(replace(scenario, sensors=sensors), load_vehicle(scenario.vehicle), self.gains, sensing="sonar")
        return simulate_batch(case, seeds=np.arange(self.seeds), threads=self.threads)

    def run(self, name: str, sensing: Sensing = "truth") -> Run:
        """Return the run of the reference loop with seed 0, including the recorded signals."""
        key = (name, sensing)
        if key not in self._runs:
            scenario = self.scenario(name)
            vehicle = load_vehicle(scenario.vehicle)
            self._runs[key] = simulate(scenario, vehicle, gains=self.gains, sensing=sensing)
        return self._runs[key]

    def in_engine(self, name: str, sensing: Sensing) -> Run:
        """Return the run with seed 0 in MuJoCo, with six degrees of freedom if the library states the centres."""
        from surctl.marine.engine import mujoco_physics

        scenario = self.scenario(name)
        vehicle = load_vehicle(TILTING.get(scenario.vehicle, scenario.vehicle))
        return simulate(scenario, vehicle, gains=self.gains, sensing=sensing, physics=mujoco_physics())

    def arrived(self, name: str, sensing: Sensing, metric: str, factors: Factors = ()) -> Vector:
        """Return the values (k,) of a metric for the k runs that arrived."""
        batch = self.batch(name, sensing, factors=factors)
        values: Vector = batch.column(metric)[batch.column("reached") > 0.5]
        return values
