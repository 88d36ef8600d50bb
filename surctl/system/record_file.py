"""Write a recorded run of a system as CSV, MATLAB's .mat or netCDF, with names, units and identity."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from surctl.errors import InputError
from surctl.recorded_write import RECORD_FORMATS, Column, write_csv, write_mat, write_netcdf
from surctl.system.loop import System
from surctl.system.record import Record

__all__ = ["identity", "save_record"]

_TEXTS = ("identity", "units", "meaning")  # names of the texts in a .mat file


def identity(system: System) -> dict[str, str]:
    """Return names, control period [s] and digests (SHA-256) of a system, for files with results."""
    return {
        "plant": system.plant.name,
        "controller": system.controller.name,
        "period_s": f"{float(system.dt)!r}",
        "controller_sha256": system.controller.block.digest(),
        "system_sha256": system.digest(),
    }


def save_record(record: Record, path: Path | str, *, about: Mapping[str, str] | None = None) -> Path:
    """Write time and all signals of a run, one row per control instant; return the path.

    The end of the name chooses the format; all formats hold the same numbers, to the last bit. CSV: a header with names
    and units, and all digits that are needed to restore each number. .mat: a column vector per signal, named by an
    identifier (`pose[0]` becomes `pose_0`), and the structs `units`, `meaning` and `identity`. netCDF-4: variables
    along the dimension `time` with the attributes `units` and `long_name`; the attributes of the file are the identity.

    Args:
        record: the run.
        path: a file in an existing folder that ends in .csv, .mat or .nc.
        about: further texts of the identity by name, such as the origin of the system. In every case, the identity has
            the names, the digests, the gains, the costs, and why the run ended.

    Raises:
        InputError: the format is unknown, or the folder cannot be written.

    Example:
        >>> from surctl.ir import Layout, Port
        >>> from surctl.recorded import read_recorded
        >>> from surctl.system import Controller, Plant, System, run_system, save_record
        >>> speed, force = Port("speed", (1,), "m/s", "of the cart", 1.0), Port("force", (1,), "m/s^2", "over the mass")
        >>> cart = Plant("cart", Layout((speed,)), Layout((force,)), lambda x, f, d, p: {"speed": f["force"]})
        >>> brake = Controller("brake", 0.1, Layout((speed,)), Layout((force,)), lambda x, u, p: -u["speed"])
        >>> file = save_record(run_system(System(cart, brake), 2.0), "cart.nc")
        >>> read_recorded(file).numbers("speed")[:2].round(3).tolist()
        [1.0, 0.9]
    """
    path = Path(path)
    kind = path.suffix.removeprefix(".")
    if kind not in RECORD_FORMATS:
        raise InputError("has no known format", file=path, remedy="end the name in .csv, .mat or .nc")
    if kind == "csv":
        return write_csv(path, {head: column.tolist() for head, column in record.table().items()})
    texts = identity(record.system) | _outcome(record) | dict(about or {})
    if kind == "nc":
        return write_netcdf(path, record.columns(), sizes={"time": len(record.time)}, attributes=texts)
    return write_mat(path, _identifiers(record.columns()), texts={"identity": texts})


def _outcome(record: Record) -> dict[str, str]:
    controller, costs = record.system.controller, record.system.costs
    gains = {name: np.ravel(value).tolist() for name, value in controller.gains.unpack(record.controller[2]).items()}
    figures = {
        name: {"value": value if np.isfinite(value) else None, "unit": costs[name].unit, "how": costs[name].how}
        for name, value in record.figures.items()
    }
    return {
        "stopped": record.stopped,
        "not_finite": record.lost,
        "gains": json.dumps(gains),
        "costs": json.dumps(figures),
    }


def _identifiers(columns: Mapping[str, Column]) -> dict[str, Column]:
    named: dict[str, Column] = {}
    for label, column in columns.items():
        name = re.sub(r"\W+", "_", label).strip("_")
        while name in named or name in _TEXTS:
            name += "_"
        named[name] = column
    return named
