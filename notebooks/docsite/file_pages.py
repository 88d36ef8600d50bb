"""The reference of the file formats: key, values, default, unit and meaning, from the models that read the files."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from file_kinds import FILES, FileKind
from file_meanings import MEANINGS
from page import Page, table
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from surctl.files import Quantity
from surctl.marine.control import GAINS
from surctl.marine.simulation import METRICS
from surctl.marine.vehicle import PARAMETERS, TERMS
from surctl.marine.verification import LINEAR_METRICS
from surctl.tuning import LOOP_GOAL_KEYS

_SHOWN = {"source": "from", "end": "to"}

__all__ = ["pages", "undocumented"]

FOLDER = "reference/files"
_UNITS = (
    ("_rad_per_s", "rad/s"), ("_deg_per_s", "deg/s"), ("_m_per_s", "m/s"), ("_per_s", "1/s"), ("_per_m", "1/m"),
    ("_deg", "deg"), ("_rad", "rad"), ("_s", "s"), ("_m", "m"), ("_n", "N"), ("_N", "N"), ("_c", "°C"),
)  # fmt: skip


def pages() -> list[Page]:
    """Return a page for each kind of file, after a page with all of them."""
    rows = [(f"[{kind.title}]({name}.md)", f'`kind = "{kind.kind}"`', kind.purpose) for name, kind in FILES.items()]
    text = _HEAD + table(("file", "first line", "contains"), rows) + _UNITS_TEXT
    made = [Page(f"{FOLDER}/{name}.md", kind.title, _page(name, kind)) for name, kind in FILES.items()]
    return [Page(f"{FOLDER}/index.md", "Files", text, index=True), *made]


_HEAD = """# Files

All input files are TOML. `surctl new KIND NAME` writes a commented file to start from, `surctl lint FILE` names what
cannot work, and `surctl list --show NAME` prints a built-in file. A mistake is one line with file, key, value and
remedy. Unknown keys are mistakes.

"""

_UNITS_TEXT = """

## Numbers with units
A key with a unit in its name (`depth_m`, `cruise_m_per_s`, `beam_deg`) takes a number in this unit, or a text with
another unit: `depth_m = "150 cm"`. A **quantity** is a text such as `"0.54 m"`, or a table:

```toml
m11 = { value = 16.9, unit = "kg", range = [10.5, 21.2], provenance = "weighed; added mass of a sphere" }
```

`range` holds the lowest and the highest possible value, and `provenance` the source of the number. Former names of keys
work for one release, with a line that names the new one.
"""


def _page(name: str, kind: FileKind) -> str:
    parts = [f"# {kind.title}", kind.text]
    parts += _tables(kind.model, ())
    parts += [_extra(name)]
    return "\n\n".join(part for part in parts if part)


def _tables(model: type[BaseModel], path: tuple[str, ...], *, many: bool = False) -> Iterator[str]:
    """Yield the heading and the table of a model, then those of the tables in it."""
    if path:
        header = f"[[{'.'.join(path)}]]" if many else f"[{'.'.join(path)}]"
        yield f"## `{header}`"
        if text := _first(model):
            yield text
    rows: list[tuple[str, ...]] = []
    below: list[tuple[type[BaseModel], tuple[str, ...], bool]] = []
    first = ("kind", "name", "title", "note", "provenance")
    for key, field in sorted(model.model_fields.items(), key=lambda entry: entry[0] not in first):
        shown = field.alias or key
        inner, several = _inner(field.annotation)
        if inner is not None:
            below.append((inner, (*path, shown), several))
        default = "required" if field.is_required() else _value(field.default)
        rows.append((f"`{shown}`", _kind(field), default, _unit(shown), _meaning(model, key)))
    yield table(("key", "value", "default", "unit", "meaning"), rows)
    for inner, where, several in below:
        yield from _tables(inner, where, many=several)


def _inner(annotation: Any) -> tuple[type[BaseModel] | None, bool]:
    """Return the model of a nested table, and whether the file may have several of them."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return (None, False) if annotation is Quantity else (annotation, False)
    if origin in (Union, UnionType):
        found = [_inner(each) for each in arguments if each is not NoneType]
        return next((each for each in found if each[0] is not None), (None, False))
    if origin in (tuple, list):
        return _inner(arguments[0])[0], True
    if origin is dict:
        return _inner(arguments[1])[0], False
    return None, False


def _kind(field: Any) -> str:
    return _values(field.annotation) + _bounds(field.metadata)


def _values(annotation: Any) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _values(arguments[0]) + _bounds(arguments[1:])
    if origin is Literal:
        return ", ".join(f'`"{value}"`' for value in arguments)
    if origin in (Union, UnionType):
        return " or ".join(_values(each) for each in arguments if each is not NoneType)
    if origin in (tuple, list):
        inner = [each for each in arguments if each is not Ellipsis]
        if _inner(inner[0])[0] is not None:
            return "tables"
        fixed = Ellipsis not in arguments and origin is tuple
        if fixed:
            return f"list of {len(inner)} numbers"
        return "list of " + _plural(_values(inner[0]))
    if origin is dict:
        return "table: name = " + _values(arguments[1])
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "quantity" if annotation is Quantity else "table"
    return {float: "number", int: "integer", bool: "`true`, `false`", str: "text"}.get(annotation, "table")


