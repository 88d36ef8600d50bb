"""A simulated run: its recorded signals, and its changes of depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from surctl.marine.control import Gains, Law
from surctl.marine.simulation.metrics import Metrics
from surctl.marine.simulation.physics import Contact
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.simulation.world import Body
from surctl.marine.vehicle import Vehicle
from surctl.own_code import label

Sensing = Literal["sonar", "truth"]
SENSING: tuple[Sensing, ...] = get_args(Sensing)


@dataclass(frozen=True)
class DepthChange:
    """A change of depth at a fixed horizontal position; it begins at `time_s` [s].

    Attributes:
        place_m: position (x, y) in the earth frame {E} [m].
        from_m, to_m: z of the old depth and z of the new depth [m].
        back: whether the new depth is the path's depth.
    """

    time_s: float
    place_m: tuple[float, float]
    from_m: float
    to_m: float
    back: bool

    def __str__(self) -> str:
        """Return the depth change as one line of text without a full stop."""
        what = "back to the path's depth" if self.back else "search for a passage at another depth"
        x, y = self.place_m
        return f"{self.time_s:6.2f} s  at ({x:.2f}, {y:.2f}) m from z {self.from_m:.2f} to {self.to_m:.2f} m: {what}"

    def to_dict(self) -> dict[str, Any]:
        """Return the depth change as plain data for JSON."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Run:
    """One closed-loop run: its scenario, vehicle, law, metrics and record of signals.

    `replaced` is true if a stepper computed the commands in place of the law (argument `stepper` of `simulate`).
    `plant` names what moved the hull (argument `physics` of `simulate`), and `contacts` are the contacts that it found.
    """

    scenario: Scenario
    vehicle: Vehicle
    gains: Gains
    law: Law
    sensing: Sensing
    seed: int
    metrics: Metrics
    record: Record = field(repr=False)
    replaced: bool = False
    plant: str = "own"
    contacts: tuple[Contact, ...] = ()

    def telemetry(self, name: str) -> NDArray[np.float64]:
        """Return the values (n, size) over time of the law's telemetry output with the given name."""
        return self.record.telemetry[:, self.law.telemetry_slice(name)]

    def to_dict(self) -> dict[str, Any]:
        """Return the run as plain data for the command line; the JSON writer converts numbers that are not finite."""
        tilted = {}
        if self.record.tilt is not None:
            roll, pitch = np.rad2deg(np.abs(self.record.tilt).max(axis=0)).tolist()
            tilted = {"max_roll_deg": roll, "max_pitch_deg": pitch}
        return (
            {
                "scenario": self.scenario.name,
                "vehicle": self.vehicle.name,
                "law": label(self.law.ref),
                "replaced": self.replaced,
                "avoidance": self.law.avoidance,
                "guidance": self.law.guidance,
                "sensing": self.sensing,
                "priority_mode": self.law.mode,
                "fallback": self.law.fallback,
                "barrier": self.law.barrier,
                "movers": self.law.movers,
                "seed": self.seed,
                **asdict(self.metrics),
                "paper_time_s": self.scenario.paper.time_s,
                "plant": self.plant,
                "contacts": [contact._asdict() for contact in self.contacts],
            }
            | tilted
            | ({"depth_changes": [d.to_dict() for d in depth_changes(self)]} if self.scenario.depths else {})
        )


def depth_changes(run: Run) -> list[DepthChange]:
    """Return all depth changes of a run in order; the list is empty if the law stays at the path's depth."""
    if "depth_reference" not in run.law.outputs:
        return []
    reference, record = run.telemetry("depth_reference").ravel(), run.record
    dead_end = run.telemetry("trapped").ravel() > 0.5
    changes, last = list[DepthChange](), run.scenario.depth
    turns = (np.flatnonzero(np.diff(reference) != 0) + 1).tolist()
    for k, until in pairwise([*turns, len(reference) + 1]):
        # the law drops an unreachable depth in the next step; after it gives up, it stays at its present depth
        if until - k < 2 or dead_end[k]:
            continue
        x, y, to = float(record.eta[k, 0]), float(record.eta[k, 1]), float(reference[k])
        changes.append(DepthChange(float(record.time[k]), (x, y), last, to, to == run.scenario.depth))
        last = to
    return changes


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
