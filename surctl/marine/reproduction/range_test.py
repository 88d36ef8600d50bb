"""Table II of the paper: the readings of its range sensor in air and in water."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

Medium: TypeAlias = Literal["air", "water"]
MEDIA: tuple[Medium, ...] = ("air", "water")


@dataclass(frozen=True)
class MediumTest:
    """The readings of a range test in one medium: (n,) measured [m], and (n,) printed relative errors [%]."""

    measured: NDArray[np.float64]
    printed_percent: NDArray[np.float64]


@dataclass(frozen=True)
class RangeTest:
    """A range test in air and in water: true distances `desired` (n,) [m], readings, and origin of the numbers."""

    desired: NDArray[np.float64]
    air: MediumTest
    water: MediumTest
    provenance: str

    def errors(self, medium: Medium) -> NDArray[np.float64]:
        """Return measured minus desired distance (n,) [m]."""
        error: NDArray[np.float64] = self.column(medium).measured - self.desired
        return error

    def percent(self, medium: Medium) -> NDArray[np.float64]:
        """Return the relative errors |measured − desired| / desired (n,) [%], recomputed from the readings."""
        relative: NDArray[np.float64] = 100.0 * np.abs(self.errors(medium)) / self.desired
        return relative

    def disagreeing(self, medium: Medium) -> NDArray[np.intp]:
        """Return the indices of readings whose printed percentage differs from the recomputed value (erratum E2)."""
        gap = np.abs(self.percent(medium) - self.column(medium).printed_percent)
        return np.flatnonzero(gap > 0.05 + 1e-9)

    def column(self, medium: Medium) -> MediumTest:
        """Return the readings in one medium."""
        return self.air if medium == "air" else self.water


def table_ii() -> RangeTest:
    """Return Table II: readings at 18 distances from 0.25 to 1.95 m."""
    table = tomllib.loads(Path(__file__).with_name("table2.toml").read_text(encoding="utf-8"))
    air, water = (
        MediumTest(np.array(table[medium]["measured"]) / 100.0, np.array(table[medium]["error_percent"]))
        for medium in MEDIA
    )
    return RangeTest(np.array(table["desired"]["values"]) / 100.0, air, water, table["provenance"])