def _plural(kind: str) -> str:
    if kind.endswith("s"):
        return kind.replace("list", "lists", 1)
    return re.sub(r"\b(number|text|integer)\b", r"\1s", kind)


def _bounds(metadata: Any) -> str:
    signs = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
    found: list[str] = []
    for entry in metadata:
        for inner in getattr(entry, "metadata", [entry]):
            limits = {sign: getattr(inner, name, None) for name, sign in signs.items()}
            found += [f"{sign} {limit:g}" for sign, limit in limits.items() if limit is not None]
    return f" {' and '.join(found)}" if found else ""


def _value(default: Any) -> str:
    if default is None or default is PydanticUndefined or isinstance(default, BaseModel) or default in ((), "", {}):
        return "–"
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    return f"`{list(default)}`" if isinstance(default, tuple) else f"`{default}`"


def _unit(key: str) -> str:
    return next((unit for ending, unit in _UNITS if key.endswith(ending)), "")


def _first(model: type[BaseModel]) -> str:
    said = (model.__doc__ or "").split("Attributes:")[0].strip()
    if model.__doc__ == BaseModel.__doc__:
        return ""
    return "\n\n".join(" ".join(part.split()) for part in said.split("\n\n"))


def _attributes(model: type[BaseModel]) -> Mapping[str, str]:
    """Return what the docstrings of a model and its bases say of each key."""
    found: dict[str, str] = {}
    for each in reversed(model.__mro__):
        said = (each.__doc__ or "").partition("Attributes:")[2]
        for names, text in re.findall(r"^ {8}([\w, ]+): (.*?)(?=^ {8}\S|\Z)", said + "\n", re.MULTILINE | re.DOTALL):
            found.update(dict.fromkeys(re.split(r", ?", names), " ".join(text.split())))
    return found


def _meaning(model: type[BaseModel], key: str) -> str:
    own = next((MEANINGS[each.__name__][key] for each in model.__mro__ if key in MEANINGS.get(each.__name__, {})), "")
    return own or _attributes(model).get(key, "")


def undocumented() -> list[str]:
    """Return the keys without a meaning, as `Model.key`."""
    missing: list[str] = []
    waiting = [kind.model for kind in FILES.values()]
    while waiting:
        model = waiting.pop()
        for key, field in model.model_fields.items():
            if not _meaning(model, key):
                missing.append(f"{model.__name__}.{key}")
            inner = _inner(field.annotation)[0]
            if inner is not None:
                waiting.append(inner)
    return sorted(set(missing))


def _extra(name: str) -> str:
    """Return the lists that belong to a file beyond its keys: parameters, gains, metrics."""
    if name == "vehicle":
        rows = [(f"`{key}`", f"`[{s.table}]`", s.unit, _number(s.default), s.meaning) for key, s in PARAMETERS.items()]
        head = ("parameter", "table", "unit", "default", "meaning")
        terms = [(f"`{key}`", f"`[{s.table}]`", s.unit, s.meaning) for key, s in TERMS.items()]
        return (
            f"## Parameters\n\n{table(head, rows)}\n\n## Optional terms\n\nThey extend equation (3) to "
            f"[coupled craft](../../add-a-vehicle.md#coupled-craft), and to roll and pitch.\n\n"
            f"{table(('term', 'table', 'unit', 'meaning'), terms)}"
        )
    if name == "gains":
        rows = [(f"`{key}`", s.unit, _number(s.default), s.meaning) for key, s in GAINS.items() if not s.from_vehicle]
        return f"## Gains\n\n{table(('gain', 'unit', 'default', 'meaning'), rows)}"
    if name == "goals":
        runs = [_metric(key, spec) for key, spec in METRICS.items()]
        loop = [_metric(key, spec) for key, spec in LINEAR_METRICS.items()]
        head = ("metric", "unit", "better if", "meaning")
        types = [(f"`{name}`", _keys(keys)) for name, keys in LOOP_GOAL_KEYS.items()]
        kinds = table(("type", "keys beside name, kind and points"), types)
        sections = {
            "Goals about the loop": kinds,
            "Metrics of a run": table(head, runs),
            "Metrics of the linear loop": table(head, loop),
        }
        return "\n\n".join(f"## {title}\n\n{text}" for title, text in sections.items())
    return ""


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:g}"


def _metric(key: str, spec: Any) -> tuple[str, ...]:
    return f"`{key}`", spec.unit, {"low": "small", "high": "large"}.get(str(spec.better), "–"), spec.meaning


def _keys(names: frozenset[str]) -> str:
    return ", ".join(f"`{key}`" for key in sorted(_SHOWN.get(name, name) for name in names))
