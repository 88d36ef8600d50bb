"""The coordinates of a sweep's file, and the attributes that state the origin of its results."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict

import numpy as np

from surctl import __version__
from surctl.marine.simulation import Case, case_parameters
from surctl.marine.tuning.measure import ColumnSpec, SweepEvaluation, law_digest
from surctl.marine.tuning.table import netcdf_name
from surctl.own_code import label
from surctl.recorded_write import Column
from surctl.tuning.axes import SEED, Axis, Span
from surctl.tuning.design import Design

__all__ = ["coordinates", "provenance", "sizes_of"]


def sizes_of(design: Design) -> dict[str, int]:
    """Return the dimensions of a column: the axes of a grid, otherwise `point`."""
    names = [netcdf_name(name) for name in design.names] if design.kind == "grid" else ["point"]
    return dict(zip(names, design.shape, strict=True))


def coordinates(design: Design, cases: tuple[Case, ...]) -> Iterator[tuple[str, Column]]:
    """Yield the columns of the axes and the names of the cases."""
    axes: tuple[Axis | Span, ...] = design.axes
    for k, axis in enumerate(axes):
        name, quantity = netcdf_name(axis.name), _quantity(axis.name, cases)
        values, at = (np.array(axis.values), name) if isinstance(axis, Axis) else (design.points[:, k], "point")
        yield name, Column(values, quantity.unit, quantity.meaning, (at,))
    yield "case", Column(np.array([c.name for c in cases]), "", "scenario, vehicle and sensing", ("case",))


def _quantity(name: str, cases: tuple[Case, ...]) -> ColumnSpec:
    if name == SEED:
        return ColumnSpec("1", "seed of every run")
    parameter = next(table[name] for table in map(case_parameters, cases) if name in table)
    return ColumnSpec(parameter.unit, parameter.meaning)


def provenance(evaluation: SweepEvaluation, design: Design, *, request: str) -> dict[str, str]:
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
        **({} if design.kind == "grid" else {"coordinates": " ".join(netcdf_name(name) for name in design.names)}),
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
