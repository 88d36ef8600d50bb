"""Failures of thrusters in a run, the thrust that the vehicle's thrusters deliver, and how hard a run uses them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir.native import runnable
from surctl.marine.allocation import working_flags
from surctl.marine.allocation.program import allocation_block
from surctl.marine.control import Law
from surctl.marine.simulation.run import Run
from surctl.marine.vehicle import Actuators, Vehicle
from surctl.marine.vehicle.thruster_file import axis_limits

Array = NDArray[np.float64]

_SLACK = 1e-6  # [s] tolerance of a fault's times, because times are rounded sums of control periods


@dataclass(frozen=True)
class ThrusterFault:
    """The failure of one thruster: it gives no force from `start` on for `duration` [s].

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import ThrusterFault, load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> run = simulate(
        ...     load_scenario("pool-behind"),
        ...     load_vehicle("bluerov2-heavy"),
        ...     gains=load_gains("default"),
        ...     thruster_faults=[ThrusterFault("T2", start=2.0)],
        ... )
        >>> run.metrics.reached, run.telemetry("thruster_force")[-1][1].tolist()
        (True, 0.0)
    """

    thruster: str
    start: float = 0.0
    duration: float = inf

    def to_dict(self) -> dict[str, object]:
        """Return the fault as plain data for JSON; a fault without end has no duration."""
        duration = None if self.duration == inf else self.duration
        return {"thruster": self.thruster, "start_s": self.start, "duration_s": duration}

    def acts(self, time: float) -> bool:
        """Return whether the thruster has failed at `time` [s]."""
        return self.start - _SLACK <= time < self.start + self.duration - _SLACK


@dataclass(frozen=True, eq=False)
class Thrusters:
    """The thrusters of the simulated vehicle, if its file describes them, with their failures.

    Attributes:
        allocate: allocates the command of a law without allocation; None if the law does it, or without thrusters.
        reported: entries of the law's telemetry with the forces and the commands of all thrusters, and with the angles
            of all joints; None if the law does not allocate.
    """

    actuators: Actuators | None
    faults: tuple[ThrusterFault, ...]
    allocate: Callable[..., list[Array]] | None
    reported: tuple[slice, slice, slice] | None = None

    @staticmethod
    def of(vehicle: Vehicle, law: Law, faults: Sequence[ThrusterFault] = ()) -> Thrusters:
        """Return the thrusters of a vehicle in a run; InputError for a failure of an unknown thruster."""
        actuators = vehicle.actuators
        check_failed(vehicle, [fault.thruster for fault in faults])
        if law.actuators is not None and law.actuators != actuators:
            remedy = "build the law with actuators=vehicle.actuators"
            raise InputError("has other thrusters than the law", key="vehicle", value=vehicle.name, remedy=remedy)
        alone = actuators is not None and law.actuators is None
        allocate = runnable(allocation_block(actuators)) if alone and actuators is not None else None
        reported = None
        if law.actuators is not None:
            angles = law.telemetry_slice("thruster_angle") if law.actuators.swivels else slice(0, 0)
            reported = law.telemetry_slice("thruster_force"), law.telemetry_slice("thruster_command"), angles
        return Thrusters(actuators, tuple(faults), allocate, reported)

    def working(self, time: float) -> Array:
        """Return (n,): 1 for each thruster that works at `time` [s], else 0."""
        if self.actuators is None:
            return np.zeros(0)
        return working_flags(self.actuators, [fault.thruster for fault in self.faults if fault.acts(time)])

    def achieved(self, tau: Array, time: float, *, telemetry: Array | None, speed: float) -> tuple[Array, Array]:
        """Return force and yaw moment (4,) delivered for a command `tau` (4,), before the lag, and thruster forces.

        The force components (N,) are unknown without thrusters or without the law's `telemetry` of the step. A fin
        gives the force of its deflection at the forward `speed` [m/s] through the water, while the law knows only the
        measured speed over ground.
        """
        if self.allocate is not None and self.actuators is not None:
            total, components, *_ = self.allocate(tau, self.working(time) * self.actuators.shares(speed))
            return total, components
        if self.reported is None or self.actuators is None or telemetry is None:
            return tau, np.zeros(0)
        forces, commands, angles = (telemetry[where] for where in self.reported)
        components = self.actuators.components(forces, angles)
        if not self.actuators.fins:
            return tau, components
        squared = max(speed, 0.0) ** 2
        for k in self.actuators.fins:
            components[self.actuators.slices[k]] = commands[k] * (self.actuators.thrusters[k].forward * squared)
        excess: Array = fin_excess(self.actuators, forces, commands, squared)
        return tau + excess, components


def fin_excess(actuators: Actuators, forces: Any, commands: Any, squared: Any) -> Any:
    """Return the force and yaw moment (4,) that fins give at a squared speed [m²/s²] beyond those that the law expects.

    The arguments are numbers, or CasADi expressions: `forces` (n,) [N] and `commands` (n,) of all thrusters as the law
    reports them, and the squared forward speed through the water, 0 astern.
    """
    matrix, total = actuators.matrix, 0
    for k in actuators.fins:
        more = commands[k] * (actuators.thrusters[k].forward * squared) - forces[k]
        total = total + matrix[:, actuators.slices[k].start] * more
    return total


def check_failed(vehicle: Vehicle, names: Sequence[str]) -> None:
    """Raise InputError for a failed thruster that the vehicle does not have."""
    for name in names:
        if vehicle.actuators is None:
            problem = f"cannot fail: the file of {vehicle.name} describes no thrusters"
            remedy = "use a vehicle with [[thruster]] tables, such as bluerov2-heavy"
            raise InputError(problem, key="thruster", value=name, remedy=remedy)
        vehicle.actuators.index(name)


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
    """Return the use of the thrusters over a run; None for a law without allocation."""
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
