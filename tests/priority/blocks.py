"""Constraint rows as the routines of the solver for double take them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.priority.solver.kernel import lanes_of


def in_blocks(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Reorder constraint rows (…, rows, width) to blocks (…, rows·width) as the routines for double take them."""
    *batch, count, width = rows.shape
    lanes = lanes_of(count)
    return np.swapaxes(rows.reshape(*batch, count // lanes, lanes, width), -1, -2).reshape(*batch, count * width)
