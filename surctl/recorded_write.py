"""Write named columns as a CSV, .mat or netCDF file, and messages as an MCAP file for Foxglove, in chunks."""

from __future__ import annotations

import csv
import errno
import importlib
import io
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from shutil import disk_usage
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from surctl.errors import ToolMissing, cannot_write
from surctl.files import Closeable, opened, write_file

__all__ = [
    "RECORD_FORMATS", "SCHEMAS", "Column", "McapFile", "RecordFormat", "stamp", "write_csv", "write_mat",
    "write_netcdf",
]  # fmt: skip

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
        cause: Exception = error
        with suppress(OSError):  # HDF5 names another reason for a full disk
            if disk_usage(path.parent).free < _LITTLE:
                cause = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        raise cannot_write(path, cause) from None
    return path


# Write MCAP files with the JSON schemas of Foxglove, message by message (needs the package mcap).
#
# JSON rather than Protobuf: the file describes itself, needs no generated code and no further package to write or read,
# and after the compression of a chunk it is small enough (an hour of 20 Hz in 15 to 35 MB).


_NUMBER, _TEXT, _BOOL = {"type": "number"}, {"type": "string"}, {"type": "boolean"}
_WHOLE = {"type": "integer"}


def _object(**parts: Any) -> dict[str, Any]:
    return {"type": "object", "properties": parts}


def _list(part: Mapping[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": part}


_TIME = _object(sec=_WHOLE, nsec=_WHOLE)
_XYZ = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_TURN = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE = _object(position=_XYZ, orientation=_TURN)
_COLOR = _object(r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_LINE = _object(
    type=_WHOLE, pose=_POSE, thickness=_NUMBER, scale_invariant=_BOOL, points=_list(_XYZ), color=_COLOR,
    colors=_list(_COLOR), indices=_list(_WHOLE),
)  # fmt: skip
_ENTITY = _object(
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_TIME,
    frame_locked=_BOOL,
    metadata=_list(_object(key=_TEXT, value=_TEXT)),
    arrows=_list(_object()),
    cubes=_list(_object(pose=_POSE, size=_XYZ, color=_COLOR)),
    spheres=_list(_object(pose=_POSE, size=_XYZ, color=_COLOR)),
    cylinders=_list(_object(pose=_POSE, size=_XYZ, bottom_scale=_NUMBER, top_scale=_NUMBER, color=_COLOR)),
    lines=_list(_LINE),
    triangles=_list(_object()),
    texts=_list(_object()),
    models=_list(_object()),
)

SCHEMAS: Mapping[str, dict[str, Any]] = {
    "foxglove.PoseInFrame": _object(timestamp=_TIME, frame_id=_TEXT, pose=_POSE),
    "foxglove.PosesInFrame": _object(timestamp=_TIME, frame_id=_TEXT, poses=_list(_POSE)),
    "foxglove.FrameTransform": _object(
        timestamp=_TIME, parent_frame_id=_TEXT, child_frame_id=_TEXT, translation=_XYZ, rotation=_TURN
    ),
    "foxglove.LaserScan": _object(
        timestamp=_TIME, frame_id=_TEXT, pose=_POSE, start_angle=_NUMBER, end_angle=_NUMBER, ranges=_list(_NUMBER),
        intensities=_list(_NUMBER),
    ),
    "foxglove.SceneUpdate": _object(
        deletions=_list(_object(timestamp=_TIME, type=_WHOLE, id=_TEXT)), entities=_list(_ENTITY)
    ),
    "foxglove.Log": _object(timestamp=_TIME, level=_WHOLE, message=_TEXT, name=_TEXT, file=_TEXT, line=_WHOLE),
    "surctl.State": _object(
        timestamp=_TIME, x_m=_NUMBER, y_m=_NUMBER, z_m=_NUMBER, heading_deg=_NUMBER, surge_m_per_s=_NUMBER,
        sway_m_per_s=_NUMBER, heave_m_per_s=_NUMBER, yaw_rate_deg_per_s=_NUMBER,
    ),
    "surctl.Thrust": _object(
        timestamp=_TIME, surge_n=_NUMBER, sway_n=_NUMBER, heave_n=_NUMBER, yaw_n_m=_NUMBER
    ),
    "surctl.Status": _object(timestamp=_TIME, status=_WHOLE, clearance_m=_NUMBER, values=_object()),
}  # fmt: skip
"""JSON Schemas by name: those of Foxglove, whose panels show them, and those of plots."""


def stamp(time: float) -> dict[str, int]:
    """Return a time [s], not negative, as Foxglove's seconds and nanoseconds.

    Example:
        >>> from surctl.recorded_write import stamp
        >>> stamp(1.25)
        {'sec': 1, 'nsec': 250000000}
    """
    nanoseconds = round(time * 1e9)
    return {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9}


_CHUNK = 1 << 18  # bytes of messages


class McapFile(Closeable):
    """An MCAP file that grows by one compressed chunk at a time; use it in a `with` statement.

    A process that is killed loses at most the messages of the last chunk; `mcap recover` rebuilds the index.

    Args:
        path: the file.
        new: whether the file must not exist yet.
        epoch: time [s] of the Unix epoch that is added to every time.

    Raises:
        ToolMissing: the package mcap is not installed.
        InputError: the file cannot be written, or is there already.

    Example:
        >>> from pathlib import Path
        >>> from surctl.recorded_write import McapFile, stamp
        >>> with McapFile(Path("run.mcap")) as file:
        ...     message = {"level": 2, "message": "begins", "name": "law", "file": "", "line": 0}
        ...     file.write("/log", "foxglove.Log", 0.5, {"timestamp": stamp(0.5), **message})
        >>> Path("run.mcap").read_bytes()[1:5]
        b'MCAP'
    """

    def __init__(self, path: Path, *, new: bool = False, epoch: float = 0.0) -> None:
        try:
            writer = importlib.import_module("mcap.writer")
        except ImportError:
            raise ToolMissing(
                "needs the package mcap, which is not installed",
                key=path.suffix,
                remedy="install it: pip install 'surctl[field]'",
            ) from None
        self._file = opened(path, new=new)
        self.path, self.epoch = path, epoch
        self._writer = writer.Writer(self._file, chunk_size=_CHUNK)
        self._writer.start(library="surctl")
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}

    def close(self) -> None:
        """Write the index and close the file."""
        if not self._file.closed:
            self._writer.finish()
            self._file.close()

    def flush(self) -> None:
        """Hand the messages of the current chunk to the operating system."""
        self._writer.flush()

    def write(self, topic: str, schema: str, time: float, message: Mapping[str, Any]) -> None:
        """Write one message; numbers that are not finite become null.

        Args:
            topic: name of the topic, such as "/pose".
            schema: a key of `SCHEMAS`.
            time: time of the message [s].
            message: the message, in the form of the schema.
        """
        if topic not in self._channels:
            if schema not in self._schemas:
                text = json.dumps({"title": schema, **SCHEMAS[schema]}).encode()
                self._schemas[schema] = self._writer.register_schema(schema, "jsonschema", text)
            self._channels[topic] = self._writer.register_channel(topic, "json", self._schemas[schema])
        when = round((self.epoch + time) * 1e9)
        try:
            data = json.dumps(message, allow_nan=False, separators=(",", ":"))
        except ValueError:
            message = json.loads(json.dumps(message), parse_constant=lambda _: None)
            data = json.dumps(message, separators=(",", ":"))
        self._writer.add_message(self._channels[topic], when, data.encode(), when)
