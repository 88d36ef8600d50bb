"""Write the columns of a sweep to a netCDF-4 file one after another, so that memory holds only one column at a time."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl import __version__
from surctl.marine.simulation import Case, case_parameters
from surctl.marine.simulation.store import cannot_write
from surctl.marine.tuning.measure import Evaluation, Quantity, law_digest
from surctl.marine.tuning.table import netcdf_name
from surctl.own_code import label
from surctl.tuning.axes import SEED, Axis, Span
from surctl.tuning.design import Design

__all__ = ["Column", "provenance", "request_of", "write_netcdf"]

_CACHE = 2**20  # bytes of HDF5's cache for each variable; the default size for all columns would fill the memory

Column = tuple[str, Quantity, list[Callable[[], NDArray[np.float64]]], bool]
"""A column: name, unit and meaning, functions that return its values (one, or one for each case), and if by case."""


def write_netcdf(
    path: Path, design: Design, columns: Iterable[Column], *, evaluation: Evaluation, attributes: Mapping[str, str]
) -> None:
    """Write the columns of a sweep as a file; the file gets its final name only when it is complete and on the disk.

    Args:
        path: the file.
        design: the design of the sweep; its axes become the coordinates of the dataset.
        columns: the data variables of the file, each with values (points,).
        evaluation: the evaluation of the sweep, which supplies the names of the cases and of their parameters.
        attributes: global attributes of the file.

    Raises:
        InputError: the disk is full, or the folder cannot be written.
    """
    part = path.with_suffix(f".{os.getpid()}.tmp")
    try:
        _write(part, design, columns, evaluation, attributes)
        with part.open("rb") as file:
            os.fsync(file.fileno())
        part.replace(path)
    except (OSError, RuntimeError) as error:  # netCDF reports a full disk as a RuntimeError
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise cannot_write(path, error) from None


def _write(
    path: Path, design: Design, columns: Iterable[Column], evaluation: Evaluation, attributes: Mapping[str, str]
) -> None:
    import netCDF4

    with netCDF4.Dataset(path, "w", format="NETCDF4") as file:
        file.setncatts({"Conventions": "CF-1.11", **attributes})
        dimensions = _coordinates(file, design, evaluation.cases)
        file.createDimension("case", len(evaluation.cases))
        case = file.createVariable("case", str, ("case",))
        case.long_name = "scenario, vehicle and sensing"
        case[:] = np.array([c.name for c in evaluation.cases], dtype=object)
        for name, quantity, sources, by_case in columns:
            where = ("case", *dimensions) if by_case else dimensions
            variable = _variable(file, name, where, quantity)
            for k, source in enumerate(sources):
                values = source().reshape(design.shape)
                if by_case:
                    variable[k] = values
                else:
                    variable[:] = values


def _variable(file: Any, name: str, dimensions: tuple[str, ...], quantity: Quantity) -> Any:
    variable = file.createVariable(name, "f8", dimensions, fletcher32=True, fill_value=False, chunk_cache=_CACHE)
    variable.units, variable.long_name = quantity.unit, quantity.meaning
    return variable


def _coordinates(file: Any, design: Design, cases: tuple[Case, ...]) -> tuple[str, ...]:
    names = tuple(netcdf_name(name) for name in design.names)
    if design.kind != "grid":
        file.createDimension("point", len(design.points))
    axes: tuple[Axis | Span, ...] = design.axes
    for k, (name, axis) in enumerate(zip(names, axes, strict=True)):
        quantity = _quantity(axis.name, cases)
        if isinstance(axis, Axis):
            file.createDimension(name, len(axis.values))
            _variable(file, name, (name,), quantity)[:] = axis.values
        else:
            _variable(file, name, ("point",), quantity)[:] = design.points[:, k]
    if design.kind == "grid":
        return names
    file.coordinates = " ".join(names)
    return ("point",)


def _quantity(name: str, cases: tuple[Case, ...]) -> Quantity:
    if name == SEED:
        return Quantity("1", "seed of every run")
    parameter = next(table[name] for table in map(case_parameters, cases) if name in table)
    return Quantity(parameter.unit, parameter.meaning)


def provenance(evaluation: Evaluation, design: Design, *, request: str) -> dict[str, str]:
    """Return attributes with the origin of the results, without date and time: equal requests must give equal files."""
    gains = evaluation.cases[0].gains
    cases = [
        {"name": c.name, "law": label(c.law), "priority_mode": c.mode, "seeds": list(evaluation.seeds_of(c))}
        | ({} if c.model is None else {"model": c.model.name})
        for c in evaluation.cases
    ]
    return {
        "title": f"surctl sweep over {', '.join(design.names)}",
        "source": f"surctl {__version__}",
        "request": request,
        "design": design.kind,
        "points": design.description if design.kind != "grid" else f"{len(design.points)} on a grid",
        "axes": json.dumps(design.names),
        "cases": json.dumps(cases),
        "law_sha256": ", ".join(dict.fromkeys(law_digest(c) for c in evaluation.cases)),
        "gains": json.dumps(
            {
                "name": gains.name,
                "values": dict(gains.values),
                "provenance": gains.provenance,
                "source": gains.source,
                **({"own": {name: asdict(spec) for name, spec in gains.own.items()}} if gains.own else {}),
            }
        ),
    }


def request_of(path: Path) -> str | None:
    """Return the request digest stored in a finished sweep file; None if the file is damaged or is no sweep file."""
    import netCDF4

    try:
        with netCDF4.Dataset(path) as file:
            for variable in file.variables.values():
                _ = variable[:]  # reading verifies the stored checksums
            return str(file.getncattr("request"))
    except (OSError, RuntimeError, AttributeError):
        return None
