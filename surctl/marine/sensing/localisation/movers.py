"""A tracker that estimates the present positions of moving obstacles, with error bounds, from late or lost messages.

The tracker builds CasADi expressions for the exported law; its state is an explicit input and output. The function
`mover_step` computes the results of the tracker in NumPy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Generic, NamedTuple, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir import Port, each

__all__ = ["MoverTracker", "Movers", "mover_step"]

T = TypeVar("T")


class Movers(NamedTuple, Generic[T]):
    """The moving obstacles at a control step: SX expressions from `MoverTracker.update`, arrays from `mover_step`."""

    state: dict[str, T]
    """Next state: value of each entry, by name."""
    rows: T
    """(slots, 6) present obstacles in {E}: x, y, radius [m], vx, vy [m/s], valid; zeros in an empty row."""
    bound: T
    """(slots,) bound on the error of each obstacle's centre [m]; 0 in an empty row."""
    age: T
    """(slots,) time since the last measurement of each obstacle [s]; `forget + dt` in an empty row."""


@dataclass(frozen=True, kw_only=True)
class MoverTracker:
    """A tracker that stores the last message about each obstacle and extrapolates its position in a straight line.

    The bound on the position error is `sigmas`·(position_sd + velocity_sd·age) + acceleration·age²/2. A message has a
    fixed number of rows (slots), one per obstacle. If a message marks a row as empty, the tracker drops the obstacle at
    once. If no message arrives, the tracker keeps the obstacle until the age of its last message exceeds `forget`.

    Attributes:
        dt: control period [s].
        slots: number of obstacles that a message can hold, 1 or more.
        latency: age of a message when it arrives [s], below `forget`.
        position_sd: standard deviation of each coordinate in a message [m].
        velocity_sd: standard deviation of each velocity component in a message [m/s].
        acceleration: largest acceleration of an obstacle [m/s²] (design choice: a light robot of equal size under full
            thrust).
        forget: age of the last message [s] above which the tracker drops the obstacle (design choice).
        sigmas: number of standard deviations in the bound (design choice: 3 standard deviations contain 98.9 % of a
            planar Gaussian distribution).
    """

    dt: float
    slots: int
    latency: float = 0.1
    position_sd: float = 0.01
    velocity_sd: float = 0.01
    acceleration: float = 0.1
    forget: float = 3.0
    sigmas: float = 3.0

    def __post_init__(self) -> None:
        """Check the values; raise an InputError that names an invalid value."""
        if self.slots != int(self.slots) or self.slots < 1:
            raise InputError("must be a whole number, at least 1", key="movers.slots", value=self.slots)
        if not (isfinite(self.dt) and self.dt > 0):
            raise InputError("must be greater than 0", key="movers.dt", value=self.dt, remedy="give s")
        for name, unit in _AT_LEAST_ZERO.items():
            value = getattr(self, name)
            if not (isfinite(value) and value >= 0):
                raise InputError("must be at least 0", key=f"movers.{name}", value=value, remedy=f"give {unit}")
        if self.forget <= self.latency:
            raise InputError(
                f"must be greater than the latency of {self.latency:g} s",
                key="movers.forget",
                value=self.forget,
                remedy="give s",
            )

    def ports(self, prefix: str = "") -> tuple[Port, ...]:
        """Return the entries (name, shape, initial value) of the state; initially there is no obstacle."""
        return (
            Port(
                f"{prefix}latest", (self.slots, 5), "m, m/s", "last message of each slot: x, y, radius, vx, vy in {E}"
            ),
            Port(
                f"{prefix}age",
                (self.slots,),
                "s",
                "time since the measurement in that message, at most forget + dt",
                self.forget + self.dt,
            ),
        )

    def update(
        self, state: Mapping[str, ca.SX], *, message: ca.SX, message_fresh: ca.SX, prefix: str = ""
    ) -> Movers[ca.SX]:
        """Return the moving obstacles after one control step.

        Args:
            state: value of each entry of `ports(prefix)`, by name.
            message: (slots, 6) x, y, radius, vx, vy, valid of each obstacle, measured in {E} `latency` earlier; any
                finite values if no message arrived.
            message_fresh: 1 if a message has arrived since the last step, else 0.
            prefix: prefix of the names of the state's entries.
        """
        fresh = message_fresh > 0.5

        def slot(last: ca.SX, old: ca.SX, message: ca.SX) -> tuple[ca.SX, ...]:
            received = ca.logic_and(fresh, message[5] > 0.5)
            cleared = ca.logic_and(fresh, ca.logic_not(received))
            older = ca.if_else(cleared, self._empty, ca.fmin(old + self.dt, self._empty))
            age = ca.if_else(received, self.latency, older)
            latest = ca.if_else(received, message[:5], last)
            # tolerance of half a step, because sums of dt are not exact
            valid = age <= self.forget + 0.5 * self.dt
            now = ca.vertcat(latest[:2] + age * latest[3:5], latest[2:], 1)
            bound = self.sigmas * (self.position_sd + self.velocity_sd * age) + 0.5 * self.acceleration * age * age
            return latest, age, ca.if_else(valid, now, 0), ca.if_else(valid, bound, 0)

        messages, age, rows, bound = each(
            "mover_message", slot, state[f"{prefix}latest"], state[f"{prefix}age"], message
        )
        return Movers({f"{prefix}latest": messages, f"{prefix}age": age}, rows, bound, age)

    @property
    def _empty(self) -> float:
        return self.forget + self.dt


