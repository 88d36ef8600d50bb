"""C text that feeds an exported law with the window of a mission, as `surctl.marine.control.Feeder` does in Python."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.export.contract import Exportable
from surctl.ir import Real, c_literal
from surctl.marine.control import ARC_LENGTHS, FED
from surctl.marine.guidance import AT_CORNER, MAX_WAYPOINTS, ROW
from surctl.marine.guidance.window import SHORTEST

__all__ = ["data_rows", "is_fed", "mission_values"]


def is_fed(law: Exportable) -> bool:
    """Return whether a law follows a path whose waypoints, depth, speed and visits its host can feed."""
    return "progress" in law.state and all(name in law.gains for name in FED)


def mission_values(law: Exportable, real: Real) -> dict[str, Any]:
    """Return the values of the templates of `MISSION_FILES`."""
    return {
        "window": MAX_WAYPOINTS,
        "at_corner": repr(AT_CORNER),
        "shortest": repr(SHORTEST),
        "root": "sqrt" if real == "float64" else "sqrtf",
        "arcs": [name for name in ARC_LENGTHS if name in law.state],
    }


def data_rows(law: Exportable, table: NDArray[np.float64], real: Real) -> list[str]:
    """Return the C initialisers of the waypoints (n, 5) of a mission, see `guidance.Path.table`.

    Raises:
        InputError: the law follows no path, or the table has another shape.
    """
    if not is_fed(law):
        raise InputError("takes no waypoints, so that it cannot be fed with a mission", key="mission", value=law.name)
    if table.ndim != 2 or table.shape[1] != ROW or len(table) < 2:
        raise InputError(f"has shape {table.shape}, expected (n, {ROW})", key="mission", remedy="give Path.table()")
    literal = partial(c_literal, real=real)
    return [", ".join(literal(float(value)) for value in row) for row in table]
