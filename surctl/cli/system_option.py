"""A closed loop of the user's own, FILE.py:FUNCTION or subject:NAME, as the first argument of a command."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from surctl.system import System

__all__ = ["OwnSystem", "assigned", "command_line", "is_system", "listed_values", "load_system", "seconds_option"]

seconds_option = click.option(
    "--seconds", type=float, metavar="S", help="Duration of a run of a system [s] (default: its own)."
)

_MOST_PERIODS = 10_000_000  # of a run in Python, whose signals are in memory


@dataclass(frozen=True)
class OwnSystem:
    """A system of the user's own, and its name on the command line.

    Attributes:
        system: the closed loop.
        word: FILE.py:FUNCTION or subject:NAME as typed.
        label: the same without folder.
        settings: further words of the command line.
        sha256: SHA-256 of the text of the file.
    """

    system: System
    word: str
    label: str
    settings: tuple[str, ...]
    sha256: str

    @property
    def origin(self) -> dict[str, str]:
        """Return the version of surctl, and name and SHA-256 of the file that the system comes from."""
        from surctl import __version__

        return {"source": f"surctl {__version__}", "system": self.label, "file_sha256": self.sha256}

    @property
    def title(self) -> str:
        """Return the names of plant and controller as text."""
        return f"{self.system.plant.name} under {self.system.controller.name}"

    @property
    def names(self) -> dict[str, Any]:
        """Return the names of system, plant and controller, and the control period, for JSON."""
        system = self.system
        return {
            "system": self.label,
            "plant": system.plant.name,
            "controller": system.controller.name,
            "period_s": float(system.dt),
        }

    def seconds(self, seconds: float | None) -> float:
        """Return the duration of a run [s]: `seconds`, or that of the system.

        Raises:
            InputError: the duration is missing, or is not a valid duration.
        """
        from surctl.errors import InputError
        from surctl.system import periods

        file, key = (None, "--seconds") if seconds is not None else (self.word, "duration")
        seconds = self.system.duration if seconds is None else seconds
        if seconds is None:
            remedy = "give the duration of a run [s], or System(duration=…)"
            raise InputError("is missing", key="--seconds", remedy=remedy)
        try:
            steps = periods(self.system, seconds)
        except InputError as error:
            raise InputError(error.problem, file=file, key=key, value=seconds, remedy=error.remedy) from None
        if steps > _MOST_PERIODS:
            remedy = f"give at most {_MOST_PERIODS * self.system.dt:g} s"
            raise InputError(f"is {steps} control periods", file=file, key=key, value=seconds, remedy=remedy)
        return seconds

    def exported_name(self, name: str | None = None, *, reserved: Collection[str]) -> str:
        """Return the name of the bundle: `name`, or that of the controller.

        Raises:
            InputError: it cannot be the name of a bundle, or it is one of `reserved`.
        """
        from surctl.errors import InputError
        from surctl.export.contract import checked_name

        try:
            chosen = checked_name(self.system.controller, name)
            if chosen in reserved:
                problem, remedy = "is the name of a built-in law", "choose another name"
                raise InputError(problem, key="name", value=chosen, remedy=remedy)
        except InputError as error:
            if error.key == "name" and name:
                raise InputError(error.problem, key="--name", value=name, remedy=error.remedy) from None
            raise error.inside(self.word, "controller" if error.key == "name" else error.key) from None
        return chosen


def is_system(words: Sequence[str], *allowed: str) -> bool:
    """Return whether the words of a command begin with a system of the user's own.

    Args:
        words: positional arguments of the command.
        allowed: names of the parameters that the command takes for a system.

    Raises:
        InputError: an option of the command line applies only to a system, or only to the robot; or a word names a
            system or a Python file in a position where it is not allowed.
    """
    from surctl.errors import InputError
    from surctl.system.subjects import is_subject

    context = click.get_current_context()
    own = bool(words) and is_subject(words[0])
    for word in words[own:]:
        if is_subject(word):
            raise InputError("is not the first argument", key="system", value=word, remedy="give one system, first")
        if word.endswith(".py"):
            raise InputError("names no function", key="system", value=word, remedy=f"write {word}:FUNCTION")
    if not own:
        if context.params.get("seconds") is not None:
            remedy = "begin with FILE.py:FUNCTION, or drop it"
            raise InputError("applies only to a system", key="--seconds", remedy=remedy)
        return False
    for option in context.command.params:
        typed = context.get_parameter_source(option.name or "") != ParameterSource.DEFAULT
        if isinstance(option, click.Option) and typed and option.name not in allowed:
            raise InputError("does not apply to a system of your own", key=option.opts[0], remedy="drop it")
    return True


def load_system(words: Sequence[str]) -> OwnSystem:
    """Return the system that the first word names; what its file prints goes to stderr.

    Raises:
        InputError: the file or function does not exist, the function fails, or it does not return a system.
    """
    from surctl.system.subjects import load_subject

    subject = load_subject(words[0])
    return OwnSystem(subject.system, words[0], subject.label, tuple(words[1:]), subject.sha256)


def assigned(words: Sequence[str]) -> Mapping[str, NDArray[np.float64]]:
    """Return the numbers of words NAME=VALUE by name; commas separate the entries of a vector.

    Raises:
        InputError: as in `listed_values`.
    """
    import numpy as np

    return {name: np.array(v[0] if len(v) == 1 else [v]) for name, v in listed_values(words).items()}


def listed_values(words: Sequence[str]) -> dict[str, list[float]]:
    """Return the numbers of words NAME=V1,V2,… by name.

    Raises:
        InputError: a word does not assign a value, a value is not a number, or a name is given twice.
    """
    from surctl.errors import InputError

    values: dict[str, list[float]] = {}
    for word in words:
        name, equals, text = (part.strip() for part in word.partition("="))
        if not (name and equals):
            raise InputError("is not NAME=VALUE", value=word, key="setting", remedy="write such as plant.mass=2")
        if name in values:
            raise InputError("is given twice", key=name, remedy="give it once")
        try:
            values[name] = [float(number) for number in text.split(",")]
        except ValueError:
            raise InputError("is not a number", key=name, value=text, remedy=f"write {name}=1.5") from None
    return values


def command_line(command: str, own: OwnSystem, *words: str) -> str:
    """Return the command line that runs a command on this system."""
    return shlex.join(["surctl", command, own.word, *words])
