"""Ranges and rates of change that the guard (the input check of the exported C) accepts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.export.contract import SATURATED, Exportable, command_size
from surctl.export.records import Records, Rows
from surctl.ir import Real

__all__ = ["ITER", "NONFINITE", "NULL", "RANGE", "STALE", "Envelope", "Rate", "anywhere"]

Vector = NDArray[np.float64]

NULL, NONFINITE, RANGE, STALE, ITER = -1, -2, -3, -4, -5

_LONGEST_GAP = 1000
"""Largest number of samples over which the allowed change of an input grows."""


@dataclass(frozen=True)
class Rate:
    """Largest allowed change of an input since its last accepted value.

    Attributes:
        entry: index in the flat input vector.
        per_second: largest accepted rate of change [unit of the input/s].
        at_once: additional change that noise may cause [unit of the input].
        turn: True for an angle [rad], whose whole turns do not count as a change.
    """

    entry: int
    per_second: float
    at_once: float
    turn: bool = False

    def __post_init__(self) -> None:
        """Raise InputError for a negative or non-finite rate."""
        if not (np.isfinite([self.per_second, self.at_once]).all() and min(self.per_second, self.at_once) >= 0):
            raise InputError(
                "is not a valid rate", key=f"rate of input {self.entry}", value=(self.per_second, self.at_once)
            )


@dataclass(frozen=True, eq=False)
class Envelope:
    """Bounds of all numbers that enter a step of the law.

    Attributes:
        state, inputs, gains: arrays (n, 2) with the smallest and the largest accepted value of each number; ±inf
            accepts any finite number.
        rates: largest rates of change of inputs.
        reasons: for each bounded quantity, where its bounds come from; printed in the C header.
        commands: array (m, 2) with the least and the largest value of each command; the exported step limits its
            commands to these, whatever the gains are. None sets no limit besides those of the law.
        orders: pairs of indices of gains; the first gain of a pair must not be larger than the second.
    """

    state: Vector
    inputs: Vector
    gains: Vector
    rates: tuple[Rate, ...] = ()
    reasons: Mapping[str, str] = field(default_factory=dict)
    commands: Vector | None = None
    orders: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        """Raise InputError for an empty range, or for a rate of an input that does not exist."""
        for name in ("state", "inputs", "gains", *(("commands",) if self.commands is not None else ())):
            box = getattr(self, name)
            if box.ndim != 2 or box.shape[1] != 2 or not (box[:, 0] <= box[:, 1]).all():
                raise InputError("is not an array (n, 2) of smallest and largest values", key=f"envelope.{name}")
        if any(not 0 <= rate.entry < len(self.inputs) for rate in self.rates):
            raise InputError("limits the rate of an input that does not exist", key="envelope.rates")
        if any(not 0 <= at < len(self.gains) for pair in self.orders for at in pair):
            raise InputError("has an order between gains, of which one does not exist", key="envelope.orders")

    def fitted(self, law: Exportable, real: Real) -> Envelope:
        """Return the envelope with bounds rounded to `real`; InputError if its arrays do not fit the law's vectors."""
        largest, parts = float(np.finfo(real).max), []
        sizes = {name: getattr(law, name).size for name in ("state", "inputs", "gains")}
        for name, size in (sizes | ({} if self.commands is None else {"commands": command_size(law)})).items():
            box = getattr(self, name)
            if len(box) != size:
                raise InputError(f"has {len(box)} entries, but the law has {size}", key=f"envelope.{name}")
            parts.append(np.clip(box, -largest, largest).astype(real).astype(np.float64))
        state, inputs, gains, *limits = parts
        return replace(self, state=state, inputs=inputs, gains=gains, commands=limits[0] if limits else None)

    def limited(self, rows: Rows) -> Rows:
        """Return the results with commands limited to `commands`; a step whose command changes reports `SATURATED`."""
        if self.commands is None:
            return rows
        tau = np.clip(rows.tau, self.commands[:, 0], self.commands[:, 1])
        changed = (tau != rows.tau).any(axis=1) & (rows.status >= 0)
        status = np.where(changed, rows.status | SATURATED, rows.status)
        return Rows(status, np.where(changed[:, None], tau, rows.tau), rows.state, rows.telemetry)

    def refusals(self, records: Records) -> NDArray[np.int64]:
        """Return the status (T,) of T steps: 0 if all numbers of the step are in range, else `NONFINITE` or `RANGE`."""
        rows = np.hstack([records.X, records.U, records.P])
        box = np.vstack([self.state, self.inputs, self.gains])
        with np.errstate(invalid="ignore"):
            inside = ((rows >= box[:, 0]) & (rows <= box[:, 1])).all(axis=1)
            for low, high in self.orders:
                inside &= records.P[:, low] <= records.P[:, high]
        return np.where(inside, 0, np.where(np.isfinite(rows).all(axis=1), RANGE, NONFINITE))

    def jumped(self, u: Vector, before: Vector, gap: int, *, dt: float, real: Real) -> bool:
        """Return whether an input changed more in `gap` samples than its rate allows, computed in precision `real`."""
        number = np.dtype(real).type
        turn, count = number(2.0 * np.pi), number(min(gap, _LONGEST_GAP))
        for rate in self.rates:
            moved = number(u[rate.entry]) - number(before[rate.entry])
            if rate.turn:
                moved = moved - turn * np.floor(moved / turn + number(0.5))
            if not np.abs(moved) <= number(rate.at_once) + number(rate.per_second * dt) * count:
                return True
        return False

    def chained(
        self,
        rows: Rows,
        records: Records,
        load: NDArray[np.bool_],
        *,
        dt: float,
        real: Real,
        counts: NDArray[np.int64] | None = None,
    ) -> Rows:
        """Return the results, with status `RANGE` where an input changed too fast since the last accepted step.

        Args:
            rows: results of T steps, without the check of rates.
            records: state, inputs and gains of each step.
            load: (T,) True at each step that starts a new run.
            dt: control period [s].
            real: precision of the check.
            counts: (T,) sample number of each step; None means one sample per step.
        """
        counts = np.arange(len(records)) if counts is None else counts
        if not self.rates:
            return rows
        out = Rows(rows.status.copy(), rows.tau.copy(), rows.state.copy(), rows.telemetry.copy())
        last = -1
        for k in range(len(records)):
            if load[k]:
                last = -1
            looked_at = last >= 0 and out.status[k] not in (NONFINITE, RANGE)
            if looked_at and self.jumped(
                records.U[k], records.U[last], int(counts[k] - counts[last]), dt=dt, real=real
            ):
                out.status[k], out.tau[k], out.state[k], out.telemetry[k] = RANGE, 0.0, records.X[k], 0.0
            last = k if out.status[k] >= 0 else last
        return out


def anywhere(law: Exportable) -> Envelope:
    """Return an envelope that accepts any finite number, without limits on rates."""
    state, inputs, gains = (
        np.tile([-np.inf, np.inf], (layout.size, 1)) for layout in (law.state, law.inputs, law.gains)
    )
    return Envelope(state, inputs, gains)
