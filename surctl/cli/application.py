"""Applications: packages that bring commands, and options and subjects of the common commands; their registry."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cache
from inspect import cleandoc
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.errors import InputError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

APPLICATIONS = "surctl.applications"
"""Group of entry points under which a package registers an `Application`."""


@dataclass(frozen=True)
class Application:
    """What a package adds to the command line.

    Attributes:
        takes: whether words that name no system of the user's own are about this application.
        commands: its own commands, each with a description of one line.
        branches: options, help and function of common commands by name; the function gets the options of the common
            command too, and the help of the built-in application comes first.
        libraries: folders of built-in files by kind, for `surctl list`.
        listed: further names by kind, for `surctl list`.
        reserved: names that no exported controller of another origin may have.
    """

    takes: Callable[[Sequence[str]], bool]
    commands: Mapping[click.Command, str] = field(default_factory=dict)
    branches: Mapping[str, click.Command] = field(default_factory=dict)
    libraries: Callable[[], Mapping[str, Path]] = dict
    listed: Callable[[], Mapping[str, Sequence[str]]] = dict
    reserved: Callable[[], Collection[str]] = tuple


@cache
def applications() -> tuple[Application, ...]:
    """Return the applications of installed packages by name, then the built-in one, which takes all words."""
    from importlib.metadata import EntryPoint, entry_points

    built_in = EntryPoint("marine", "surctl.marine.cli:APPLICATION", APPLICATIONS)
    return tuple(map(_loaded, (*sorted(entry_points(group=APPLICATIONS)), built_in)))


def _loaded(entry: EntryPoint) -> Application:
    try:
        application = entry.load()
    except Exception as error:
        text = " ".join(f"{entry.value} fails with {type(error).__name__}: {error}".split())
        remedy = "correct or uninstall the package"
        raise InputError(text, key="application", value=entry.name, remedy=remedy) from error
    assert isinstance(application, Application), entry.value
    return application


class CommonCommand(click.Command):
    """A common command with the options of the applications; `own` are the parameters that it has without them."""

    own: Sequence[click.Parameter] = ()


def with_branches(command: click.Command) -> click.Command:
    """Return a common command with the options and the help of all applications; a command of one's own unchanged."""
    branches = [one.branches[str(command.name)] for one in applications() if command.name in one.branches]
    if not branches:
        return command
    words, *others = command.params
    helps = "\n\n".join(cleandoc(str(one.help)) for one in reversed(branches))
    both = CommonCommand(command.name, callback=command.callback, help=helps)
    shown = copy(words)
    shown.metavar = " | ".join(filter(None, (one.params[0].metavar for one in (*reversed(branches), command))))
    both.own = command.params
    both.params = [shown, *others[:-2], *(option for one in branches for option in one.params[1:]), *others[-2:]]
    return both


def to_application(words: Sequence[str]) -> Any:
    """Hand words that name no system of the user's own, with all options, to the application that takes them."""
    context = click.get_current_context()
    name = str(context.command.name)
    branch = next(one.branches[name] for one in applications() if name in one.branches and one.takes(words))
    assert branch.callback is not None
    values = branch.make_context(name, list(words), resilient_parsing=True).params | context.params
    known = {one.name for one in (*own_parameters(context.command), *branch.params)} - {"seconds"}
    return branch.callback(**{key: value for key, value in values.items() if key in known} | {"words": tuple(words)})


def own_parameters(command: click.Command) -> Sequence[click.Parameter]:
    """Return the parameters of a command without those of the applications."""
    return command.own if isinstance(command, CommonCommand) else command.params
