"""The exported step in Python: rounded to float32, behind the guard, with refused and missing samples."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.export.contract import Exportable, WrappedLaw, command_size
from surctl.export.envelope import ITER, NONFINITE, RANGE, Envelope, Records, Rows
from surctl.export.supplement import aged
from surctl.ir import Block, Layout, Real, replay
from surctl.system.controller import ControllerStep

Vector = NDArray[np.float64]

REALS: tuple[Real, ...] = ("float64", "float32")

_IN_MEMORY = 20_000_000  # largest number of intermediate results in memory at once
_NUMPY: dict[Real, type[np.float64] | type[np.float32]] = {"float64": np.float64, "float32": np.float32}


@dataclass(frozen=True, eq=False)
class _Same(WrappedLaw):
    # shares gains and instruction list with the wrapped law
    real: Real

    @property
    def gains(self) -> Layout:
        return self.law.gains

    @property
    def block(self) -> Block:
        return self.law.block

    def initial_state(self) -> Vector:
        """Return the controller state before the first step (nx,)."""
        return rounded(self.law.initial_state(), self.real)

    def step(self, x: Vector, u: Vector, p: Vector) -> ControllerStep:
        """Run one step, without a check of rates; a refused one gives tau = 0, x_next = x and a negative status."""
        rows = evaluated(self, *(np.atleast_2d(np.asarray(v, dtype=float)) for v in (x, u, p)))
        return ControllerStep(rows.tau[0], rows.state[0], int(rows.status[0]), rows.telemetry[0])


@dataclass(frozen=True, eq=False)
class Rounded(_Same):
    """An exportable law that Python evaluates instruction by instruction, with every number rounded to `real`.

    `Rounded` is the reference for the exported C in this precision, because IEEE 754 defines each operation to the last
    bit; the law must not use libm functions such as sin, whose last bits no standard defines. All vectors are arrays of
    doubles; for float32 their values have single precision.
    """

    real: Real = "float32"

    def steps(self, X: Vector, U: Vector, P: Vector) -> Rows:
        """Run one step from each row of X (T, nx), U (T, nu), P (T, np)."""
        some = max(1, _IN_MEMORY // max(1, self.law.block.operations))
        parts = [
            self._batch(*(rounded(v[at : at + some], self.real) for v in (X, U, P))) for at in range(0, len(X), some)
        ]
        return Rows(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def _batch(self, X: Vector, U: Vector, P: Vector) -> Rows:
        safe = _refused(self.law, np.full(len(X), NONFINITE), X)
        finite = np.flatnonzero(np.isfinite(np.hstack([X, U, P])).all(axis=1))
        if not finite.size:
            return safe
        inputs = X[finite], U[finite], P[finite]
        outputs = [np.asarray(y, dtype=np.float64) for y in replay(self.law.block, *inputs, real=_NUMPY[self.real])]
        status = outputs[2][:, 0]
        number = np.isfinite(np.hstack(outputs)).all(axis=1)
        safe.status[finite[number & (status < 0.0)]] = ITER
        fine = number & (status >= 0.0) & (status <= 32767.0)
        _put(safe, finite[fine], (part[fine] for part in (status, *outputs[:2], outputs[3])))
        return safe


@dataclass(frozen=True, eq=False)
class Guarded(_Same):
    """A law in Python that first checks its inputs as the guard of the exported C does."""

    envelope: Envelope


def in_precision(law: Exportable, real: Real, envelope: Envelope | None = None) -> Exportable:
    """Return the law as a target computes it: wrapped in `Rounded` for float32, in `Guarded` if `envelope` is given."""
    inner = law if real == "float64" else Rounded(law)
    return inner if envelope is None else Guarded(inner, real, envelope)


def plain(law: Exportable) -> Exportable:
    """Return the law that `Rounded` and `Guarded` wrap."""
    while isinstance(law, _Same):
        law = law.law
    return law


def evaluated(law: Exportable, X: Vector, U: Vector, P: Vector) -> Rows:
    """Run independent steps of the law in Python, step k from row k of states X, inputs U and gains P."""
    if isinstance(law, Guarded):
        return _let_in(law, Records(*(rounded(v, law.real) for v in (X, U, P))))
    if isinstance(law, Rounded):
        return law.steps(X, U, P)
    steps = [law.step(x, u, p) for x, u, p in zip(X, U, P, strict=True)]
    width = law.outputs.size - command_size(law)
    return Rows(
        np.array([int(s.status) for s in steps], dtype=np.int64),
        np.array([s.tau for s in steps], dtype=float).reshape(len(steps), -1),
        np.array([s.x_next for s in steps], dtype=float).reshape(len(steps), law.state.size),
        np.array([s.telemetry for s in steps], dtype=float).reshape(len(steps), width),
    )


def _refused(law: Exportable, status: NDArray[np.int64], X: Vector) -> Rows:
    size = command_size(law)
    return Rows(status, np.zeros((len(X), size)), np.array(X), np.zeros((len(X), law.outputs.size - size)))


def _let_in(law: Guarded, records: Records) -> Rows:
    status = law.envelope.refusals(records)
    out = _refused(law, status, records.X)
    index = np.flatnonzero(status != RANGE)  # the law itself refuses numbers that are not finite
    if index.size:
        computed = evaluated(law.law, records.X[index], records.U[index], records.P[index])
        _put(out, index, law.envelope.limited(computed))
    return out


def _put(rows: Rows, at: NDArray[np.intp] | list[int], others: Iterable[NDArray[Any]]) -> None:
    """Replace some rows by others."""
    for mine, fresh in zip(rows, others, strict=True):
        mine[at] = fresh


def replayed(
    law: Exportable,
    records: Records,
    load: NDArray[np.bool_],
    *,
    counts: NDArray[np.int64] | None = None,
    rows: Rows | None = None,
) -> Rows:
    """Run `evaluated`, then the checks that concern successive steps; `load` (T,) is True where a new run starts.

    Steps whose inputs changed too fast are rejected. After a gap of refused or missing samples, the step is computed
    from the state that `aged` returns. `counts` (T,) are the sample numbers of the steps; None means that no sample is
    missing. `rows` are the results of `evaluated`, if they are known.
    """
    rows = evaluated(law, records.X, records.U, records.P) if rows is None else rows
    counts = np.arange(len(records)) if counts is None else counts
    within = law.envelope if isinstance(law, Guarded) and law.envelope.rates else None
    ages = any(port.gap != "keep" for port in law.state)
    if within is None and not ages:
        return rows
    real: Real = law.real if isinstance(law, Guarded | Rounded) else "float64"
    out = Rows(rows.status.copy(), rows.tau.copy(), rows.state.copy(), rows.telemetry.copy())
    last = -1  # the last accepted step
    for k in range(len(records)):
        last = -1 if load[k] else last
        x, u, p = records.X[k], records.U[k], records.P[k]
        if last >= 0 and out.status[k] not in (NONFINITE, RANGE):
            gap = int(counts[k] - counts[last])
            if within is not None and within.jumped(u, records.U[last], gap, dt=law.dt, real=real):
                _put(out, [k], _refused(law, np.array([RANGE]), x[None]))
            elif ages and gap > 1:
                old = aged(law, rounded(x, real), gap, real=real)
                _put(out, [k], evaluated(law, old[None], u[None], p[None]))
        last = k if out.status[k] >= 0 else last
    return out


def differing(mine: NDArray[Any], theirs: NDArray[Any]) -> NDArray[np.intp]:
    """Return the indices of the rows in which a number differs in some bit; any two NaN count as equal."""
    bits = f"u{mine.itemsize}"
    same = (mine.view(bits) == theirs.view(bits)) | (np.isnan(mine) & np.isnan(theirs))
    return np.flatnonzero(~same.all(axis=1))


def rounded(values: Vector, real: Real = "float32") -> Vector:
    """Return the nearest numbers of the precision `real`, stored as doubles."""
    with np.errstate(over="ignore"):
        return np.asarray(values, dtype=_NUMPY[real]).astype(np.float64)
