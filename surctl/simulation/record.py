"""The record of a run that `simulate` computes, and the metrics that follow from the record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.control import Law
from surctl.simulation.metrics import NEAR_TARGET, Metrics, avoidance_intervals, path_error
from surctl.simulation.scenario import Scenario
from surctl.simulation.world import Body

__all__ = ["Record", "measure", "path_depths"]


@dataclass(frozen=True, eq=False)
class Record:
    """All recorded signals of a run, one entry per control step, for plots and for replays in other programs.

    `law_parameters` are the law's parameters; if the path is fed (`Path.fed`), `fed` has them at each control step.
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


def measure(scenario: Scenario, law: Law, record: Record, *, reason: str, least: float) -> Metrics:
    """Return the metrics of a record.

    `reason` says why the run ended; `least` is the smallest clearance [m] of the run.
    """
    where, thrust = record.eta[:, :2], record.tau[:, :2]
    follower = scenario.follower()
    away = follower.track(where)
    excluded = avoidance_intervals(record.telemetry[:, law.telemetry_slice("avoiding")].ravel(), away)
    steps = np.linalg.norm(np.diff(where, axis=0), axis=1)
    leg = scenario.target - scenario.path.waypoints[-2]
    past = (where - scenario.target) @ (leg / np.linalg.norm(leg))
    on_last = scenario.follower().legs(where) == len(scenario.path.waypoints) - 2
    near = on_last & (np.linalg.norm(where - scenario.target, axis=1) <= NEAR_TARGET)
    limit = record.law_parameters[law.gains.slice("thrust_limit")]
    jumps = np.diff(thrust, axis=0)
    return Metrics(
        reached=reason == "reached",
        time_s=round(float(record.time[-1]), 9),
        min_clearance_m=float(least),
        path_error_m=path_error(away, record.eta[:, 2] - path_depths(scenario, where), excluded),
        deviation_m=float(np.sqrt(np.mean(away**2))),
        length_m=float(steps.sum()),
        effort_n=float(np.mean(np.hypot(thrust[:, 0], thrust[:, 1]))),
        stopped_because=reason,
        max_deviation_m=float(np.max(away)),
        missed_corner_m=follower.missed,
        overshoot_m=float(np.max(past[near], initial=0.0)),
        peak_thrust_share=float(np.max(np.abs(record.tau) / limit)),
        saturated_share=float(np.mean(record.status % 2)),
        thrust_rate_n_per_s=float(np.sqrt(np.mean(np.sum(jumps**2, axis=1))) / law.dt) if len(jumps) else 0.0,
    )
