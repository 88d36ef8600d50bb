"""Write named columns as a CSV, MATLAB .mat or netCDF file; `recorded` reads such files."""

from __future__ import annotations

import csv
import errno
import io
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from shutil import disk_usage
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.files import write_file

__all__ = ["RECORD_FORMATS", "Column", "RecordFormat", "write_csv", "write_mat", "write_netcdf"]

RecordFormat = Literal["csv", "mat", "nc"]
RECORD_FORMATS: tuple[RecordFormat, ...] = get_args(RecordFormat)

_CACHE = 2**20  # bytes of HDF5's cache for each variable; the default size for all columns would fill the memory
_LITTLE = 100_000  # bytes of free space below which a failure counts as a full disk
_LONG = 31  # longest field name of MATLAB's short form


@dataclass(frozen=True, eq=False)
class Column:
    """Values of one variable, with unit and meaning; the unit of text values is empty.

    `dimensions` names the dimensions in a netCDF file; None: see `write_netcdf`.
    """

    values: NDArray[Any]
    unit: str
    meaning: str
    dimensions: tuple[str, ...] | None = None


def write_csv(path: Path, columns: Mapping[str, Sequence[Any]]) -> Path:
    """Write columns below a header, with all digits that are needed to restore each number; return the path.

    Raises:
        InputError: the folder cannot be written.

    Example:
        >>> from pathlib import Path
        >>> from surctl.recorded_write import write_csv
        >>> write_csv(Path("run.csv"), {"time [s]": [0.0, 0.1], "end": ["", "fallen"]}).read_text()
        'time [s],end\\n0.0,\\n0.1,fallen\\n'
    """
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(columns)
    rows.writerows(zip(*columns.values(), strict=True))
    return write_file(path, text.getvalue())


def write_mat(path: Path, columns: Mapping[str, Column], *, texts: Mapping[str, str | Mapping[str, str]]) -> Path:
    """Write one column vector per name, the `texts`, and the structs `units` and `meaning`; return the path.

    Raises:
        InputError: the folder cannot be written.

    Example:
        >>> from pathlib import Path
        >>> import numpy as np
        >>> from scipy.io import loadmat
        >>> from surctl.recorded_write import Column, write_mat
        >>> depth = Column(np.array([1.0, 1.5]), "m", "below the surface")
        >>> read = loadmat(write_mat(Path("run.mat"), {"depth": depth}, texts={"about": "a dive"}), simplify_cells=True)
        >>> read["depth"].tolist(), read["units"], read["about"]
        ([1.0, 1.5], {'depth': 'm'}, 'a dive')
    """
    from scipy.io import savemat

    held = io.BytesIO()
    about = {"units": {n: c.unit for n, c in columns.items()}, "meaning": {n: c.meaning for n, c in columns.items()}}
    vectors = {name: np.asarray(column.values, dtype=float)[:, None] for name, column in columns.items()}
    long = max(map(len, columns), default=0) > _LONG
    savemat(held, {**vectors, **texts, **about}, oned_as="column", long_field_names=long)
    head = b"MATLAB 5.0 MAT-file, a run of surctl".ljust(116)  # replaces the date that scipy writes
    return write_file(path, head + held.getvalue()[116:])


def write_netcdf(
    path: Path,
    columns: Mapping[str, Column] | Iterable[tuple[str, Column]],
    *,
    sizes: Mapping[str, int],
    attributes: Mapping[str, Any],
    checksums: bool = False,
) -> Path:
    """Write a netCDF-4 file under a temporary name, rename it when it is complete, and return its path.

    Args:
        path: the file.
        columns: variables with attributes `units` and `long_name`, which are written one after another. Without
            dimensions of its own, the one with the name of a dimension has this dimension, every other one all of them.
        sizes: sizes of the dimensions by name.
        attributes: global attributes.
        checksums: whether readers detect damaged values.

    Raises:
        InputError: the disk is full, or the folder cannot be written.

    Example:
        >>> from pathlib import Path
        >>> import numpy as np
        >>> import xarray
        >>> from surctl.recorded_write import Column, write_netcdf
        >>> depth, k = Column(np.array([1.0, 1.5]), "m", "below the surface"), Column(np.array([3, 4]), "1", "gain")
        >>> file = write_netcdf(Path("sweep.nc"), {"k": k, "depth": depth}, sizes={"k": 2}, attributes={"by": "me"})
        >>> with xarray.open_dataset(file) as read:
        ...     print(read["depth"].sel(k=4).item(), read["depth"].units, read.attrs["by"])
        1.5 m me
    """
    import netCDF4

    part = path.with_suffix(f".{os.getpid()}.tmp")
    try:
        with netCDF4.Dataset(part, "w", format="NETCDF4") as file:
            file.setncatts({"Conventions": "CF-1.11", **attributes})
            for name, size in sizes.items():
                file.createDimension(name, size)
            for name, column in columns.items() if isinstance(columns, Mapping) else columns:
                text = column.values.dtype.kind not in "fiub"
                dimensions = column.dimensions or ((name,) if name in sizes else tuple(sizes))
                sums: dict[str, Any] = {"fletcher32": True, "fill_value": False} if checksums and not text else {}
                variable = file.createVariable(name, str if text else "f8", dimensions, chunk_cache=_CACHE, **sums)
                variable.setncatts(({} if text else {"units": column.unit}) | {"long_name": column.meaning})
                values = column.values.reshape([sizes[dimension] for dimension in dimensions])
                variable[:] = values.astype(object) if text else values
        with part.open("rb") as written:
            os.fsync(written.fileno())
        part.replace(path)
    except (OSError, RuntimeError) as error:  # netCDF reports a full disk as a RuntimeError
        with suppress(OSError):
            part.unlink(missing_ok=True)
        reason = getattr(error, "strerror", None) or str(error)
        with suppress(OSError):  # HDF5 names another reason for a full disk
            reason = os.strerror(errno.ENOSPC) if disk_usage(path.parent).free < _LITTLE else reason
        remedy = "free disk space or name another folder"
        raise InputError(f"cannot be written ({reason})", file=path, remedy=remedy) from None
    return path
