"""A system as first argument of a command: words NAME=VALUE, ranges, region box; text of its costs and margins."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli import lib
from surctl.cli.application import applications, own_parameters
from surctl.cli.options import typed
from surctl.errors import InputError, NotApplicable, check_known, mistakes_in, nearest

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray


seconds_option = click.option(
    "--seconds", type=float, metavar="S", help="Length of a run of FILE.py [s] (default: set in FILE.py)."
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

    system: lib.System
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
        file, key = (None, "--seconds") if seconds is not None else (self.word, "duration")
        seconds = self.system.duration if seconds is None else seconds
        if seconds is None:
            remedy = "give the duration of a run [s], or System(duration=…)"
            raise InputError("is missing", key="--seconds", remedy=remedy)
        with mistakes_in(file, key):
            steps = lib.periods(self.system, seconds)
        if steps > _MOST_PERIODS:
            remedy = f"give at most {_MOST_PERIODS * self.system.dt:g} s"
            raise InputError(f"is {steps:.9g} control periods", file=file, key=key, value=seconds, remedy=remedy)
        return seconds

    @property
    def costs(self) -> Mapping[str, lib.Cost]:
        """Return the costs of the system; InputError if it has none."""
        if not self.system.costs:
            raise InputError("has no costs", key="system", value=self.label, remedy="give System(..., costs={...})")
        return self.system.costs

    def default_axes(self, values: Mapping[str, object]) -> list[str]:
        """Return axes from half to twice the default of each gain without a value in `values`; none without costs."""
        ports = self.system.controller.gains if self.system.costs else ()
        free = [port for port in ports if port.size == 1 and port.default > 0 and port.name not in values]
        return [f"{port.name}={port.default / 2:.4g}..{port.default * 2:.4g}:9" for port in free]

    def exported_name(self, name: str | None = None) -> str:
        """Return the name of the bundle: `name`, or that of the controller.

        Raises:
            InputError: it cannot be the name of a bundle, or it is that of a built-in law.
        """
        try:
            chosen = lib.checked_name(self.system.controller, name)
            if any(chosen in one.reserved() for one in applications()):
                problem, remedy = "is the name of a built-in law", "choose another name"
                raise InputError(problem, key="name", value=chosen, remedy=remedy)
        except InputError as error:
            if error.key == "name" and name is not None:
                raise InputError(error.problem, key="--name", value=name, remedy=error.remedy) from None
            raise error.inside(self.word, "controller" if error.key == "name" else error.key) from None
        return chosen

    def command(self, name: str, *words: str) -> str:
        """Return the command line that runs a command on this system."""
        return shlex.join(["surctl", name, self.word, *words])

    def end_text(self, record: lib.Record) -> str:
        """Return one line with the system, and when and why the run ended."""
        why = f"{record.stopped}: {record.lost}" if record.lost else record.stopped
        return f"{self.system.title}: ended after {record.duration:.10g} s ({why}), control period {self.system.dt:g} s"

    def cost_lines(self, figures: Mapping[str, float], *, without: Collection[str] = ()) -> list[str]:
        """Return one line for each cost, `without` some of them: name, value with unit, and what it means."""
        width = max(map(len, figures), default=0)
        if figures and all(map(math.isnan, figures.values())):
            return ["  no costs: a run that ends at its start, or is not finite, has none"]
        lines = []
        for (name, value), cost in zip(figures.items(), self.system.costs.values(), strict=True):
            unit, meaning = "" if cost.unit == "1" else f" {cost.unit}", f"  {cost.meaning}" if cost.meaning else ""
            lines += [] if name in without else [f"  {name:<{width}}  {value:.6g}{unit} ({cost.how}){meaning}"]
        return lines

    def cost_data(self, figures: Mapping[str, float]) -> dict[str, Any]:
        """Return the costs with unit, kind and meaning, for JSON."""
        return {
            name: {"value": figures[name], "unit": cost.unit, "how": cost.how, "meaning": cost.meaning}
            for name, cost in self.system.costs.items()
        }

    def loop_lines(self, loop: lib.LoopCorners) -> list[str]:
        """Return lines of text: equilibrium, slowest mode, margins of each loop alone and of all loops at once."""
        nominal, period = loop.nominal, self.system.dt
        lines = [f"{self.system.title}, linearised about its equilibrium (references, disturbances as at t = 0):"]
        lines += [
            f"  {kind} {label} = {value:.6g} {unit}"
            for kind, rows in self.resting(loop).items()
            for label, value, unit in rows
        ]
        lines.append(f"sampled every {period:g} s: {nominal.linear.stability}, {len(nominal.poles)} poles")
        lines.append(f"  slowest mode: {mode_text(nominal)}")
        return [*lines, *loop.lines()]

    def loop_data(self, loop: lib.LoopCorners) -> dict[str, Any]:
        """Return equilibrium, poles and margins as plain data for JSON."""
        nominal, rest = loop.nominal, self.resting(loop)
        return {
            "equilibrium": {kind: {label: value for label, value, _ in rows} for kind, rows in rest.items()},
            "units": {kind: {label: unit for label, _, unit in rows} for kind, rows in rest.items()},
            **nominal.to_dict(),
            "marginal": list(nominal.linear.marginal),
            "slowest_mode": _slowest(nominal),
            "margins": [margin.to_dict() for margin in nominal.margins],
            "worst": loop.to_dict()["worst"],
        }

    def resting(self, loop: lib.LoopCorners) -> dict[str, list[tuple[str, float, str]]]:
        """Return (label, value, unit) of every number at the equilibrium of the loop, by kind."""
        assert isinstance(loop.nominal.linear, lib.Linearisation)
        at = loop.nominal.linear.at

        def rows(layout: lib.Layout, numbers: Sequence[float]) -> list[tuple[str, float, str]]:
            values = [float(number) + 0.0 for number in numbers]
            return list(zip(lib.entry_labels(layout), values, lib.entry_units(layout), strict=True))

        return {
            "state": rows(self.system.plant.state, at.x.tolist()),
            "controller state": rows(self.system.controller.state, at.z.tolist()),
            "command": rows(self.system.commands, at.f.tolist()),
        }

    def gain_ranges(self, ranges: Mapping[str, tuple[float, float] | None]) -> dict[str, tuple[float, float]]:
        """Return the search ranges of the named gains, or of all; default: a quarter to 4 times the nominal value."""
        gains, result = self.system.controller.gains, {}
        nominal = dict(zip(lib.entry_labels(gains), gains.pack().tolist(), strict=True))
        for name, ends in (ranges or dict.fromkeys(nominal)).items():
            check_known(name, nominal, "is not a gain of the system", key="--gain")
            result[name] = lib.default_range(name, nominal[name]) if ends is None else ends
        return result


def is_system(words: Sequence[str]) -> bool:
    """Return whether the words of a common command begin with a system of the user's own.

    Raises:
        InputError: an option of the command line applies only to a system, or only to an application; or a word names a
            system or a Python file in a position where it is not allowed.
    """
    context = click.get_current_context()
    own = bool(words) and lib.is_subject(words[0])
    for word in words[own:]:
        if lib.is_subject(word):
            raise InputError("is not the first argument", key="system", value=word, remedy="give one system, first")
        if word.endswith(".py"):
            raise InputError("names no function", key="system", value=word, remedy=f"write {word}:{_builder(word)}")
    if not own:
        if context.params.get("seconds") is not None:
            remedy = "begin with FILE.py:FUNCTION, or drop it"
            raise InputError("applies only to a system", key="--seconds", remedy=remedy)
        return False
    refuse_others("a system of your own")
    return True


_STARTS_FROM = "a search starts from the gains that FILE.py states as defaults: write the tuned ones there, and drop it"
_SEEDS = "for many random runs, give surctl sweep the word FILE.py:FUNCTION and --seeds N"
_INSTEAD = {"--gains": _STARTS_FROM, "--monte-carlo": _SEEDS, "--runs": _SEEDS}


def refuse_others(what: str) -> None:
    """Raise InputError if an option of an application is given, which does not apply to `what`."""
    own = own_parameters(click.get_current_context().command)
    for option in typed("gains"):  # a table of gains replaces gains of a system, too
        if isinstance(option, click.Option) and option not in own:
            remedy = _INSTEAD.get(option.opts[0], "drop it")
            raise InputError(f"does not apply to {what}", key=option.opts[0], remedy=remedy)


def load_system(words: Sequence[str]) -> OwnSystem:
    """Return the system that the first word names; what its file prints goes to stderr.

    The gains of a table `--gains`, which `surctl tune` writes, become words NAME=VALUE before the typed ones.

    Raises:
        InputError: the file or function does not exist, the function fails, or it does not return a system; the table
            has other columns than gains, or more than one row.
    """
    subject, typed = lib.load_subject(words[0]), words[1:]
    file = click.get_current_context().params.get("gains")
    known = {} if file is None else _tabled_gains(file, subject.system)
    named = {word.partition("=")[0].strip() for word in typed}
    settings = (*(f"{name}={value!r}" for name, value in known.items() if name not in named), *typed)
    return OwnSystem(subject.system, words[0], subject.label, settings, subject.sha256)


def _tabled_gains(file: str, system: lib.System) -> dict[str, float]:
    table = lib.read_recorded(Path(file))
    for name in table.columns:
        check_known(
            name, lib.entry_labels(system.controller.gains), "is not a gain of the system", key="column", file=file
        )
    if len(table.lines) != 1:
        remedy = "give the file gains.csv of surctl tune"
        raise InputError(f"has {len(table.lines)} rows of gains", file=file, remedy=remedy)
    known = {name: float(table.numbers(name)[0]) for name in table.columns}
    for name, value in known.items():
        if not math.isfinite(value):
            raise InputError("is not finite", file=file, key=name, value=value, remedy="give a finite number")
    return known


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


def _slowest(loop: lib.SampledLoop) -> dict[str, Any]:
    """Return magnitude, time constant [s] (negative if unstable) and angular frequency [rad/s] of the slowest pole."""
    pole, dt = complex(loop.poles[0]), loop.linear.dt
    size = abs(pole)
    rate = 0.0 if abs(size - 1.0) <= lib.EDGE else math.log(size) / dt if size > 0.0 else -math.inf
    return {
        "pole": [pole.real, pole.imag],
        "size": size,
        "time_constant_s": -1.0 / rate if rate else math.inf,
        "frequency_rad_per_s": abs(math.atan2(pole.imag, pole.real)) / dt,
    }


def mode_text(loop: lib.SampledLoop) -> str:
    """Return what the slowest mode does, as text."""
    mode = _slowest(loop)
    constant, frequency = mode["time_constant_s"], mode["frequency_rad_per_s"]
    change = f"{'decays' if constant >= 0 else 'grows'} with time constant {abs(constant):.4g} s"
    beat = f", oscillates at {frequency:.4g} rad/s" if frequency > 0 else ""
    return f"|z| = {mode['size']:.6g}, {'does not decay' if math.isinf(constant) else change}{beat}"


_WITHIN, _CLAIM, _ABOUT = "within.", "lyapunov.", ("function", "level", "rate")


@dataclass(frozen=True)
class RegionWords:
    """What the words of the command line say about a region of attraction.

    Attributes:
        within: lower and upper bound of each state.
        ranges: lower and upper bound of uncertain numbers.
        claim: texts of `function`, `level` and `rate`.
    """

    within: Mapping[str, tuple[float, float]]
    ranges: Mapping[str, tuple[float, float]]
    claim: Mapping[str, str]

    def problem(self, system: lib.System, values: Mapping[str, ArrayLike]) -> lib.Problem | NotApplicable:
        """Return the problem of finding and proving a region of attraction of the system, or why it has none.

        Raises:
            InputError: see `sampled_dynamics`; or the function, the level or the rate is not valid.
        """
        try:
            dynamics = lib.sampled_dynamics(system, self.within, values=values, ranges=self.ranges)
            lib.require_common(dynamics)
        except NotApplicable as reason:
            return reason
        texts = {key: self.claim[key] for key in ("level", "rate") if key in self.claim}
        numbers = {key: _finite_number(text, f"{_CLAIM}{key}") for key, text in texts.items()}
        for key in (key for key, value in numbers.items() if value <= 0):
            raise InputError("is not positive", key=f"{_CLAIM}{key}", value=texts[key], remedy="give a positive number")
        function = None
        if "function" in self.claim:
            known = {name: lib.variable(name) for name in dynamics.names}
            function = lib.parse(self.claim["function"], known, key=f"{_CLAIM}function")
        elif "level" in numbers:
            raise InputError("is given without a function", key=f"{_CLAIM}level", remedy="give lyapunov.function too")
        return lib.Problem(dynamics, "lyapunov", function, numbers.get("level"), numbers.get("rate"))


def region_words(
    words: Sequence[str], system: lib.System
) -> tuple[list[str], RegionWords | None, dict[str, tuple[float, float]]]:
    """Separate the words about a region of attraction and the ranges from the others.

    The box is that of the system; words `within.STATE` replace its range of that state, and hold the state constant if
    both ends are equal. Without box and words, no region is asked for (None).

    Raises:
        InputError: a range is not LOW..HIGH, a name is given twice, or a claim is stated without `within.STATE`.
    """
    others: list[str] = []
    within: dict[str, tuple[float, float]] = {}
    ranges: dict[str, tuple[float, float]] = {}
    claim: dict[str, str] = {}
    known = set[str]()
    for word in words:
        name, _, text = (part.strip() for part in word.partition("="))
        if name.startswith(_CLAIM):
            key = name.removeprefix(_CLAIM)
            if key not in _ABOUT:
                raise InputError("is not known", key=name, remedy=nearest(key, _ABOUT))
            claim[key] = text
        elif name.startswith(_WITHIN) or ".." in text:
            table = within if name.startswith(_WITHIN) else ranges
            table[name.removeprefix(_WITHIN)] = _range(text, name)
        else:
            others.append(word)
            continue
        if name in known:
            raise InputError("is given twice", key=name, remedy="give it once")
        known.add(name)
    within = {**system.within, **within}
    if not within:
        if claim:
            key = f"{_CLAIM}{next(iter(claim))}"
            remedy = "add within.STATE=LOW..HIGH for every state"
            raise InputError("asks for a region of attraction, whose box is missing", key=key, remedy=remedy)
        return others, None, ranges
    return others, RegionWords(within, ranges, claim), ranges


def _range(text: str, name: str) -> tuple[float, float]:
    low, dots, high = text.partition("..")
    if not dots:
        raise InputError("is not a range", key=name, value=text, remedy=f"write {name}=-1..1")
    return _finite_number(low, name), _finite_number(high, name)


def _finite_number(text: str, name: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not math.isfinite(value):
        raise InputError("is not a number", key=name, value=text, remedy="write such as 1.5")
    return value


def _builder(word: str) -> str:
    """Return `build` if the file has a function of this name, its only function, or FUNCTION; the file is not run."""
    with suppress(OSError, ValueError):
        names = re.findall(r"^def ([^\W_]\w*)\(", Path(word).read_text(encoding="utf-8"), re.MULTILINE)
        return "build" if "build" in names else names[0] if len(names) == 1 else "FUNCTION"
    return "FUNCTION"
