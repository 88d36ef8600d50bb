"""TOML files: units, wrong keys and values; output files complete or not at all; names of files and folders."""

from __future__ import annotations

import hashlib
import json
import math
import os
import pickle
import re
import tomllib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from decimal import Decimal
from functools import cache, lru_cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Literal, Self, TypeVar, get_args, get_origin

from pydantic import (
    BaseModel,
    ConfigDict,
    StrictFloat,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from surctl.errors import InputError, cannot_write, nearest, writing
from surctl.units import converted_by_suffix, in_unit, number_and_unit

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails, InitErrorDetails

__all__ = [
    "Closeable", "Mistakes", "Quantity", "Strict", "file_name", "load_model", "opened", "pick", "prepare_folder",
    "quoted", "read_toml", "require_doubles", "validate", "write_file",
]  # fmt: skip


class Closeable(ABC):
    """Base class of files and connections that a `with` statement closes."""

    @abstractmethod
    def close(self) -> None:
        """Close the file or connection."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Strict(BaseModel):
    """Base class of the models of all files: immutable, only finite numbers, which are no booleans, no unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_boolean(cls, value: object, info: ValidationInfo) -> object:
        # pydantic reads true as the number 1
        if not _only_numbers(cls, info.field_name or ""):
            return value
        places = list(_booleans(value))
        if not places:
            return value
        kind = PydanticCustomError("number", "must be a number; write it in digits")
        wrong: list[InitErrorDetails] = [{"type": kind, "loc": place, "input": inner} for place, inner in places]
        raise ValidationError.from_exception_data(cls.__name__, wrong)


_DEEPEST = 4  # levels of lists and tables in one field


def _booleans(value: object, place: tuple[int | str, ...] = ()) -> Iterator[tuple[tuple[int | str, ...], bool]]:
    if isinstance(value, bool):
        yield place, value
    elif len(place) == _DEEPEST:
        return
    elif isinstance(value, list | tuple):
        for k, inner in enumerate(value):
            yield from _booleans(inner, (*place, k))
    elif isinstance(value, dict):
        for name, inner in value.items():
            yield from _booleans(inner, (*place, name))


@cache
def _only_numbers(model: type[BaseModel], name: str) -> bool:
    """Return whether a field accepts numbers, but neither booleans nor models, which look after their own fields."""
    field = model.model_fields.get(name)
    if field is None:
        return False
    annotation: Any = field.annotation
    parts = {annotation, *_parts(annotation)}
    if any(isinstance(part, type) and issubclass(part, BaseModel) for part in parts):
        return False
    return bool(parts & {float, int}) and not parts & {bool, object, Any}


def _parts(annotation: Any) -> Iterator[Any]:
    if get_origin(annotation) is Literal:
        return
    for inner in get_args(annotation):
        yield inner
        yield from _parts(inner)


class Quantity(Strict):
    """A number with its unit, range and provenance; a file may abbreviate it to a text such as "0.54 m"."""

    value: StrictFloat
    unit: str
    range: tuple[float, float] | None = None
    provenance: str | None = None

    @model_validator(mode="before")
    @classmethod
    def _short(cls, data: object) -> object:
        if not isinstance(data, str):
            return data
        try:
            value, unit = number_and_unit(data)
        except InputError as error:
            raise ValueError(f"{error.problem}; {error.remedy}") from None
        return {"value": value, "unit": unit}

    def within(self, unit: str) -> Quantity:
        """Return the quantity and its range converted to `unit`; the object itself if it already has this unit.

        Raises:
            InputError: the unit is unknown or has another dimension.
        """
        if self.unit == unit:
            return self
        bounds = None if self.range is None else tuple(in_unit(end, self.unit, unit) for end in self.range)
        return self.model_copy(update={"value": in_unit(self.value, self.unit, unit), "unit": unit, "range": bounds})


M = TypeVar("M", bound=BaseModel)


_LARGEST = 64 << 20  # bytes of a TOML file


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file as a table; a text like "15 cm" under a key like `depth_m` becomes a number in the key's unit.

    Raises:
        InputError: the file is missing, unreadable, empty, binary, malformed or larger than 64 MB, or a unit has the
            wrong dimension.

    Example:
        >>> from pathlib import Path
        >>> from surctl.files import read_toml
        >>> _ = Path("site.toml").write_text('[site]\\ndepth_m = "150 cm"')
        >>> read_toml(Path("site.toml"))
        {'site': {'depth_m': 1.5}}
    """
    try:
        with path.open("rb") as file:
            raw = file.read(_LARGEST + 1)  # a device such as /dev/zero has no end
    except FileNotFoundError:
        raise InputError("no such file", file=path, remedy="check the path") from None
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", file=path, remedy="check the path and its permissions"
        ) from None
    if len(raw) > _LARGEST:
        raise InputError(f"is larger than {_LARGEST >> 20} MB", file=path, remedy="give a TOML file")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError("is not text (UTF-8)", file=path, remedy="give a TOML file") from None
    if "\0" in text:
        raise InputError("is not text (it contains a NUL byte)", file=path, remedy="give a TOML file")
    try:
        return dict(pickle.loads(_parsed(text)))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"is not valid TOML: {error}", file=path, remedy="correct that line") from None
    except RecursionError:
        raise InputError("is not valid TOML: nested too deeply", file=path, remedy="give a TOML file") from None
    except InputError as error:
        raise error.inside(path) from None


@lru_cache(maxsize=64)
def _parsed(text: str) -> bytes:
    """Return the pickled table of a TOML text; results are cached, and each caller unpickles a separate copy."""
    table = tomllib.loads(text)
    if not table:
        raise InputError("is empty", remedy="start from a built-in file: surctl list --show NAME")
    return pickle.dumps(converted_by_suffix(table))


def require_doubles(path: Path) -> None:
    """Raise InputError if a number of a TOML file that was read is not the shortest decimal of a double.

    Example:
        >>> from pathlib import Path
        >>> from surctl.files import require_doubles
        >>> _ = Path("claim.toml").write_text("lower = 0.1")
        >>> require_doubles(Path("claim.toml"))  # 0.1000000000000000001 would be refused
    """
    table = tomllib.loads(path.read_bytes().decode("utf-8-sig"), parse_float=Decimal)
    waiting: list[tuple[str, object]] = [("", table)]
    while waiting:
        key, value = waiting.pop()
        if isinstance(value, dict):
            waiting += [(f"{key}.{name}".lstrip("."), part) for name, part in value.items()]
        elif isinstance(value, list):
            waiting += [(f"{key}.{k}", part) for k, part in enumerate(value)]
        elif (isinstance(value, Decimal) or type(value) is int) and not _is_double(value):
            raise InputError(
                "has digits that a double does not hold", file=path, key=key, value=str(value),
                remedy="round it, or write it inside an expression, where every number is exact",
            )  # fmt: skip


def _is_double(value: Decimal | int) -> bool:
    try:
        return not Decimal(value).is_finite() or Decimal(repr(float(value))) == value
    except (OverflowError, ValueError):
        return True  # infinite: refused with its own message


def load_model(path: Path, model: type[M]) -> M:
    """Read a TOML file and validate it against `model`.

    Example:
        >>> from pathlib import Path
        >>> from pydantic import BaseModel
        >>> from surctl.files import load_model
        >>> class Tank(BaseModel):
        ...     length_m: float
        >>> _ = Path("tank.toml").write_text('length_m = "640 cm"')
        >>> load_model(Path("tank.toml"), Tank)
        Tank(length_m=6.4)
    """
    return validate(read_toml(path), model, file=path)


_LISTED = 3  # further wrong keys that a message names
_MEMBERS = ("Quantity", "WallTable", "str")  # types in unions of the models, which pydantic puts into paths like keys


def _key_of(place: tuple[int | str, ...]) -> str | None:
    return ".".join(str(part) for part in place if part not in _MEMBERS) or None


class Mistakes:
    """Collects the mistakes in the entries of a file, so that one message names all of them.

    Example:
        >>> from surctl.errors import InputError
        >>> from surctl.files import Mistakes
        >>> mistakes = Mistakes()
        >>> for key, value in (("length_m", -1), ("width_m", 2), ("depth_m", 0)):
        ...     with mistakes.collected():
        ...         if value <= 0:
        ...             raise InputError("must be greater than 0", key=key, value=value)
        >>> mistakes.check()
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: length_m = -1: must be greater than 0 (also wrong: depth_m)
    """

    def __init__(self) -> None:
        self._mistakes: list[InputError] = []

    @contextmanager
    def collected(self) -> Iterator[None]:
        """Keep an InputError of the block for `check`."""
        try:
            yield
        except InputError as error:
            self._mistakes.append(error)

    def check(self) -> None:
        """Raise the first InputError that was collected; its text names the keys of the others.

        Raises:
            InputError: one was collected.
        """
        if self._mistakes:
            first, *others = self._mistakes
            problem = first.problem + _also_wrong([str(each.key) for each in others])
            raise InputError(problem, file=first.file, key=first.key, value=first.value, remedy=first.remedy)


def _also_wrong(keys: Sequence[str]) -> str:
    listed = ", ".join(keys[:_LISTED]) + (f" and {len(keys) - _LISTED} others" if len(keys) > _LISTED else "")
    return f" (also wrong: {listed})" if keys else ""


def validate(table: dict[str, Any], model: type[M], *, file: object) -> M:
    """Validate a table against `model`; the InputError describes the first mistake and counts the others.

    Example:
        >>> from pydantic import BaseModel
        >>> from surctl.files import validate
        >>> class Tank(BaseModel):
        ...     length_m: float
        >>> validate({"length_m": 6.4}, Tank, file="tank.toml")
        Tank(length_m=6.4)
        >>> validate({"length_m": "long"}, Tank, file="tank.toml")
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: tank.toml: length_m = 'long': input should be a valid number, ...; correct the value
    """
    try:
        return model.model_validate(table)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        texts = {p["loc"][:-1] for p in problems if p["loc"][-1:] == ("str",)}
        # for a union "quantity or text", only the problem with the quantity helps the user
        problems = [p for p in problems if p["loc"][-1:] != ("str",)]
        # pydantic also reports a list as too short when some of its members are invalid
        problems = [p for p in problems if p["type"] != "too_short" or not _inside(p["loc"], problems)]
        # a wrong kind of file explains all other problems; an unknown key explains a missing key beside it
        first = min(problems, key=lambda p: (p["loc"] != ("kind",), p["type"] != "extra_forbidden"))
        key = _key_of(first["loc"])
        # the parts of a union report the same key more than once
        others = list(dict.fromkeys(k for p in problems if (k := _key_of(p["loc"])) is not None and k != key))
        more = _also_wrong(others)
        # the message omits the value if the mistake concerns the whole file
        value = None if first["type"] == "missing" or key is None else first["input"]
        if first["type"] == "extra_forbidden":
            known = _fields_at(model, first["loc"][:-1])
            problem, remedy = "unknown key", nearest(str(first["loc"][-1]), known)
            value = None
        elif first["type"] == "model_type" and first["ctx"]["class_name"] == "Quantity":
            finite = not isinstance(value, float) or math.isfinite(value)
            problem = "must be a value with its unit" if finite else "is not a finite number"
            remedy = 'write { value = ..., unit = "..." }'
        elif first["type"] == "model_type" and first["loc"][:-1] in texts:
            problem, remedy = "must be a text or a table", 'write "NAME", or { key = "NAME" }'
        elif first["type"] in ("model_type", "dict_type"):
            problem, remedy = "must be a table", "write [name] above its keys, or { key = value }"
        elif first["type"] in ("tuple_type", "list_type"):
            problem, remedy = "must be a list", "write [ ... ] around its members"
        elif first["type"] == "missing":
            problem, remedy = "is missing", "add it"
        else:
            problem, remedy = first["msg"][0].lower() + first["msg"][1:], "correct the value"
            if ";" in problem:
                problem, _, remedy = problem.partition("; ")
        problem = problem.removeprefix("value error, ")
        raise InputError(problem + more, file=file, key=key, value=value, remedy=remedy) from None


def _inside(path: tuple[int | str, ...], problems: Sequence[ErrorDetails]) -> bool:
    return any(p["loc"][: len(path)] == path and p["loc"] != path for p in problems)


def _fields_at(model: type[BaseModel], path: tuple[int | str, ...]) -> list[str]:
    """Return the field names of the model, possibly nested, to which the path of a validation error leads."""
    here: Any = model
    for part in path:
        if isinstance(part, int):
            continue
        field = getattr(here, "model_fields", {}).get(part)
        if field is None:
            continue
        here = _model_in(field.annotation)
    return [field.alias or name for name, field in getattr(here, "model_fields", {}).items()]


def _model_in(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if get_origin(annotation) is Literal:
        return None
    for inner in get_args(annotation):
        model = _model_in(inner)
        if model is not None:
            return model
    return None


def prepare_folder(folder: Path, *, key: str = "--out", value: Path | None = None) -> Path:
    """Create the output folder; an error message names the option `key` and its `value` (default: the folder).

    Raises:
        InputError: the path is a file, is not UTF-8, or the folder cannot be written.

    Example:
        >>> from pathlib import Path
        >>> from surctl.errors import InputError
        >>> from surctl.files import prepare_folder
        >>> prepare_folder(Path("results") / "first").is_dir()
        True
        >>> _ = Path("taken").write_text("a file")
        >>> prepare_folder(Path("taken"))
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: --out = 'taken': cannot be written (File exists); name another folder
    """
    try:
        str(folder).encode()
    except UnicodeError:  # netCDF cannot write into it
        raise InputError("is not text (UTF-8)", key=key, value=str(folder), remedy="name another folder") from None
    with writing(str(value or folder), key=key, remedy="name another folder"):
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".surctl-{os.getpid()}"
        probe.write_bytes(b"")
        probe.unlink()
    return folder


def pick(name_or_path: str, library: Path, *, what: str) -> Path:
    """Return the path of the built-in file with this name, or the user's own path.

    A bare name (no suffix, no separator) is looked up in the folder `library`; any other text is a path.

    Example:
        >>> from pathlib import Path
        >>> from surctl.files import pick
        >>> from surctl.marine.vehicle import LIBRARY
        >>> pick("sur400", LIBRARY, what="vehicle").name
        'sur400.toml'
        >>> pick("sur4000", LIBRARY, what="vehicle")
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: vehicle = 'sur4000': unknown vehicle; did you mean 'sur400'?
    """
    known = {p.stem: p for p in sorted(library.glob("*.toml"))}
    if name_or_path in known:
        return known[name_or_path]
    path = Path(name_or_path)
    if path.suffix or "/" in name_or_path or "\\" in name_or_path:
        return path
    raise InputError(f"unknown {what}", key=what, value=name_or_path, remedy=nearest(name_or_path, known))


def quoted(text: str) -> str:
    """Return the text as a TOML basic string: with JSON's escapes, and with DEL escaped as well.

    Example:
        >>> from surctl.files import quoted
        >>> print(quoted('a "clear" pool'))
        "a \\"clear\\" pool"
    """
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def opened(path: Path, *, new: bool, buffering: int = -1) -> IO[bytes]:
    """Open a file of a session for writing; if it has to be `new`, refuse to overwrite one.

    Raises:
        InputError: the file cannot be written, or is there already.

    Example:
        >>> from pathlib import Path
        >>> from surctl.files import opened
        >>> with opened(Path("session.bin"), new=True) as file:
        ...     file.write(b"abc")
        3
    """
    try:
        return path.open("xb" if new else "wb", buffering=buffering)
    except FileExistsError:
        problem = "exists already: a session never overwrites another"
        raise InputError(problem, file=path, remedy="name another folder") from None
    except OSError as error:
        raise cannot_write(path, error, remedy="name another folder") from None


def file_name(name: str) -> str:
    """Return a name from a user's file or function as part of a file name, which cannot lead out of a folder.

    Other characters than ASCII letters, digits, `_`, `-` and `.` are replaced, and points at the start removed. Such a
    name gets a digest, so that file names stay different.

    Example:
        >>> from surctl.files import file_name
        >>> file_name("pool-static"), file_name("../../north pool")
        ('pool-static', 'north-pool-e834ebc2')
    """
    plain = re.sub(r"[^A-Za-z0-9_.-]", "-", name).lstrip(".-")[:100] or "x"
    return (
        plain if plain == name else f"{plain}-{hashlib.sha256(name.encode(errors='backslashreplace')).hexdigest()[:8]}"
    )


_COMMAND = re.compile(rb"....tEXtDescription\0.*?(?=IDAT)", re.DOTALL)  # in a PNG file, see `report.theme.save_figure`


def changes(folder: Path) -> Callable[[], list[str]]:
    """Return a function that returns the names of the files that are in a folder now, and have other contents then.

    The command that a picture names is no part of its contents: it can be written in several ways.
    """

    def digest(file: Path) -> str:
        data = file.read_bytes()
        # files of runs may be large, and a search takes a dozen times as long as the digest
        return hashlib.sha256(_COMMAND.sub(b"", data) if file.suffix == ".png" else data).hexdigest()

    def contents() -> dict[str, str]:
        files = (file for file in folder.iterdir() if file.is_file() and os.access(file, os.R_OK))
        return {file.name: digest(file) for file in files}

    def changed() -> list[str]:
        after = contents()
        return [name for name, content in sorted(before.items()) if after.get(name, content) != content]

    before = contents()
    return changed


def write_file(target: Path, content: str | bytes, **options: str) -> Path:
    """Write a file and return its path; if writing fails, the old file does not change.

    The function writes a temporary file and renames it at the end. `options` are arguments of `cannot_write`.

    Raises:
        InputError: the disk is full, or the folder cannot be written.

    Example:
        >>> from pathlib import Path
        >>> from surctl.files import write_file
        >>> write_file(Path("gains.toml"), 'kind = "gains"').read_text()
        'kind = "gains"'
    """
    place = target.resolve() if target.is_symlink() else target
    staging = place.with_name(f".{place.name}.{os.getpid()}.tmp")
    if place.exists() and not (place.is_file() or place.is_dir()):  # renaming over a device would remove it
        raise cannot_write(target, OSError("no regular file"), **({"remedy": "choose another name"} | options))
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with staging.open("wb") as file:
            file.write(content.encode("utf-8") if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        staging.replace(place)
    except OSError as error:
        with suppress(OSError):  # no second error if the temporary file does not exist or cannot be removed
            staging.unlink()
        raise cannot_write(target, error, **options) from None
    return target
