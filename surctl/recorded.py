"""Read recordings: CSV (any line end, `sep=,`, no header), .mat, netCDF; XML; largest size of a file, no devices."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest

__all__ = ["LARGEST_XML", "NO_HEADER", "Recorded", "file_bytes", "read_recorded", "read_unnamed", "shown", "xml_root"]

_Contents = tuple[dict[str, Any], str]
"""The variables by name, and the text of the file's variable or attribute `frame`."""


def _read_arrays(path: Path, *, name: str) -> tuple[dict[str, NDArray[np.float64]], str]:
    """Return the columns (n,) of a file by name, and its text `frame` (empty if the file has none).

    The columns are the numeric vectors that are as long as `t_s`, or as the first vector if the file has no `t_s`. All
    other variables are ignored.

    Args:
        path: a file that ends in .mat or .nc.
        name: name of the file in error messages.

    Raises:
        InputError: the file does not exist, cannot be read as its format, or has no columns.
    """
    if not path.is_file():
        raise InputError("no such file", file=name, remedy="check the path")
    contents, frame = _ARRAY_FILES[path.suffix.lower()](path, name)
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


def _mat(path: Path, name: str) -> _Contents:
    from scipy.io import loadmat

    with path.open("rb") as file:  # a MAT-file of version 7.3 has a header of 512 bytes before the HDF5 signature
        hdf5 = b"MATLAB 7.3" in file.read(124) or b"\x89HDF\r\n" in file.read(520)
    if hdf5:
        return _hdf5(path, name, kind="MAT-file", remedy="save it with -v7")
    try:
        held = loadmat(path, squeeze_me=True, chars_as_strings=True)
    except (
        OSError, ValueError, TypeError, KeyError, IndexError, EOFError, OverflowError, MemoryError, NotImplementedError,
    ) as error:  # fmt: skip
        raise InputError(f"cannot be read as a MAT-file ({error})", file=name, remedy="save it with -v7") from None
    frame = held.get("frame")
    return {key: value for key, value in held.items() if not key.startswith("__")}, str(frame or "")


