"""Read the columns of a recording from a MATLAB .mat or a netCDF file, as an alternative to a CSV file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError

__all__ = ["ARRAY_FILES", "read_arrays"]

Contents = tuple[dict[str, Any], str]
"""The variables by name, and the text of the file's variable or attribute `frame`."""


def read_arrays(path: Path, *, name: str) -> tuple[dict[str, NDArray[np.float64]], str]:
    """Return the columns (n,) of a file by name, and its text `frame` (empty if the file has none).

    The columns are the numeric vectors that are as long as `t_s`, or as the first vector if the file has no `t_s`. All
    other variables are ignored.

    Args:
        path: a file that ends in .mat or .nc.
        name: name of the file in error messages.

    Raises:
        InputError: the file does not exist, cannot be read as its format, or has no columns.

    Example:
        >>> from pathlib import Path
        >>> from scipy.io import savemat
        >>> from surctl.recorded_arrays import read_arrays
        >>> savemat("log.mat", {"t_s": [0.0, 0.1], "x_m": [1.5, 1.6], "frame": "ned"})
        >>> columns, frame = read_arrays(Path("log.mat"), name="log.mat")
        >>> columns["x_m"].tolist(), frame
        ([1.5, 1.6], 'ned')
    """
    if not path.is_file():
        raise InputError("no such file", file=name, remedy="check the path")
    contents, frame = ARRAY_FILES[path.suffix.lower()](path, name)
    vectors = {key: v for key, value in contents.items() if (v := _vector(value)) is not None}
    if not vectors:
        raise InputError("has no numeric vectors", file=name, remedy="save each column as a vector with its name")
    size = len(vectors.get("t_s", next(iter(vectors.values()))))
    columns = {key: vector for key, vector in vectors.items() if len(vector) == size}
    if not size:
        raise InputError("has no rows", file=name, remedy="add rows")
    return columns, frame


def _vector(value: object) -> NDArray[np.float64] | None:
    array = np.squeeze(np.asarray(value))
    if array.ndim > 1 or array.dtype.kind not in "fiub":
        return None
    return np.atleast_1d(np.ma.filled(array.astype(float), np.nan))


def _mat(path: Path, name: str) -> Contents:
    from scipy.io import loadmat

    if _is_hdf5(path):
        return _mat73(path, name)
    try:
        held = loadmat(path, squeeze_me=True, chars_as_strings=True)
    except (
        OSError, ValueError, TypeError, KeyError, IndexError, EOFError, OverflowError, MemoryError, NotImplementedError,
    ) as error:  # fmt: skip
        raise InputError(f"cannot be read as a MAT-file ({error})", file=name, remedy="save it with -v7") from None
    frame = held.get("frame")
    return {key: value for key, value in held.items() if not key.startswith("__")}, str(frame or "")


def _is_hdf5(path: Path) -> bool:
    # a MAT-file of version 7.3 has a header of 512 bytes before the HDF5 signature
    with path.open("rb") as file:
        return b"MATLAB 7.3" in file.read(124) or b"\x89HDF\r\n" in file.read(520)


def _mat73(path: Path, name: str) -> Contents:
    try:
        import h5py
    except ImportError:
        raise InputError(
            "is a MAT-file of version 7.3, which needs the package h5py",
            file=name,
            remedy="save it with -v7, or install it: pip install 'surctl[matlab]'",
        ) from None
    try:
        with h5py.File(path) as file:
            held = {key: value[()] for key, value in file.items() if isinstance(value, h5py.Dataset)}
            texts = {key for key in held if file[key].attrs.get("MATLAB_class", b"") == b"char"}
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        raise InputError(f"cannot be read as a MAT-file ({error})", file=name, remedy="save it with -v7") from None
    frame = "".join(chr(int(c)) for c in np.ravel(held["frame"])) if "frame" in texts else ""
    return {key: value for key, value in held.items() if key not in texts}, frame


def _netcdf(path: Path, name: str) -> Contents:
    import netCDF4

    try:
        with netCDF4.Dataset(path) as file:
            values = {key: np.ma.filled(variable[:], np.nan) for key, variable in _numeric(file).items()}
            return values, str(getattr(file, "frame", ""))
    except (OSError, RuntimeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot be read as a netCDF file ({reason})", file=name, remedy="save it again") from None


def _numeric(file: Any) -> Mapping[str, Any]:
    return {key: v for key, v in file.variables.items() if getattr(v.dtype, "kind", "") in "fiu"}


ARRAY_FILES: Mapping[str, Callable[[Path, str], Contents]] = {".mat": _mat, ".nc": _netcdf}
