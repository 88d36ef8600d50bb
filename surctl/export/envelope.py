"""The guard in Python: ranges of inputs and gains, rates, limited commands; values of the self-test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.export.contract import SATURATED, Exportable, command_size
from surctl.ir import Real
from surctl.system import Record
from surctl.units import as_numbers

# Recorded runs of a law, in the form that the software-in-the-loop test replays


class Rows(NamedTuple):
    """Results of T steps: status codes (T,), commands (T, n_tau), next states (T, nx), telemetry (T, k)."""

    status: NDArray[np.int64]
    tau: NDArray[np.float64]
    state: NDArray[np.float64]
    telemetry: NDArray[np.float64]


Vector = NDArray[np.float64]
_Triple = tuple[ArrayLike, ArrayLike, ArrayLike]


@dataclass(frozen=True)
class Records:
    """State (T, nx), inputs (T, nu) and gains (T, np) before each step of a recorded run."""

    X: Vector
    U: Vector
    P: Vector

    def __len__(self) -> int:
        return len(self.X)


AnyRecord: TypeAlias = Records | Record | Sequence[_Triple]


def as_records(law: Exportable, records: AnyRecord) -> Records:
    """Return `Records` of a law from a recorded run.

    The run is triples (state, inputs, gains), `Records` whose gains P may be one vector (np,), or the `Record` of a
    system that `law` controls.
    """
    if isinstance(records, Record):
        records = Records(*records.controller)
    if not isinstance(records, Records):
        rows = list(records)
        columns = ([as_numbers(row[k], key="records").reshape(-1) for row in rows] for k in range(3))
        records = Records(*(np.array(column, dtype=float) for column in columns))
    steps = len(records.X)
    if steps == 0:
        raise InputError("holds no step", key="records", remedy="record at least one step of the law")
    P = records.P if np.ndim(records.P) == 2 else np.tile(records.P, (steps, 1))
    return Records(
        _sized(records.X, steps, law.state.size, "records.X"),
        _sized(records.U, steps, law.inputs.size, "records.U"),
        _sized(P, steps, law.gains.size, "records.P"),
    )


def _sized(array: ArrayLike, steps: int, size: int, key: str) -> Vector:
    rows = np.asarray(array, dtype=float)
    if rows.shape != (steps, size):
        raise InputError(f"has shape {rows.shape}, expected {(steps, size)}", key=key, remedy="give one row per step")
    return rows


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


def anywhere(law: Exportable) -> Envelope:
    """Return an envelope that accepts any finite number, without limits on rates."""
    state, inputs, gains = (
        np.tile([-np.inf, np.inf], (layout.size, 1)) for layout in (law.state, law.inputs, law.gains)
    )
    return Envelope(state, inputs, gains)


# Test vectors inside the exported source: a short run of the law with perturbed inputs


TOLERANCE: Mapping[Real, float] = MappingProxyType({"float64": 1e-9, "float32": 1e-5})
"""Largest difference, relative or absolute, that the exported self-test accepts, by precision.

Doubles are stored with 12 digits. Floats are stored exactly, but a processor may compute in a wider format.
"""

_SPREADS = (0.0, 0.1, 0.5, 1.0, 1.0, 2.0)  # perturbation of each step; a wide one also switches flags on
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class SelfTest:
    """Inputs (T, nu) of the self-test, a run from the initial state, and expected thrust, next state and status."""

    inputs: Vector
    tau: Vector
    state: Vector
    status: tuple[int, ...]


def self_test_vectors(law: Exportable, gains: Vector, within: Envelope) -> SelfTest:
    """Run `law` for one step on default inputs, then on perturbed inputs; return inputs and results as a `SelfTest`.

    The perturbation is a low-discrepancy sequence of ±0.1 to ±2 times 1 + |default|, so nothing is random. Expected
    values are rounded to 12 digits, so that the bundle does not depend on the last bits of the machine's sine function.
    Inputs are rounded to 6 digits to be short, and limited to the accepted ranges, so that the input check accepts
    every step.
    """
    default = law.inputs.pack()
    inputs = np.array([_perturbed(default, k, spread) for k, spread in enumerate(_SPREADS)])
    inputs = np.clip(inputs, within.inputs[:, 0], within.inputs[:, 1])
    x, rows = law.initial_state(), []
    for u in inputs:
        step = law.step(x, u, gains)
        rows.append(step)
        x = step.x_next
    return SelfTest(
        inputs,
        np.array([_rounded(s.tau) for s in rows]),
        np.array([_rounded(s.x_next) for s in rows]),
        tuple(int(s.status) for s in rows),
    )


def _perturbed(default: Vector, k: int, spread: float) -> Vector:
    phase = (np.arange(default.size) + 1 + k * default.size) * _GOLDEN
    offset = 2.0 * (phase - np.floor(phase)) - 1.0
    return _rounded(default + spread * (1.0 + np.abs(default)) * offset, digits=6)


def _rounded(values: Vector, digits: int = 12) -> Vector:
    return np.array([float(f"{v:.{digits - 1}e}") for v in values], dtype=float)
