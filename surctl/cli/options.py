"""Options of commands as fields of dataclasses, and their types: counts, finite numbers, files, folders."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import field, fields
from functools import wraps
from pathlib import Path
from types import MappingProxyType
from typing import Any

import click
from click.core import ParameterSource

from surctl.errors import InputError

_OPTION = "surctl.option"  # key of a field's metadata: the name of its option, and arguments of `click.option`


def option(name: str, help: str, default: Any = None, **kind: Any) -> Any:
    """Return a field of a dataclass of options, for `options`.

    The dataclass should have neither comparison nor text (`eq`, `repr`) without need: they take time at each start.

    Args:
        name: the option, such as "--gains".
        help: its text in the help.
        default: its value if it is not given; False makes it a flag, and a tuple permits it several times.
        kind: further arguments of `click.option`, such as `metavar`.
    """
    kind |= {"help": help, "multiple": isinstance(default, tuple)}
    kind |= {"is_flag": True} if default is False else {} if default is None else {"default": default}
    return field(default=default, metadata={_OPTION: (name, kind)})


def options(
    *, only: Mapping[str, Collection[str]] = MappingProxyType({}), **kinds: type[Any]
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator that adds the options of dataclasses to a command, which receives objects of these classes.

    The help lists the options in the order of the fields; see `collected` for the objects. Of a class in `only`, these
    fields alone are options.
    """
    chosen = [
        one
        for name, kind in kinds.items()
        for one in fields(kind)
        if _OPTION in one.metadata and one.name in only.get(name, (one.name,))
    ]

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        command = collected(**kinds)(command)
        for one in reversed(chosen):
            name, kind = one.metadata[_OPTION]
            command = click.option(name, one.name, **kind)(command)
        return command

    return decorate


def collected(**kinds: type[Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator of a command that receives its options as objects of dataclasses, by the names in `kinds`.

    A field of a dataclass takes the parameter of the same name; without one, it has its default.
    """
    used = {one.name for kind in kinds.values() for one in fields(kind)}

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def call(**values: Any) -> Any:
            groups = {
                name: kind(**{one.name: values[one.name] for one in fields(kind) if one.name in values})
                for name, kind in kinds.items()
            }
            return command(**{name: value for name, value in values.items() if name not in used}, **groups)

        return call

    return decorate


def changed(group: Any) -> dict[str, Any]:
    """Return the options of an object of such a dataclass that have another value than their default, by their name."""
    known = {one.metadata[_OPTION][0]: one for one in fields(group) if _OPTION in one.metadata}
    return {name: value for name, one in known.items() if (value := getattr(group, one.name)) != one.default}


def typed(*others: str) -> list[click.Parameter]:
    """Return the parameters of the present command that the user gave, without those of the output and the others."""
    context = click.get_current_context()
    return [
        one
        for one in context.command.params
        if one.expose_value
        and one.name not in ("as_json", *others)
        and context.get_parameter_source(str(one.name)) != ParameterSource.DEFAULT
    ]


class FiniteRange(click.FloatRange):
    """A finite number in a range (NaN passes every comparison of `click.FloatRange`)."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number; fail if it is NaN or infinite."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return number


class Count(click.IntRange):
    """A whole number in a range."""

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        """Return the word for the number in the help."""
        return "N"


class _PathTo(click.Path):
    def __init__(self, metavar: str) -> None:
        super().__init__(path_type=Path)
        self.metavar = metavar

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        return self.metavar

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":  # of a variable of the shell that is not set; Path("") is the working folder
            key, remedy = param.opts[0] if param else None, "name a file or folder, or write . for the working folder"
            raise InputError("is empty", key=key, value=value, remedy=remedy)
        return super().convert(value, param, ctx)


FOLDER, FILE = _PathTo("DIR"), _PathTo("FILE")
out_folder = click.option("--out", type=FOLDER, help="Folder for plots and files (default: no files).")
