"""A single random run of a campaign, and plans that generate many random runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from surctl.marine.simulation.batch import Case
from surctl.marine.simulation.loop import simulate
from surctl.marine.simulation.run import Run

__all__ = ["Plan", "SampledRun", "SeededPlan"]

Columns = Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True)
class SampledRun:
    """One random run of a campaign.

    Attributes:
        case: the setup with the scenario of this run; its vehicle is the law's model unless `case.model` is set.
        seed: seed of all random choices except those in `draw`.
        draw: parameters in which the simulated vehicle differs from the vehicle of `case`, by name, in the units of the
            vehicle file.
    """

    case: Case
    seed: int = 0
    draw: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    def simulate(self) -> Run:
        """Simulate the run with `simulate`, that is, without compiled code.

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
    """Base class of all plans that draw every run from a seed; run k has the seed `first` + k.

    Attributes:
        case: the setup whose loop is compiled; the runs differ from this setup only in the drawn values.
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
    """Interface of a plan, which generates the runs of a campaign; run number k depends only on k."""

    @property
    def name(self) -> str:
        """Name of the campaign."""

    @property
    def case(self) -> Case:
        """The setup whose loop is compiled; every run is this setup with different parameter values."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that the plan draws at random."""

    def seeds(self, first: int, count: int) -> NDArray[np.int64]:
        """Return the seeds (count,) of the runs from number `first` on."""

    def values(self, first: int, count: int) -> Columns:
        """Return the drawn values (count,) of the runs from number `first` on, by parameter name."""

    def run(self, k: int) -> SampledRun:
        """Return run number k as a single run, which can be simulated without compiled code."""

    def settings(self) -> Mapping[str, object]:
        """Return the settings, besides the setup, that the runs depend on, as plain data."""
