"""Results of controller steps as arrays with one row for each step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Rows"]


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
