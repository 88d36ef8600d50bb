"""Recorded runs of a law, in the form that the software-in-the-loop test replays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.export.contract import Exportable
from surctl.system import Record

__all__ = ["AnyRecord", "Records", "Rows", "as_records"]


class Rows(NamedTuple):
    """Results of T steps of a controller that is compiled or evaluated in Python.

    Attributes:
        status: status codes (T,).
        tau: commands (T, n_tau).
        state: state after each step (T, nx).
        telemetry: telemetry (T, k).
    """

    status: NDArray[np.int64]
    tau: NDArray[np.float64]
    state: NDArray[np.float64]
    telemetry: NDArray[np.float64]


Vector = NDArray[np.float64]
_Triple = tuple[ArrayLike, ArrayLike, ArrayLike]


@dataclass(frozen=True)
class Records:
    """State, inputs and gains of each step of a recorded run.

    Attributes:
        X: state before each step (T, nx).
        U: inputs of each step (T, nu).
        P: gains of each step (T, np).
    """

    X: Vector
    U: Vector
    P: Vector

    def __len__(self) -> int:
        """Return the number of recorded steps T."""
        return len(self.X)


AnyRecord: TypeAlias = Records | Record | Sequence[_Triple]


def as_records(law: Exportable, records: AnyRecord) -> Records:
    """Return `Records` of a law from a recorded run.

    Args:
        law: the law that ran.
        records: triples (state, inputs, gains), `Records` whose gains P may be one vector (np,), or the `Record` of a
            system that `law` controls.

    Raises:
        InputError: there is no step, or an array does not fit the law's layouts.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.export import Records, as_records
        >>> from surctl.marine.simulation import law_numbers, load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission, vehicle, gains = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
        >>> law, p = build_law("closed_form"), law_numbers(mission, gains, vehicle)
        >>> run = simulate(mission, vehicle, gains=gains, law=law)
        >>> recording = Records(run.record.law_state, run.record.law_input, run.record.law_parameters)
        >>> records = as_records(law, recording)  # one vector of gains becomes one row per step
        >>> recording.P.shape, records.P.shape == (len(recording.X), law.gains.size)
        ((70,), True)
    """
    if isinstance(records, Record):
        records = Records(*records.controller)
    if not isinstance(records, Records):
        rows = list(records)
        records = Records(*(_stack([row[k] for row in rows]) for k in range(3)))
    steps = len(records.X)
    if steps == 0:
        raise InputError("holds no step", key="records", remedy="record at least one step of the law")
    P = records.P if np.ndim(records.P) == 2 else np.tile(records.P, (steps, 1))
    return Records(
        _sized(records.X, steps, law.state.size, "records.X"),
        _sized(records.U, steps, law.inputs.size, "records.U"),
        _sized(P, steps, law.gains.size, "records.P"),
    )


def _stack(rows: list[ArrayLike]) -> Vector:
    return np.array([np.asarray(r, dtype=float).reshape(-1) for r in rows], dtype=float)


def _sized(array: ArrayLike, steps: int, size: int, key: str) -> Vector:
    rows = np.asarray(array, dtype=float)
    if rows.shape != (steps, size):
        raise InputError(f"has shape {rows.shape}, expected {(steps, size)}", key=key, remedy="give one row per step")
    return rows
