"""One run of a campaign for the reference loop, and plans of many runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from surctl.simulation.batch import Case
from surctl.simulation.loop import simulate
from surctl.simulation.run import Run

__all__ = ["Plan", "SampledRun", "SeededPlan"]

Columns = Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True)
class SampledRun:
    """One random run of a campaign.

    Attributes:
        case: the case with the scenario of this run; its vehicle is the law's model unless `case.model` is set.
        seed: seed of all remaining random choices.
        draw: parameters of the simulated vehicle that differ from the case's vehicle, by name, in the file's units.
    """

    case: Case
    seed: int = 0
    draw: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    def simulate(self) -> Run:
        """Simulate the run in the reference loop.

        Raises:
            InputError: the hull starts inside an obstacle, or a drawn number is outside the range in the vehicle file.
        """
        case = self.case
        return simulate(
            case.scenario,
            case.vehicle.with_values(self.draw),
            gains=case.gains,
            law=case.build(),
            sensing=case.sensing,
            seed=self.seed,
            model=case.model or case.vehicle,
        )


@dataclass(frozen=True)
class SeededPlan:
    """Base of all plans that draw each run from a seed; run k has the seed `first` + k.

    Attributes:
        case: the compiled case; every run is this case except for its draws.
        first: seed of the first run, at least 0.
    """

    case: Case
    first: int = 0

    @property
    def name(self) -> str:
        """Name of the scenario."""
        return self.case.scenario.name

    def seeds(self, first: int, count: int) -> NDArray[np.int64]:
        """Return the seeds of `count` runs, see `Plan.seeds`."""
        return np.arange(self.first + first, self.first + first + count)


class Plan(Protocol):
    """The runs of a campaign; run k depends only on k."""

    @property
    def name(self) -> str:
        """Name of the campaign."""

    @property
    def case(self) -> Case:
        """The compiled case; every run is this case with its own values."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that the plan draws."""

    def seeds(self, first: int, count: int) -> NDArray[np.int64]:
        """Return the seeds (count,) of the runs from number `first` on."""

    def values(self, first: int, count: int) -> Columns:
        """Return the drawn values (count,) of these runs by parameter name."""

    def run(self, k: int) -> SampledRun:
        """Return run k as a single run for the reference loop."""

    def settings(self) -> Mapping[str, object]:
        """Return the settings that the runs depend on besides the case, as plain data."""
