"""A simulated run, with the times and positions of its depth changes."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from surctl.marine.control import Gains, Law
from surctl.marine.simulation.attitude import Attitude, attitude_of
from surctl.marine.simulation.metrics import Metrics
from surctl.marine.simulation.physics import Contact
from surctl.marine.simulation.record import Record
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.vehicle import Vehicle
from surctl.own_code import label

__all__ = ["SENSING", "DepthChange", "Run", "Sensing", "depth_changes"]

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

    @property
    def attitude(self) -> Attitude | None:
        """Crab angle, heading error and sway oscillation; None for a law that turns the hull to scan with sonars."""
        if self.law.perception is not None:
            return None
        record, scenario = self.record, self.scenario
        return attitude_of(scenario.follower(), scenario.cruise, record.time, record.eta, record.nu)

    def to_dict(self) -> dict[str, Any]:
        """Return the run as plain data for the command line; the JSON writer converts numbers that are not finite."""
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
                "attitude": None if (attitude := self.attitude) is None else attitude.to_dict(),
                "paper_time_s": self.scenario.paper.time_s,
                "plant": self.plant,
                "contacts": [contact._asdict() for contact in self.contacts],
            }
            | self._tilted()
            | ({"depth_changes": [d.to_dict() for d in depth_changes(self)]} if self.scenario.depths else {})
        )

    def _tilted(self) -> dict[str, float]:
        # largest roll and pitch, and largest error of depth, if the hull rolls and pitches
        if self.record.tilt is None:
            return {}
        roll, pitch = np.rad2deg(np.abs(self.record.tilt).max(axis=0)).tolist()
        return {"max_roll_deg": roll, "max_pitch_deg": pitch}


def depth_changes(run: Run) -> list[DepthChange]:
    """Return all depth changes of a run in order; the list is empty if the law stays at the path's depth.

    Example:
        >>> from dataclasses import replace
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import Obstacle, depth_changes, load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> sill = Obstacle(name="sill", shape="box", centre_m=(2.0, 1.0), size_m=(0.2, 2.0), top_m=-1.0)
        >>> mission = replace(load_scenario("pool-behind"), obstacles=(sill,), depth=-1.1, depths=(-2.0, -0.2))
        >>> run = simulate(mission, load_vehicle("sur400"), gains=load_gains("default").with_values({"patience": 2.0}))
        >>> [(round(change.from_m, 2), round(change.to_m, 2), change.back) for change in depth_changes(run)]
        [(-1.1, -0.65, False), (-0.65, -1.1, True)]
    """
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
