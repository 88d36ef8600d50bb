"""One run of a campaign, as the reference loop flies it, and what plans of many runs are."""

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
    """A drawn run.

    Attributes:
        case: its own scenario, and the vehicle as the law believes it.
        seed: of every random choice that is left.
        draw: numbers of the vehicle that is flown, by name, where they differ from the case's, in its file's units.
    """

    case: Case
    seed: int = 0
    draw: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    def simulate(self) -> Run:
        """Fly it in the reference loop.

        Raises:
            InputError: the hull starts inside an obstacle, or a number outside the range that its file states.
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
    """What all plans are that draw each run from a seed; run k flies seed `first` + k.

    Attributes:
        case: what is compiled, and what every run is but for its draws.
        first: seed of the first run, at least 0.
    """

    case: Case
    first: int = 0

    @property
    def name(self) -> str:
        """The scenario's."""
        return self.case.scenario.name

    def seeds(self, first: int, count: int) -> NDArray[np.int64]:
        """See `Plan`."""
        return np.arange(self.first + first, self.first + first + count)


class Plan(Protocol):
    """Which runs a campaign flies; run k depends on k alone."""

    @property
    def name(self) -> str:
        """Of the campaign."""

    @property
    def case(self) -> Case:
        """What is compiled: every run is this case with values of its own."""

    @property
    def names(self) -> tuple[str, ...]:
        """Knobs whose values it draws."""

    def seeds(self, first: int, count: int) -> NDArray[np.int64]:
        """(count,) seeds of the runs from `first` on."""

    def values(self, first: int, count: int) -> Columns:
        """Their values by knob name, (count,) each."""

    def run(self, k: int) -> SampledRun:
        """Run k by itself."""

    def settings(self) -> Mapping[str, object]:
        """What the runs depend on besides the case, as plain data."""
