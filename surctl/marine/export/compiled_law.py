"""A control law as C in this process, in place of the law in Python."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from surctl.ir import compile_block, replay
from surctl.marine.control import Law, LawStep
from surctl.marine.export.linked import LinkReport

__all__ = ["CompiledLaw"]

Vector = NDArray[np.float64]


@dataclass
class CompiledLaw:
    """Function that computes each control step of `surctl.marine.simulation.simulate` by the law's C, compiled here.

    Attributes:
        law: the law.

    Raises:
        ToolMissing: there is no C compiler.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.export import CompiledLaw
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> law = build_law("closed_form")
        >>> stepper, gains = CompiledLaw(law), load_gains("default")
        >>> run = simulate(load_scenario("pool-behind"), load_vehicle("sur400"), gains=gains, law=law, stepper=stepper)
        >>> run.metrics.reached, stepper.report().differing
        (True, 0)
    """

    law: Law
    _log: list[tuple[Vector, ...]] = field(default_factory=list, init=False, repr=False)
    _times: list[float] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        self._native = compile_block(self.law.block)

    def __call__(self, x: Vector, u: Vector, p: Vector) -> LawStep:
        """Return one control step; numbers that are not finite are left to the law in Python."""
        began = time.perf_counter()
        parts = self._native(x, u, p)
        self._times.append(1e3 * (time.perf_counter() - began))
        self._log.append((x, u, p, *parts))
        if not all(np.isfinite(one).all() for one in (x, u, p, *parts)):
            return self.law.step(x, u, p)
        tau, x_next, status, telemetry = parts
        return LawStep(tau, x_next, int(status[0]), telemetry)

    def report(self) -> LinkReport:
        """Return the statistics of the run; every step is compared with the replay of the law in Python."""
        columns = [np.array(column) for column in zip(*self._log, strict=True)]
        wrong = np.zeros(0, dtype=np.intp)
        if columns:
            mine = np.hstack(replay(self.law.block, *columns[:3]))
            theirs = np.hstack(columns[3:])
            same = (mine == theirs) | (np.isnan(mine) & np.isnan(theirs))
            wrong = np.flatnonzero(~same.all(axis=1))
        trips = (float(np.mean(self._times)), float(np.max(self._times))) if self._times else (0.0, 0.0)
        steps = len(self._log)
        first = int(wrong[0]) if wrong.size else None
        identity = self.law.block.digest()
        return LinkReport(
            "the law's C", identity, "float64", steps, steps, (0, 0), 0, None, "", trips, len(wrong), first
        )
