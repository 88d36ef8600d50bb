"""Results of a finished parameter sweep: the xarray dataset, the columns by name, and the best point."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.marine.control import Gains, GainSpec
from surctl.verification.linear import LEAST_DISK_MARGIN
from surctl.verification.loops import LEAST_DELAY_MARGIN

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["SweepTable", "SweptAxis", "load_sweep"]


@dataclass(frozen=True, eq=False)
class SweptAxis:
    """A parameter of a sweep with its unit and values: the values of a grid, or one value per point otherwise."""

    name: str
    unit: str
    meaning: str
    values: NDArray[np.float64] = field(repr=False)


@dataclass(frozen=True, eq=False)
class SweepTable:
    """A finished sweep.

    Attributes:
        dataset: xarray dataset; its dimensions are the axes of a grid, or `point` for other designs. Every column of
            results is a data variable with the attributes `units` and `long_name`. Columns whose name starts with
            `case_` hold the results of single cases and have `case` as first dimension. Values are read from the file
            on access.
    """

    dataset: xr.Dataset = field(repr=False)

    @property
    def is_grid(self) -> bool:
        """Whether the design is a full grid: every combination of the axes' values was evaluated."""
        return bool(self.dataset.attrs["design"] == "grid")

    @cached_property
    def axes(self) -> tuple[SweptAxis, ...]:
        """The parameters that the sweep varies, in the order of the dimensions."""
        axes = []
        for name in json.loads(self.dataset.attrs["axes"]):
            values = self.dataset[netcdf_name(name)]
            axes.append(SweptAxis(name, values.attrs["units"], values.attrs["long_name"], np.asarray(values.values)))
        return tuple(axes)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a column."""
        return tuple(self.dataset[self.columns[0]].shape)

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that cover all cases together."""
        return tuple(name for name, dims in self._dimensions.items() if "case" not in dims)

    @cached_property
    def _dimensions(self) -> Mapping[str, tuple[str, ...]]:
        # of every data variable; xarray builds an object each time that it is asked for one
        return {str(name): tuple(map(str, v.dims)) for name, v in self.dataset.data_vars.items()}

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of every column."""
        return {name: str(self.dataset[name].attrs["units"]) for name in self.columns}

    @cached_property
    def cases(self) -> tuple[str, ...]:
        """Names of the cases that were simulated at every point."""
        return tuple(str(name) for name in self.dataset["case"].values)

    @property
    def path(self) -> Path | None:
        """The file from which the results are read; None for results in memory."""
        source = self.dataset.encoding.get("source")
        return Path(source) if source else None

    def column(self, name: str, *, case: str | None = None) -> NDArray[np.float64]:
        """Return a column, over all cases or of one case, in the shape of the design.

        If there is no such column, the InputError suggests a similar name.
        """
        known = self.columns
        if case is not None:
            known = tuple(v.removeprefix("case_") for v in self._dimensions if v.startswith("case_"))
        if name not in known:
            raise InputError("no such column", key="column", value=name, remedy=nearest(name, known))
        if case is None:
            return np.asarray(self.dataset.variables[name].values)
        if case not in self.cases:
            raise InputError("no such case", key="case", value=case, remedy=nearest(case, self.cases))
        return np.asarray(self.dataset.variables["case_" + name][self.cases.index(case)].values)

    @property
    def picked(self) -> tuple[int, ...] | None:
        """Index of the feasible point with the least score; None if no point is feasible.

        The score is the mean deviation in hull radii plus the largest ratio of arrival time to ideal time. A point is
        feasible if every run arrives without contact and, where margins were computed, the margins suffice.
        """
        score = np.where(self.column("feasible") > 0.5, self.column("score"), np.inf)
        if not np.isfinite(score).any():
            return None
        return tuple(int(k) for k in np.unravel_index(int(np.nanargmin(score)), score.shape))

    def at(self, index: tuple[int, ...]) -> dict[str, float]:
        """Return the values of the axes at a point."""
        if self.is_grid:
            return {axis.name: float(axis.values[k]) for axis, k in zip(self.axes, index, strict=True)}
        return {axis.name: float(axis.values[index]) for axis in self.axes}

    def row(self, index: tuple[int, ...]) -> dict[str, float]:
        """Return the values of the axes and of every column at a point."""
        return self.at(index) | {name: float(self.dataset.variables[name][index].values) for name in self.columns}

    def rows(self) -> list[dict[str, float]]:
        """Return the values of the axes and of every column at every point, in C order."""
        columns = {name: self.column(name).reshape(-1) for name in self.columns}
        points = [self.at(index) for index in np.ndindex(self.shape)]
        return [p | {name: float(values[k]) for name, values in columns.items()} for k, p in enumerate(points)]

    @property
    def base(self) -> Gains:
        """The base gains: the gains that the cases had before the sweep varied them."""
        stored = json.loads(self.dataset.attrs["gains"])
        own = {name: GainSpec(**spec) for name, spec in stored.pop("own", {}).items()}
        return Gains(**stored, own=own)

    @property
    def gains(self) -> Gains:
        """The base gains with the values of the best feasible point; the base gains if there is no choice of points."""
        if self.picked is None or np.prod(self.shape) == 1:
            return self.base
        chosen = self.at(self.picked)
        what = ", ".join(f"{name} = {value:g}" for name, value in chosen.items())
        return self.base.with_values(
            {name: value for name, value in chosen.items() if name in self.base.values},
            provenance=f"{self.base.provenance}; picked by a {self.dataset.attrs['design']} sweep: {what}",
            how="picked",
        )


def judged(columns: Mapping[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    """Return the columns of score and feasibility, which are computed from the given columns.

    The path error is not part of the score, because it covers only the time outside avoidance, and the gains change
    this time.
    """
    feasible = (columns["reached_worst"] > 0.5) & (columns["min_clearance_m_worst"] > 0)
    if "delay_margin_s" in columns:
        feasible &= (columns["delay_margin_s"] >= LEAST_DELAY_MARGIN) & (columns["disk_margin"] >= LEAST_DISK_MARGIN)
    return {"score": columns["strayed"] + columns["time_ratio"], "feasible": feasible.astype(float)}


def load_sweep(path: Path | str) -> SweepTable:
    """Load a finished sweep from its netCDF file; the columns are read on access.

    Raises:
        InputError: the file does not exist, or it is not the table of a sweep.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import build_cases, load_sweep, sweep
        >>> from surctl.tuning import grid, parse_axis
        >>> cases = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
        >>> _ = sweep(cases, grid([parse_axis("k_v=1,1.5,2")]), linear=False, out=Path("swept"))
        >>> table = load_sweep("swept/sweep.nc")
        >>> table.axes[0].values.tolist(), table.column("time_s").round(2).tolist(), table.units["time_s"]
        ([1.0, 1.5, 2.0], [21.4, 20.45, 20.15], 's')
    """
    import xarray as xr  # takes seconds to import

    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", file=path, remedy="give the sweep.nc of a finished sweep")
    dataset: Any = None
    try:
        dataset = xr.open_dataset(path.resolve(), engine="netcdf4", cache=False)
        missing = {"design", "axes", "request", "gains"} - set(dataset.attrs)
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(
            f"is not a readable netCDF file ({type(error).__name__})", file=path, remedy="run the sweep again"
        ) from None
    if missing:
        dataset.close()
        raise InputError("is not the table of a sweep", file=path, remedy="give the sweep.nc of a finished sweep")
    return SweepTable(dataset)


def netcdf_name(name: str) -> str:
    """Return the name of a parameter without slashes, because netCDF reads a slash as the separator of a path."""
    return name.replace("/", "|")
