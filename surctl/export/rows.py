"""What steps answer, row by row."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Rows"]


class Rows(NamedTuple):
    """Steps, row by row, as a compiled controller answers them.

    Attributes:
        status: (T,).
        tau: (T, n_tau) [N, N m].
        state: state after each step (T, nx).
        telemetry: (T, k).
    """

    status: NDArray[np.int64]
    tau: NDArray[np.float64]
    state: NDArray[np.float64]
    telemetry: NDArray[np.float64]