_AT_LEAST_ZERO = {
    "latency": "s",
    "position_sd": "m",
    "velocity_sd": "m/s",
    "acceleration": "m/s^2",
    "forget": "s",
    "sigmas": "a number",
}


def mover_step(
    tracker: MoverTracker,
    state: Mapping[str, NDArray[np.float64]],
    *,
    message: NDArray[np.float64],
    message_fresh: float,
    prefix: str = "",
) -> Movers[NDArray[np.float64]]:
    """Return the result of `MoverTracker.update` for NumPy arrays; the function changes no input.

    Example:
        >>> import numpy as np
        >>> from surctl.ir import Layout
        >>> from surctl.marine.sensing import MoverTracker, mover_step
        >>> tracker = MoverTracker(dt=0.05, slots=1)
        >>> layout = Layout(tracker.ports())
        >>> drifting = np.array([[1.0, 0.5, 0.2, 0.1, 0.0, 1.0]])  # x, y, radius, vx, vy, valid
        >>> movers = mover_step(tracker, layout.unpack(layout.pack()), message=drifting, message_fresh=1.0)
        >>> movers.rows.round(3).tolist(), movers.bound.round(4).tolist()  # 0.1 s later
        ([[1.01, 0.5, 0.2, 0.1, 0.0, 1.0]], [0.0335])
    """
    latest = np.array(state[f"{prefix}latest"], dtype=float)
    age = np.array(state[f"{prefix}age"], dtype=float) + tracker.dt
    received = np.asarray(message, dtype=float)
    rows, bound = np.zeros((tracker.slots, 6)), np.zeros(tracker.slots)
    for k in range(tracker.slots):
        if message_fresh:
            age[k] = tracker.latency if received[k, 5] else np.inf
            latest[k] = received[k, :5] if received[k, 5] else latest[k]
        age[k] = min(age[k], tracker.forget + tracker.dt)
        if age[k] <= tracker.forget + 0.5 * tracker.dt:
            x, y, radius, vx, vy = latest[k]
            rows[k] = x + vx * age[k], y + vy * age[k], radius, vx, vy, 1.0
            spread = tracker.position_sd + tracker.velocity_sd * age[k]
            bound[k] = tracker.sigmas * spread + tracker.acceleration * age[k] ** 2 / 2
    return Movers({f"{prefix}latest": latest, f"{prefix}age": age}, rows, bound, age.copy())