def _hdf5(path: Path, name: str, *, kind: str = "netCDF file", remedy: str = "save it again") -> _Contents:
    """Return the contents of a netCDF file, or of a MAT-file of version 7.3: both are HDF5 files."""
    import netCDF4

    try:
        with netCDF4.Dataset(path) as file:
            file.set_auto_mask(kind == "netCDF file")  # MATLAB has no number that means a missing one
            numeric = {key: v for key, v in file.variables.items() if getattr(v.dtype, "kind", "") in "fiu"}
            values = {key: np.ma.filled(v[:].astype(float), np.nan) for key, v in numeric.items()}
            texts = {key: values.pop(key) for key, v in numeric.items() if getattr(v, "MATLAB_class", "") == "char"}
            written = "".join(chr(int(c)) for c in np.ravel(texts.get("frame", [])))
            return values, written or str(getattr(file, "frame", ""))
    except (OSError, RuntimeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot be read as a {kind} ({reason})", file=name, remedy=remedy) from None


_ARRAY_FILES: Mapping[str, Callable[[Path, str], _Contents]] = {".mat": _mat, ".nc": _hdf5}


_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+(\.\d*)?")
_SEPARATOR = re.compile(r"\"?sep=[,;\t]\"?,*[ \t]*(\n|$)", re.IGNORECASE)
_MISSING = {"", "na", "n/a", "null", "none"}  # cells that mean "no number", in addition to nan
_TABLE = "give a CSV file with a header and rows"

NO_HEADER = "has no header"
"""The problem of a table whose first line holds numbers."""


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """The rows of a recorded file, as text.

    Attributes:
        path: the file.
        columns: the cells of each column by header, in the order of the file.
        lines: (n,) line number of each row in the file; the first line has number 1.
        about: the comments above the header, without their #.
    """

    path: Path
    columns: dict[str, list[str]]
    lines: NDArray[np.int64]
    about: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The path of the file as one printable line."""
        return shown(self.path)

    def need(self, names: Iterable[str]) -> None:
        """Raise InputError if one of the names is not a column; the message suggests the most similar column."""
        for name in names:
            if name not in self.columns:
                raise InputError(f"column {name!r} is missing", file=self.name, remedy=nearest(name, self.columns))

    def numbers(self, column: str) -> NDArray[np.float64]:
        """Return the numbers (n,) of a column; NaN where a cell is empty, NaN or infinite.

        Raises:
            InputError: a cell is not a number; the message gives its line.
        """
        cells = self.columns[column]
        try:
            if any("_" in cell for cell in cells):  # Python reads 1_5 as 15
                raise ValueError
            values = np.array([float(cell) for cell in cells])
        except ValueError:
            values = np.array([self._number(column, k) for k in range(len(cells))])
        return np.where(np.isfinite(values), values, np.nan)

    def at(self, row: int) -> str:
        """Return the location of a row as "file:line"."""
        return f"{self.name}:{self.lines[row]}"

    def _number(self, column: str, row: int) -> float:
        cell = self.columns[column][row].strip()
        if cell.lower() in _MISSING:
            return float("nan")
        try:
            if "_" in cell:
                raise ValueError
            return float(cell)
        except ValueError:
            raise InputError(
                "is not a number", file=self.at(row), key=column, value=cell, remedy=_number_remedy(cell)
            ) from None


def _number_remedy(cell: str) -> str:
    """Return a remedy for a cell that is not a number; a comma between three-digit groups is not a decimal comma."""
    plain = cell.replace(",", "")
    if _GROUPED.fullmatch(cell):
        if cell.count(",") == 1 and "." not in cell:
            point = cell.replace(",", ".")
            return f"write {plain} if the comma separates thousands, {point} if it is a decimal comma"
        return f"write {plain} without commas between thousands"
    return "write a decimal point" if "," in cell else "write a number, or leave the cell empty"


def xml_root(raw: bytes, *, file: object, remedy: str) -> ElementTree.Element:
    """Return the root of an XML file; names with the prefix of the root lose it, and others keep theirs.

    The file declares its encoding. An element of another namespace, such as `drake:joint` in URDF, is no `joint`.

    Raises:
        InputError: the file declares a document type, which may expand without bound; contains xacro macros; or is not
            XML. The message names the file and, for a file that is not XML, the remedy.

    Example:
        >>> from surctl.recorded import xml_root
        >>> xml_root(b'<gpx xmlns="http://www.topografix.com/GPX/1/1"/>', file="way.gpx", remedy="correct it").tag
        'gpx'
    """
    # expat itself, because the parser of ElementTree refuses prefixes that are not declared, as public files have them
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = builder.data, _refuse_doctype
    try:
        parser.Parse(raw, True)
        root = builder.close()
    except expat.ExpatError as error:
        problem = f"is not XML (line {error.lineno}: {expat.ErrorString(error.code)})"
        raise InputError(problem, file=shown(file), remedy=remedy) from None
    except (LookupError, ValueError) as error:  # an encoding that Python does not know, or not byte by byte
        raise InputError(f"is not XML ({error})", file=shown(file), remedy=remedy) from None
    except InputError as error:
        raise error.inside(shown(file)) from None
    own = root.tag.rpartition(":")[0]
    for element in root.iter():
        prefix, _, name = element.tag.rpartition(":")
        if prefix == "xacro":
            remedy = "expand them: xacro FILE > robot.urdf"
            raise InputError("contains xacro macros", file=shown(file), remedy=remedy)
        if prefix == own:
            element.tag = name
    return root


def _refuse_doctype(*_: object) -> None:
    raise InputError("declares a document type", remedy="remove the DOCTYPE")


def shown(path: object) -> str:
    """Return a path or name as one printable line of valid UTF-8; every other character becomes '?'.

    Example:
        >>> from surctl.recorded import shown
        >>> shown("a\\nb.csv")
        'a?b.csv'
    """
    text = str(path).encode("utf-8", "replace").decode("utf-8")
    return "".join(c if c.isprintable() else "?" for c in text)


def read_recorded(path: Path) -> Recorded:
    """Read a comma-separated file with a header; blank lines, and lines with # above the header, are skipped.

    A first line `sep=,`, as Excel reads it, is skipped too. In a file that ends in .mat or .nc, each vector is a
    column, and row k counts as line k.

    Raises:
        InputError: the file does not exist, is not UTF-8 text or has no header or no rows; or a row has a different
            number of cells than the header; or a column appears twice.

    Example:
        >>> from pathlib import Path
        >>> from surctl.recorded import read_recorded
        >>> _ = Path("log.csv").write_text("# frame=ned\\nt_s,x_m\\n0,1.5\\n0.1,1.6\\n")
        >>> log = read_recorded(Path("log.csv"))
        >>> log.columns, log.about
        ({'t_s': ['0', '0.1'], 'x_m': ['1.5', '1.6']}, ('frame=ned',))
    """
    if path.suffix.lower() in _ARRAY_FILES:
        arrays, frame = _read_arrays(path, name=shown(path))
        cells = {key: [repr(value) for value in vector.tolist()] for key, vector in arrays.items()}
        count = len(next(iter(cells.values())))
        return Recorded(path=path, columns=cells, lines=np.arange(1, count + 1), about=(frame,) if frame else ())
    about, text = _comments(_text(path))
    _check_separator(f"{shown(path)}:{len(about) + 1}", text)
    rows = _csv_rows(path, text, skipped=len(about))
    header = next(((_checked_header(f"{shown(path)}:{line}", row)) for line, row in rows), [])
    return _table(path, header, rows, named="the header has {}", remedy="correct that row", about=about)


def _csv_rows(path: Path, text: str, *, skipped: int) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of the rows that are not blank; `skipped` is the number of lines before the text."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        for row in reader:
            if any(cell.strip() for cell in row):
                yield skipped + reader.line_num, row
    except csv.Error as error:
        place = f"{shown(path)}:{skipped + reader.line_num}"
        raise InputError(f"is not CSV: {error}", file=place, remedy="correct its quotes") from None


def _table(
    path: Path, names: Sequence[str], rows: Iterable[tuple[int, list[str]]], *, named: str, remedy: str,
    about: tuple[str, ...] = (),
) -> Recorded:  # fmt: skip
    """Return the rows, each with its line number, as columns with names; `named` says where the names are."""
    numbered: dict[int, list[str]] = {}
    for line, row in rows:
        if len(row) != len(names) and len(names) > 1:
            problem = f"has {len(row)} cells, but {named.format(len(names))}"
            raise InputError(problem, file=f"{shown(path)}:{line}", remedy=remedy)
        numbered[line] = row
    if len(names) == 1 and {len(row) for row in numbered.values()} != {1}:
        raise InputError("is not a table: its first line has one cell", file=shown(path), remedy=_TABLE)
    if not numbered:
        raise InputError("has no rows", file=shown(path), remedy="add rows below the names of the columns")
    columns = dict(zip(names, map(list, zip(*numbered.values(), strict=True)), strict=True))
    return Recorded(path=path, columns=columns, lines=np.array(list(numbered)), about=about)


def read_unnamed(path: Path, columns: Sequence[str], *, skip: int = 0) -> Recorded:
    """Read a text file of numbers without a header, such as the files of towing tanks, with names for its columns.

    Cells are separated by blanks, tabs, semicolons or commas. Blank lines, and lines that begin with # or %, are
    skipped.

    Args:
        path: the file, in UTF-8 or, for the skipped lines, any other encoding.
        columns: names of the columns, from the left; all columns need a name.
        skip: lines above the numbers, such as a title.

    Raises:
        InputError: the file does not exist, has no rows, or a row has another number of cells than `columns`.

    Example:
        >>> from pathlib import Path
        >>> from surctl.recorded import read_unnamed
        >>> _ = Path("run.dat").write_text("zigzag 20/20\\n 0.00 1.5\\n 0.05\\t1.6\\n")
        >>> read_unnamed(Path("run.dat"), ["t", "x"], skip=1).columns
        {'t': ['0.00', '0.05'], 'x': ['1.5', '1.6']}
    """
    rows = (
        (number, [cell.strip() for cell in re.split(r"\s*[;,]\s*|\s+", plain)])
        for number, line in enumerate(_text(path, strict=False).split("\n"), start=1)
        if number > skip
        and (plain := line.strip())
        and plain[0] not in "#%"
        and not (number == 1 and _SEPARATOR.match(plain))
    )
    remedy = "name every column of the file, and skip the lines above the numbers with skip_lines"
    return _table(path, columns, rows, named="'columns' has {} names", remedy=remedy)


LARGEST_XML = 20_000_000
"""Largest size [bytes] of an XML or plan file that is read; the largest public URDF files have some megabytes."""


def file_bytes(path: Path, *, remedy: str = "check the path and its permissions", most: int = 0) -> bytes:
    """Return the bytes of a file; with `most`, only of a file with at most this many bytes, and of no device.

    Raises:
        InputError: the file does not exist, cannot be read, or is too large.

    Example:
        >>> from pathlib import Path
        >>> from surctl.recorded import file_bytes
        >>> _ = Path("log.csv").write_text("t_s")
        >>> file_bytes(Path("log.csv"))
        b't_s'
    """
    try:
        if most and path.exists() and not path.is_file():  # such as a device that never ends
            raise InputError("is not a file", file=shown(path), remedy=remedy)
        if most and path.stat().st_size > most:
            raise InputError(f"is larger than {most // 1_000_000} MB", file=shown(path), remedy=remedy)
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError("no such file", file=shown(path), remedy="check the path") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot be read ({reason})", file=shown(path), remedy=remedy) from None


def _text(path: Path, *, strict: bool = True) -> str:
    raw = file_bytes(path)
    try:
        text = raw.decode("utf-8-sig", "strict" if strict else "replace")
    except UnicodeDecodeError as error:
        line = len(re.findall(rb"\r\n|\r|\n", raw[: error.start])) + 1
        raise InputError("is not text (UTF-8)", file=f"{shown(path)}:{line}", remedy="save it as UTF-8") from None
    if "\0" in text:
        raise InputError("is not text (it contains a NUL byte)", file=shown(path), remedy="give a CSV file")
    if not text.strip():
        raise InputError("is empty", file=shown(path), remedy="give a CSV file with a header and rows")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _comments(text: str) -> tuple[tuple[str, ...], str]:
    """Split a text into its leading comment lines (without their #), with Excel's line `sep=,`, and the rest."""
    about: list[str] = []
    while text.startswith("#") or (not about and _SEPARATOR.match(text)):
        line, _, text = text.partition("\n")
        about.append(line.lstrip("#").strip())
    return tuple(about), text


def _check_separator(place: str, text: str) -> None:
    header = text.lstrip().partition("\n")[0]
    if all(_is_number(cell) for cell in re.split(r"\s*[;,]\s*|\s+", header.strip())):
        raise InputError(NO_HEADER, file=place, remedy="name the columns in the first line")
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if mark in header and "," not in header:
            raise InputError(
                f"is separated by {name}",
                file=place,
                remedy="save it with commas between cells and points in numbers",
            )


def _checked_header(place: str, row: list[str]) -> list[str]:
    header = [cell.strip() for cell in row]
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice:
        raise InputError(f"column {twice[0]!r} appears twice", file=place, remedy="remove one of them")
    return header


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
