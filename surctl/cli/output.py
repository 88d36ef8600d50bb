"""What every command prints: a summary for people, or one JSON object on stdout; progress goes to stderr."""

from __future__ import annotations

import json
import math
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from surctl.cli.streams import is_utf8

if TYPE_CHECKING:
    from surctl.simulation import Scenario
    from surctl.vehicle import Vehicle
    from surctl.verification import Inapplicable

__all__ = [
    "Stopped",
    "as_json",
    "at_hand",
    "finish",
    "finite",
    "out_folder",
    "printable",
    "progress",
    "refusal_line",
    "same_command",
    "stoppable",
    "together",
]

C = TypeVar("C", bound=Callable[..., Any])


def together(*options: Callable[[C], C]) -> Callable[[C], C]:
    """Several options as one decorator; the help has them in this order."""

    def decorate(command: C) -> C:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


as_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
out_folder = click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder for plots.")


def finite(value: Any) -> Any:
    """The same data with every number that JSON does not know (NaN, infinities) as null."""
    if isinstance(value, Mapping):
        return {str(k): finite(v) for k, v in value.items()}
    if isinstance(value, str):
        return value
    if isinstance(value, Sequence):
        return [finite(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def printable(lines: Sequence[str]) -> list[str]:
    """The lines with what is not printed as itself (control and format characters) escaped as in JSON."""
    return [
        line if line.isprintable() else "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in line)
        for line in lines
    ]


def finish(
    result: Mapping[str, Any], lines: Sequence[str], *, as_json: bool, passed: bool, then: Sequence[str] = ()
) -> None:
    """Print the result, with the commands that one would give next, and end with status 0 if `passed`, else 1."""
    shown = [*lines, "next", *(f"  {command}" for command in then)] if then else lines
    said = {**result, "next": list(then)} if then else result
    lines = printable([json.dumps(finite(said), ensure_ascii=not is_utf8())]) if as_json else shown
    text = "\n".join(lines)
    sys.stdout.write(text + "\n")
    sys.stdout.flush()
    click.get_current_context().exit(0 if passed else 1)


class Stopped(click.Abort):
    """The user stopped the command; the message says what is kept, and how to go on."""


@contextmanager
def stoppable(message: str, lines: Sequence[str] = (), *, as_json: bool = False) -> Iterator[None]:
    """Ctrl-C inside prints the lines that there are by then, unless JSON is asked for, and becomes `Stopped`."""
    try:
        yield
    except KeyboardInterrupt:
        if lines and not as_json:
            sys.stdout.write("\n".join(lines) + "\n")
            sys.stdout.flush()
        raise Stopped(message) from None


def at_hand(scenario: Scenario, vehicle: Vehicle, gains: str) -> list[str]:
    """The options by which a next command is about the same mission, vehicle and gain file."""
    from surctl.simulation import LIBRARY as SCENARIOS
    from surctl.vehicle import LIBRARY as VEHICLES

    def word(source: str, library: Path) -> str:
        return Path(source).stem if Path(source).parent == library else source

    mission, robot = word(scenario.source, SCENARIOS) or scenario.name, word(vehicle.source, VEHICLES) or vehicle.name
    return ["--scenario", mission, "--vehicle", robot, "--gains", gains]


def refusal_line(refused: Inapplicable) -> str:
    """A claim that is not about the case at hand, in one line."""
    return f"n/a  {refused.claim:<22} {refused.sentence}"


def same_command() -> str:
    """What was typed, for a shell."""
    return shlex.join(["surctl", *sys.argv[1:]])


def progress(text: str) -> None:
    """One line of progress on stderr."""
    with suppress(OSError):  # a full disk under the log stops no computation
        sys.stderr.write(f"  {text}\n")
        sys.stderr.flush()
