"""A tracker that estimates the present positions of moving obstacles, with error bounds, from late or lost messages.

The tracker builds CasADi expressions for the exported law; its state is an explicit input and output.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from surctl.errors import InputError, check_number
from surctl.ir import Port, each


class Movers(NamedTuple):
    """The moving obstacles at a control step, as SX expressions."""

    state: dict[str, ca.SX]
    """Next state: value of each entry, by name."""
    rows: ca.SX
    """(slots, 6) present obstacles in {E}: x, y, radius [m], vx, vy [m/s], valid; zeros in an empty row."""
    bound: ca.SX
    """(slots,) bound on the error of each obstacle's centre [m]; 0 in an empty row."""
    age: ca.SX
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
        if self.slots != int(self.slots) or self.slots < 1:
            raise InputError("must be a whole number, at least 1", key="movers.slots", value=self.slots)
        check_number("movers.dt", self.dt, unit="s")
        for name, unit in _AT_LEAST_ZERO.items():
            check_number(f"movers.{name}", getattr(self, name), unit=unit, zero=True)
        if self.forget <= self.latency:
            problem = f"must be greater than the latency of {self.latency:g} s"
            raise InputError(problem, key="movers.forget", value=self.forget, remedy="give s")

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

    def update(self, state: Mapping[str, ca.SX], *, message: ca.SX, message_fresh: ca.SX, prefix: str = "") -> Movers:
        """Return the moving obstacles after one control step.

        Args:
            message: (slots, 6) x, y, radius, vx, vy, valid of each obstacle, measured in {E} `latency` earlier; any
                finite values if no message arrived.
            message_fresh: 1 if a message has arrived since the last step, else 0.
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
