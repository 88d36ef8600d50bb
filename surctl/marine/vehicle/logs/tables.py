"""Read tables (CSV, .mat, netCDF) as a recording of one topic."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from surctl.errors import InputError, nearest
from surctl.marine.vehicle.logs.recording import Recording, topic_of
from surctl.recorded import Recorded, read_recorded, read_unnamed
from surctl.units import in_unit

__all__ = ["read_table"]


def read_table(
    path: Path, *, time: str, unit: str, columns: Sequence[str] | None = None, skip_lines: int = 0, map_name: str = ""
) -> Recording:
    """Read the numeric columns of a table as the fields of one topic with an empty name.

    Args:
        path: a file .csv, .mat or .nc; with `columns`, a text file of numbers without a header.
        time: column of the time.
        unit: unit of the time.
        columns: names of the columns of a file without a header.
        skip_lines: lines above its numbers.
        map_name: file that names the time, for errors; default: the table.

    Raises:
        InputError: the file cannot be read, the time is missing or not a number, or its unit is unknown.
    """
    table = read_recorded(path) if columns is None else read_unnamed(path, columns, skip=skip_lines)
    if time not in table.columns:
        raise InputError(
            f"is not a column of {table.name}",
            file=map_name or table.name,
            key="log.time",
            value=time,
            remedy=nearest(time, table.columns),
        )
    seconds = table.numbers(time) * in_unit(1.0, unit, "s")
    fields = {name: column for name in table.columns if name != time and (column := _numbers(table, name)) is not None}
    known = np.isfinite(seconds)
    if np.count_nonzero(known) == 1:
        raise InputError("has only one row with a time", file=table.name, key=time, remedy="give a longer log")
    if not known.any():
        raise InputError(
            f"has no timestamps in {table.name}",
            file=map_name or table.name,
            key="log.time",
            value=time,
            remedy="name the column of the time",
        )
    return Recording(table.name, {"": topic_of(seconds[known], {k: v[known] for k, v in fields.items()})})


def _numbers(table: Recorded, name: str) -> np.ndarray[tuple[int], np.dtype[np.float64]] | None:
    # texts, such as the state of a mission, are no field
    try:
        return table.numbers(name)
    except InputError:
        return None
