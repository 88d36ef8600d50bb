"""A law as a target of another precision computes it: every operation rounded to `real`, in NumPy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.export.contract import Exportable, thrust
from surctl.ir import Block, Layout, Real, replay

__all__ = ["REALS", "Rounded", "Rows", "evaluated", "in_precision", "rounded"]

Vector = NDArray[np.float64]

REALS: tuple[Real, ...] = ("float64", "float32")

_NONFINITE = -2
_IN_MEMORY = 20_000_000  # intermediate numbers that are in memory at once
_NUMPY: dict[Real, type[np.float64] | type[np.float32]] = {"float64": np.float64, "float32": np.float32}


class Rows(NamedTuple):
    """Steps, row by row, as a compiled controller answers them.

    Attributes:
        status: (T,).
        tau: (T, n_tau) [N, N m].
        state: state after each step (T, nx).
        telemetry: (T, k).
    """

    status: NDArray[np.int64]
    tau: Vector
    state: Vector
    telemetry: Vector


class _Step(NamedTuple):
    tau: Vector
    x_next: Vector
    status: int
    telemetry: Vector


@dataclass(frozen=True, eq=False)
class Rounded:
    """An exportable law replayed instruction by instruction, every number rounded to `real`.

    The reference semantics of the exported C in that precision: IEEE 754 defines each operation to the last bit.
    All vectors are arrays of doubles, which hold floats for float32.

    Attributes:
        law: the law; its block must not use the mathematical library, whose last bits no standard defines.
        real: the precision.
    """

    law: Exportable
    real: Real = "float32"

    @property
    def name(self) -> str:
        """C identifier."""
        return self.law.name

    @property
    def dt(self) -> float:
        """Control period [s]."""
        return self.law.dt

    @property
    def state(self) -> Layout:
        """Layout of x (nx,)."""
        return self.law.state

    @property
    def inputs(self) -> Layout:
        """Layout of u (nu,)."""
        return self.law.inputs

    @property
    def gains(self) -> Layout:
        """Layout of p (np,)."""
        return self.law.gains

    @property
    def outputs(self) -> Layout:
        """Layout of tau (4,), then of the telemetry (k,)."""
        return self.law.outputs

    @property
    def block(self) -> Block:
        """The law's own instructions."""
        return self.law.block

    def initial_state(self) -> Vector:
        """State before the first step (nx,)."""
        return rounded(self.law.initial_state(), self.real)

    def step(self, x: Vector, u: Vector, p: Vector) -> _Step:
        """One guarded step: anything non-finite gives tau = 0, x_next = x, status NONFINITE."""
        rows = self.steps(*(np.atleast_2d(v) for v in (x, u, p)))
        return _Step(rows.tau[0], rows.state[0], int(rows.status[0]), rows.telemetry[0])

    def steps(self, X: Vector, U: Vector, P: Vector) -> Rows:
        """One step from each row of X (T, nx), U (T, nu), P (T, np)."""
        some = max(1, _IN_MEMORY // max(1, self.law.block.operations))
        parts = [
            self._batch(*(rounded(v[at : at + some], self.real) for v in (X, U, P))) for at in range(0, len(X), some)
        ]
        return Rows(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def _batch(self, X: Vector, U: Vector, P: Vector) -> Rows:
        n_tau = thrust(self.law).size
        safe = Rows(
            np.full(len(X), _NONFINITE),
            np.zeros((len(X), n_tau)),
            X.copy(),
            np.zeros((len(X), self.law.outputs.size - n_tau)),
        )
        taken = np.flatnonzero(np.isfinite(np.hstack([X, U, P])).all(axis=1))
        if not taken.size:
            return safe
        given = X[taken], U[taken], P[taken]
        made = [np.asarray(y, dtype=np.float64) for y in replay(self.law.block, *given, real=_NUMPY[self.real])]
        told = made[2][:, 0]
        fine = np.isfinite(np.hstack(made)).all(axis=1) & (told >= 0.0) & (told <= 32767.0)
        done = taken[fine]
        for mine, fresh in zip(
            (safe.tau, safe.state, safe.status, safe.telemetry), (*made[:2], told, made[3]), strict=True
        ):
            mine[done] = fresh[fine]
        return safe


def in_precision(law: Exportable, real: Real) -> Exportable:
    """The law itself for float64, `Rounded` for float32."""
    return law if real == "float64" else Rounded(law)


def evaluated(law: Exportable, X: Vector, U: Vector, P: Vector) -> Rows:
    """One step of the law in Python from each row."""
    if isinstance(law, Rounded):
        return law.steps(X, U, P)
    steps = [law.step(x, u, p) for x, u, p in zip(X, U, P, strict=True)]
    width = law.outputs.size - thrust(law).size
    return Rows(
        np.array([int(s.status) for s in steps], dtype=np.int64),
        np.array([s.tau for s in steps], dtype=float).reshape(len(steps), -1),
        np.array([s.x_next for s in steps], dtype=float).reshape(len(steps), law.state.size),
        np.array([s.telemetry for s in steps], dtype=float).reshape(len(steps), width),
    )


def rounded(values: Vector, real: Real = "float32") -> Vector:
    """The nearest numbers of that precision, as doubles."""
    with np.errstate(over="ignore"):
        return np.asarray(values, dtype=_NUMPY[real]).astype(np.float64)
