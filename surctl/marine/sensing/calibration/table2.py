"""Table II of the paper as data: the range test of one sensor in air and in water."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.files import Strict, load_model

__all__ = ["MEDIA", "Medium", "MediumTest", "RangeTest", "table_ii"]

Medium: TypeAlias = Literal["air", "water"]
MEDIA: tuple[Medium, ...] = ("air", "water")


@dataclass(frozen=True)
class MediumTest:
    """The readings of a range test in one medium.

    Attributes:
        measured: (n,) readings [m].
        printed_percent: (n,) relative errors as printed, with one decimal [%].
    """

    measured: NDArray[np.float64]
    printed_percent: NDArray[np.float64]


@dataclass(frozen=True)
class RangeTest:
    """A range test in air and in water.

    Attributes:
        desired: (n,) true distances [m].
        air: readings in air.
        water: readings in water.
        provenance: origin of the numbers.
    """

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


class _Distances(Strict):
    unit: Literal["cm"]
    values: tuple[float, ...]


class _Medium(Strict):
    unit: Literal["cm"]
    measured: tuple[float, ...]
    error_percent: tuple[float, ...]


class _File(Strict):
    kind: Literal["range-test"]
    name: str
    provenance: str
    desired: _Distances
    air: _Medium
    water: _Medium


def table_ii() -> RangeTest:
    """Return Table II: readings at 18 distances from 0.25 to 1.95 m.

    Raises:
        InputError: if the file in the package is damaged.

    Example:
        >>> from surctl.marine.sensing import table_ii
        >>> table = table_ii()
        >>> len(table.desired), table.errors("water")[:3].round(3).tolist(), table.disagreeing("water").tolist()
        (18, [0.01, -0.01, 0.02], [6])
    """
    path = Path(__file__).with_name("table2.toml")
    model = load_model(path, _File)
    count = len(model.desired.values)
    for key, medium in (("air", model.air), ("water", model.water)):
        if {len(medium.measured), len(medium.error_percent)} != {count}:
            raise InputError(
                f"columns differ in length from the {count} distances", file=path, key=key, remedy="restore the file"
            )
    return RangeTest(
        _metres(model.desired.values), _medium_test(model.air), _medium_test(model.water), model.provenance
    )


def _medium_test(medium: _Medium) -> MediumTest:
    return MediumTest(_metres(medium.measured), np.array(medium.error_percent))


def _metres(centimetres: tuple[float, ...]) -> NDArray[np.float64]:
    return np.array(centimetres) / 100.0
