"""Write plain data as TOML text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from surctl.files import quoted


def key_text(name: str) -> str:
    """Return a name as a key of a TOML file, quoted if it is no bare key."""
    plain = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if plain else quoted(name)


def toml_text(table: Mapping[str, Any]) -> str:
    """Return the data as a TOML document, in which the plain values of a table come before its subtables.

    Reading the document restores the data, numbers to the last bit. None is not allowed.
    """
    return "\n".join(_lines(table, ())).strip("\n") + "\n"


def _lines(table: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    inside = {name: value for name, value in table.items() if isinstance(value, Mapping) or _tables(value)}
    lines = [f"{key_text(name)} = {_value(value)}" for name, value in table.items() if name not in inside]
    for name, value in inside.items():
        where = (*path, name)
        head = ".".join(key_text(part) for part in where)
        if isinstance(value, Mapping):
            lines += ["", f"[{head}]", *_lines(value, where)]
        else:
            for one in value:
                lines += ["", f"[[{head}]]", *_lines(one, where)]
    return lines


def _tables(value: object) -> bool:
    return isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(v, Mapping) for v in value)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return quoted(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key_text(name)} = {_value(one)}" for name, one in value.items()) + " }"
    if isinstance(value, Sequence):
        return "[" + ", ".join(_value(one) for one in value) + "]"
    return repr(int(value)) if isinstance(value, int) else repr(float(value))
