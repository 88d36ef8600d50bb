"""This toolkit's contenders: the Python interface in every mode and with every backend, and the fast path."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias, get_args

import numpy as np
from contender import Contender
from fast import fast_tick
from instances import BOX, LEVELS, ROWS, Instance
from numpy.typing import NDArray

from surctl.priority import Mode, build_problem, nsb, solve

__all__ = ["FAST", "FAST_STRICT", "FILTER", "NSB", "PROJECTED", "STRICT", "by_reference", "ours"]

Array: TypeAlias = NDArray[np.float64]

FAST = "surctl fast path: projected"
"""The contender to which speed limits and ratios refer."""

NSB, FILTER, PROJECTED, STRICT = "nsb", "filter", "projected", "lexicographic"
"""Names of the problems: the law without limits, the velocity within the limits that is nearest to it, the law with its
last projection within the limits, strict priority.
"""

FAST_STRICT = f"{FAST[: -len(PROJECTED)]}{STRICT}"
"""The contender for strict priority."""


def by_reference(mode: str, backend: str = "daqp") -> str:
    """Return the name of the reference implementation in NumPy of a mode, with this QP solver."""
    return f"surctl solve: {mode}, reference with {backend}"


def ours(instances: Sequence[Instance], fast_modes: Sequence[Mode]) -> list[Contender]:
    """Return all contenders of this toolkit, with the fast path in these modes."""
    problems = [(instance.problem,) for instance in instances]
    found = [Contender(f"surctl solve: {mode}", mode, _api(mode), problems, ours=True) for mode in get_args(Mode)]
    for mode, backend in ((PROJECTED, "daqp"), (PROJECTED, "osqp"), (FILTER, "daqp"), (STRICT, "daqp")):
        found.append(Contender(by_reference(mode, backend), mode, _api(mode, backend), problems, ours=True))
    parts = [(instance.problem.levels, instance.problem.rows) for instance in instances]
    found.append(Contender("surctl build_problem + solve: projected", PROJECTED, _built, parts, ours=True))
    found.append(Contender("surctl nsb, as printed", NSB, nsb, problems, ours=True))
    arrays = [(i.J, i.x, i.table) for i in instances]
    fast = [
        Contender(
            f"{FAST[: -len(PROJECTED)]}{mode}", mode, fast_tick(mode, LEVELS, box=BOX, rows=ROWS), arrays, ours=True
        )
        for mode in fast_modes
    ]
    return [*fast, *found]


def _api(mode: Any, backend: Any = None) -> Any:
    def run(problem: Any) -> Array:
        return solve(problem, mode=mode, backend=backend).v

    return run


def _built(levels: Any, rows: Any) -> Array:
    return solve(build_problem(levels, rows)).v
