"""What the guard of an exported law lets in: a box for every number, and how fast measured ones may move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.export.contract import Exportable
from surctl.export.records import Records
from surctl.export.rows import Rows
from surctl.ir import Real

__all__ = ["ITER", "NONFINITE", "NULL", "RANGE", "STALE", "Envelope", "Rate", "anywhere"]

Vector = NDArray[np.float64]

NULL, NONFINITE, RANGE, STALE, ITER = -1, -2, -3, -4, -5

LONGEST_GAP = 1000
"""Missed samples that count, at most."""


@dataclass(frozen=True)
class Rate:
    """How far an input may be from its last accepted value.

    Attributes:
        entry: of the flat input.
        per_second: largest speed [unit/s].
        at_once: how far noise alone may take it [unit].
        turn: an angle [rad]: whole turns are no jump.
    """

    entry: int
    per_second: float
    at_once: float
    turn: bool = False

    def __post_init__(self) -> None:
        """Refuse what could never hold."""
        if not (np.isfinite([self.per_second, self.at_once]).all() and min(self.per_second, self.at_once) >= 0):
            raise InputError("is no speed", key=f"rate of input {self.entry}", value=(self.per_second, self.at_once))


@dataclass(frozen=True, eq=False)
class Envelope:
    """Bounds of the numbers that a step is given.

    Attributes:
        state, inputs, gains: (n, 2) least and largest, ±inf for any finite number.
        rates: of inputs.
        reasons: where they come from, by what is bounded; told in the header.
    """

    state: Vector
    inputs: Vector
    gains: Vector
    rates: tuple[Rate, ...] = ()
    reasons: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse an empty box."""
        for name in ("state", "inputs", "gains"):
            box = getattr(self, name)
            if box.ndim != 2 or box.shape[1] != 2 or not (box[:, 0] <= box[:, 1]).all():
                raise InputError("is no box (n, 2) of least and largest numbers", key=f"envelope.{name}")
        if any(not 0 <= rate.entry < len(self.inputs) for rate in self.rates):
            raise InputError("a rate is of no input", key="envelope.rates")

    def fitted(self, law: Exportable, real: Real) -> Envelope:
        """The same with bounds that are numbers of that precision; InputError unless it is of the law's sizes."""
        largest, parts = float(np.finfo(real).max), []
        for name in ("state", "inputs", "gains"):
            box, size = getattr(self, name), getattr(law, name).size
            if len(box) != size:
                raise InputError(f"has {len(box)} entries, the law has {size}", key=f"envelope.{name}")
            parts.append(np.clip(box, -largest, largest).astype(real).astype(np.float64))
        state, inputs, gains = parts
        return Envelope(state, inputs, gains, self.rates, self.reasons)

    def refusals(self, records: Records) -> NDArray[np.int64]:
        """(T,) 0 for a row whose numbers are all within, else `NONFINITE` or `RANGE`."""
        rows = np.hstack([records.X, records.U, records.P])
        box = np.vstack([self.state, self.inputs, self.gains])
        with np.errstate(invalid="ignore"):
            inside = ((rows >= box[:, 0]) & (rows <= box[:, 1])).all(axis=1)
        return np.where(inside, 0, np.where(np.isfinite(rows).all(axis=1), RANGE, NONFINITE))

    def jumped(self, u: Vector, before: Vector, gap: int, *, dt: float, real: Real) -> bool:
        """Whether an input moved further in `gap` samples than it can; every operation rounded to `real`."""
        number = np.dtype(real).type
        turn, count = number(2.0 * np.pi), number(min(gap, LONGEST_GAP))
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
        """What each row answers once the jumps from one accepted row to the next are looked at.

        Args:
            rows: answers without that.
            records: the rows.
            load: (T,) rows that begin anew.
            dt: control period [s].
            real: precision.
            counts: (T,) number of each row's sample; None: one sample a row.
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
    """Any finite numbers, at any speed."""
    state, inputs, gains = (
        np.tile([-np.inf, np.inf], (layout.size, 1)) for layout in (law.state, law.inputs, law.gains)
    )
    return Envelope(state, inputs, gains)
