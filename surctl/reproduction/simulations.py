"""The flights behind the rows of the scenarios, each flown once."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from surctl.control import Gains, load_gains
from surctl.errors import InputError
from surctl.reproduction.motion import Vector
from surctl.simulation import BatchResult, Case, Run, Scenario, Sensing, load_scenario, simulate, simulate_batch
from surctl.simulation.scenario import LIBRARY
from surctl.vehicle import load_vehicle

__all__ = ["Factors", "Simulations", "scenario_names"]

Factors = tuple[tuple[str, float], ...]
"""Numbers of a vehicle, and what each is multiplied with."""


def scenario_names() -> list[str]:
    """The scenarios of the library."""
    return sorted(path.stem for path in LIBRARY.glob("*.toml"))


@dataclass(frozen=True)
class Simulations:
    """Flies the library's scenarios with the default gains, and remembers what it has flown.

    Attributes:
        seeds: number of seeds 0, 1, … of the compiled loop, at least 1.
        threads: of the compiled loop.
    """

    seeds: int = 20
    threads: int = 2
    gains: Gains = field(default_factory=lambda: load_gains("default"), repr=False)
    _batches: dict[tuple[str, Sensing, str, Factors], BatchResult] = field(
        default_factory=dict, repr=False, compare=False
    )
    _runs: dict[tuple[str, Sensing], Run] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.seeds < 1:
            raise InputError("must be at least 1", key="seeds", value=self.seeds)

    def scenario(self, name: str) -> Scenario:
        """The scenario of that name."""
        return load_scenario(name)

    def batch(self, name: str, sensing: Sensing, vehicle: str = "", factors: Factors = ()) -> BatchResult:
        """Metrics of all seeds; by the scenario's own vehicle or another, with numbers of it times these factors."""
        key = (name, sensing, vehicle, factors)
        if key not in self._batches:
            scenario = self.scenario(name)
            robot = load_vehicle(vehicle or scenario.vehicle)
            robot = robot.with_values({number: factor * robot[number] for number, factor in factors})
            case = Case(scenario, robot, self.gains, sensing=sensing)
            self._batches[key] = simulate_batch(case, seeds=np.arange(self.seeds), threads=self.threads)
        return self._batches[key]

    def run(self, name: str, sensing: Sensing = "truth") -> Run:
        """The reference loop with seed 0, with its record."""
        key = (name, sensing)
        if key not in self._runs:
            scenario = self.scenario(name)
            vehicle = load_vehicle(scenario.vehicle)
            self._runs[key] = simulate(scenario, vehicle, gains=self.gains, sensing=sensing)
        return self._runs[key]

    def arrived(self, name: str, sensing: Sensing, metric: str, factors: Factors = ()) -> Vector:
        """A metric (k,) of the runs that arrived."""
        batch = self.batch(name, sensing, factors=factors)
        values: Vector = batch.column(metric)[batch.column("reached") > 0.5]
        return values
