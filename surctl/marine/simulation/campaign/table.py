"""The table with the results of all runs of a campaign."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.marine.simulation.metrics import METRICS, STOPS

__all__ = ["RunTable"]

_FIRST = ("collided", "reached")  # true or false


@dataclass(frozen=True, eq=False)
class RunTable:
    """The results of n runs of a campaign.

    Attributes:
        seeds: (n,) seed of each run.
        figures: (n, len(METRICS)) metrics of the runs, columns in the order of `METRICS`.
        values: (n,) drawn values by parameter name.
        broken: (n,) names of the violated assumptions of each run.
    """

    seeds: NDArray[np.int64]
    figures: NDArray[np.float64]
    values: Mapping[str, NDArray[np.float64]]
    broken: tuple[tuple[str, ...], ...]

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.seeds)

    def column(self, name: str) -> NDArray[np.float64]:
        """Return one metric (n,)."""
        return self.figures[:, list(METRICS).index(name)]

    def stopped(self, k: int) -> str:
        """Return the reason why run number k ended, one of `STOPS`."""
        return STOPS[round(float(self.column("stopped")[k]))]

    def worst(self, count: int) -> list[int]:
        """Return the indices of the worst runs: first collided runs, then runs that did not arrive, then the rest.

        Within these three groups, runs with a smaller clearance come first.
        """
        collided, reached = self.column("collided"), self.column("reached")
        order = np.lexsort((self.seeds, self.column("min_clearance_m"), reached, -collided))
        return [int(k) for k in order[:count]]

    def row(self, k: int) -> dict[str, Any]:
        """Return run k as plain data: seed, reason for its end, metrics, violated assumptions, drawn values."""
        figures = {name: float(self.figures[k, j]) for j, name in enumerate(METRICS) if name != "stopped"}
        for name in _FIRST:
            figures[name] = bool(figures[name])
        result = {"seed": int(self.seeds[k]), "stopped_because": self.stopped(k), **figures}
        draw = {name: float(column[k]) for name, column in self.values.items()}
        return {**result, "broken_assumptions": list(self.broken[k]), "draw": draw}

    def to_csv(self) -> str:
        """Return all runs as CSV text with one line per run; every number is written with all its digits."""
        text = io.StringIO()
        names = [name for name in METRICS if name != "stopped"]
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["seed", "stopped_because", *names, "broken_assumptions", *self.values])
        for k in range(len(self)):
            row = self.row(k)
            cells = [int(row[name]) if name in _FIRST else repr(row[name]) for name in names]
            draw = [repr(value) for value in row["draw"].values()]
            broken = "; ".join(row["broken_assumptions"])
            writer.writerow([row["seed"], row["stopped_because"], *cells, broken, *draw])
        return text.getvalue()
