"""How far the thrusters of a run delivered the commands, and which of them were at their limits."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from surctl.marine.simulation.run import Run
from surctl.marine.vehicle import axis_limits

__all__ = ["ThrusterUse", "thruster_use"]

_MISSED = 1e-6  # share of the largest thruster force
_AT_LIMIT = 1e-9


@dataclass(frozen=True)
class ThrusterUse:
    """The use of the thrusters over a run.

    Attributes:
        missed: share of the control steps in which force or yaw moment stay behind the command.
        lack: largest difference between command and achieved value: F_u, F_v, F_w [N], F_r [N m].
        at_limit: share of the control steps in which each thruster is at a limit.
    """

    missed: float
    lack: tuple[float, ...]
    at_limit: dict[str, float]

    def line(self) -> str:
        """Return the use as one line of text."""
        busiest = max(self.at_limit, key=self.at_limit.__getitem__)
        limit = f"{busiest} at a limit in {self.at_limit[busiest]:.1%} of the steps"
        if self.missed == 0:
            return f"thrusters: every command reached; {limit}"
        u, v, w, r = self.lack
        amount = f"by up to {max(u, v, w):.3g} N and {r:.3g} N m"
        return f"thrusters: command missed in {self.missed:.1%} of the steps, {amount}; {limit}"

    def to_dict(self) -> dict[str, Any]:
        """Return the use as plain data for JSON."""
        return asdict(self)


def thruster_use(run: Run) -> ThrusterUse | None:
    """Return the use of the thrusters over a run; None for a law without allocation.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import ThrusterFault, load_scenario, simulate, thruster_use
        >>> from surctl.marine.vehicle import load_vehicle
        >>> boat, faults = load_vehicle("bluerov2-heavy"), [ThrusterFault("T2"), ThrusterFault("T3")]
        >>> run = simulate(load_scenario("pool-behind"), boat, gains=load_gains("default"), thruster_faults=faults)
        >>> thruster_use(run).missed > 0.1
        True
    """
    actuators = run.law.actuators
    if actuators is None:
        return None
    lack = np.abs(run.telemetry("tau_desired") - run.record.tau)
    lack[lack < 1e-9] = 0.0
    if actuators.fins:  # the side force of a rudder is not commanded
        lack[:, axis_limits(actuators, 1.0) <= 0] = 0.0
    unit = actuators.largest * np.array([1.0, 1.0, 1.0, actuators.lever])
    commands = np.abs(run.telemetry("thruster_command"))
    shares = (commands >= 1 - _AT_LIMIT).mean(axis=0)
    return ThrusterUse(
        float((lack > _MISSED * unit).any(axis=1).mean()),
        tuple(lack.max(axis=0).tolist()),
        dict(zip(actuators.names, shares.tolist(), strict=True)),
    )
