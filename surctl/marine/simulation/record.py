"""The record of a run that `simulate` computes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.marine.simulation.scenario import Scenario
from surctl.marine.simulation.world import Body

__all__ = ["Record", "path_depths"]


@dataclass(frozen=True, eq=False)
class Record:
    """All recorded signals of a run, one entry per control step, for plots and for replays in other programs.

    `law_parameters` are the law's parameters; if the path is fed (`Path.fed`), `fed` has them at each control step.
    `tilt` is roll and pitch (n, 2) [rad] of a hull that rolls and pitches, else None.
    """

    time: NDArray[np.float64]
    eta: NDArray[np.float64]
    nu: NDArray[np.float64]
    tau: NDArray[np.float64]
    clearance: NDArray[np.float64]
    law_state: NDArray[np.float64]
    law_input: NDArray[np.float64]
    law_parameters: NDArray[np.float64]
    status: NDArray[np.int_]
    telemetry: NDArray[np.float64]
    obstacles: Sequence[Sequence[Body]]
    fed: NDArray[np.float64] | None = None
    tilt: NDArray[np.float64] | None = None

    @property
    def step_parameters(self) -> NDArray[np.float64]:
        """The law's parameters (np,), or at each control step (n, np) if the path is fed."""
        return self.law_parameters if self.fed is None else self.fed

    def parameters_at(self, k: int) -> NDArray[np.float64]:
        """Return the law's parameters (np,) at control step `k`."""
        return self.law_parameters if self.fed is None else self.fed[k]


def path_depths(scenario: Scenario, where: NDArray[np.float64]) -> NDArray[np.float64] | float:
    """Return z of the path [m] at the robot's progress, for its positions (n, 2) in turn; one number if it is level."""
    return scenario.depth if scenario.path.rises is None else scenario.depth + scenario.follower().rises(where)
