"""Gain files: name, unit, meaning, range and default of each gain; reading, checks and writing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from surctl.errors import InputError, mistakes_in, nearest
from surctl.files import Mistakes, Quantity, Strict, load_model, pick, quoted
from surctl.units import is_number

LIBRARY = Path(__file__).parent / "library"


@dataclass(frozen=True)
class GainSpec:
    """Unit and meaning of a gain, and its bounds.

    If `zero_allowed` is False, the gain must be greater than 0; a default of 0, or a range that begins at 0, sets it.
    A gain file may omit a gain that has a `default`. `range` is the range in which sweeps and tuning vary the gain,
    unless the gain file states another range. A number with `from_vehicle` is no gain: it follows from vehicle and
    cruise speed (`law_parameters`), so no file states it.
    """

    unit: str
    meaning: str
    zero_allowed: bool = False
    below: float = float("inf")
    default: float | None = None
    range: tuple[float, float] | None = None
    from_vehicle: bool = False

    def __post_init__(self) -> None:
        """Allow 0 if the default is 0, or the range begins there."""
        low = self.range[0] if isinstance(self.range, tuple | list) and self.range else None
        if 0 in (self.default, low):
            object.__setattr__(self, "zero_allowed", True)

    def check_default(self, key: str) -> None:
        """Raise InputError unless the gain has a default within its bounds, and a range that contains the default."""
        if self.default is None:
            raise InputError("has no default", key=key, remedy="give default=…, the value where no gain file says one")
        bounds: object = self.range
        if bounds is not None and not (isinstance(bounds, tuple | list) and len(bounds) == 2):
            raise InputError("is not a range", key=f"{key}.range", value=self.range, remedy="write (low, high)")
        for value in (self.default, *(self.range or ())):
            if not is_number(value):
                raise InputError("is not a number", key=key, value=value, remedy=f"give a number in {self.unit}")
            _check_value(key, float(value), None, {key: self})
        if self.range is not None and self.range[0] > self.range[1]:
            raise InputError("is a reversed range", key=f"{key}.range", value=self.range, remedy="write (low, high)")
        if self.range is not None and not self.range[0] <= self.default <= self.range[1]:
            raise InputError("is outside its range", key=key, value=self.default, remedy="widen the range")


GAINS: Mapping[str, GainSpec] = {
    "k1": GainSpec("1/s", "along-track gain of (12)"),
    "k2": GainSpec("1/s", "depth gain of (12)"),
    "lookahead": GainSpec("m", "look-ahead distance Delta_h of the LOS law"),
    "ilos_sigma": GainSpec("m/s", "integral gain sigma of guidance ilos", default=0.05),
    "alos_gamma": GainSpec("1/m^2", "adaptation gain gamma of guidance alos", default=0.4),
    "wait": GainSpec("m", "distance behind the path's target point at which the target stops"),
    "patience": GainSpec("s", "time without progress that counts as a dead end; 0 for never", True, default=60.0),
    "k_psi": GainSpec("1/s", "heading gain"),
    "spin": GainSpec("rad/s", "yaw rate at which a law with sonars turns to scan", zero_allowed=True),
    "k_v": GainSpec("1/s", "bandwidth of the velocity loops in surge, sway and heave"),
    "k_r": GainSpec("1/s", "bandwidth of the yaw-rate loop"),
    "k_i": GainSpec("1/s^2", "integral gain of the velocity loops; 0 for none", zero_allowed=True),
    "margin": GainSpec("m", "stand-off distance d_s to be kept from every contact"),
    "reaction": GainSpec("s", "reaction time in the braking distance: lag, sampling and velocity loop"),
    "brake": GainSpec("1", "share of the thrust that the braking distance assumes", below=1.0),
    "kappa": GainSpec("1/s", "gain of the sensor sub-tasks and of the corrected avoidance form"),
    "k3": GainSpec("1", "convergence coefficient of (20)"),
    "delta": GainSpec("m", "offset delta of (20); a positive value allows closer approach (E11)", zero_allowed=True),
    "lambda1": GainSpec("1", "gate width of (5) in standard deviations; 0 always uses the mean", zero_allowed=True),
    "lms_step": GainSpec("1", "share of the optimal LMS step", below=1.0),
    "beta_max": GainSpec("1", "largest historical-memory factor of (6)", zero_allowed=True, below=0.5),
}


class _GainFile(Strict):
    kind: Literal["gains"]
    name: str = Field(min_length=1)
    note: str = ""
    provenance: str = Field(min_length=1)
    gains: dict[str, Quantity]


@dataclass(frozen=True)
class Gains:
    """A complete set of gains in SI units, with a name: the values of the gains, and the ranges from the gain file.

    `own` describes the gains of a law that are not in `GAINS`; `specs` describes all gains of the set.
    """

    name: str
    values: Mapping[str, float]
    provenance: str
    source: str = ""
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    own: Mapping[str, GainSpec] = field(default_factory=dict)

    @property
    def specs(self) -> Mapping[str, GainSpec]:
        """Return unit, meaning and bounds of every gain of the set."""
        return {**GAINS, **_chosen(self.own)} if self.own else GAINS

    def __getitem__(self, name: str) -> float:
        """Return the value of a gain; an unknown name raises InputError and the message suggests a similar name."""
        _check_name(name, self.source, self.specs)
        return self.values[name]

    def with_own(self, own: Mapping[str, GainSpec]) -> Gains:
        """Return this set extended by the gains `own` of a law; a gain that the set lacks gets its default value."""
        if self.own == own:
            return self
        shared = {name: value for name, value in self.values.items() if name in GAINS}
        chosen = _chosen(own)
        values = {name: self.values.get(name, spec.default or 0.0) for name, spec in chosen.items()}
        ranges = {name: spec.range for name, spec in chosen.items() if spec.range is not None}
        stated = {name: bounds for name, bounds in self.ranges.items() if name in GAINS or name in chosen}
        return replace(self, values=shared | values, ranges=ranges | stated, own=own)

    def with_values(
        self, values: Mapping[str, float], *, provenance: str | None = None, how: str | None = None
    ) -> Gains:
        """Return a copy with new, checked values of some gains; `how` is appended to the name of the gain set."""
        for name, value in values.items():
            _check_name(name, self.source, self.specs)
            _check_value(name, float(value), self.source, self.specs)
        merged = {**self.values, **{k: float(v) for k, v in values.items()}}
        name = self.name if how is None else f"{self.name.removesuffix(f'-{how}')}-{how}"
        return replace(self, name=name, values=merged, provenance=provenance or self.provenance)


def setting(name: str, value: float) -> str:
    """Return the line of a gain file that sets a gain, to quote in a text."""
    return f'{name} = "{value:g} {GAINS[name].unit}"'


def _chosen(own: Mapping[str, GainSpec]) -> Mapping[str, GainSpec]:
    return {name: spec for name, spec in own.items() if not spec.from_vehicle}


def _check_name(name: str, source: object, specs: Mapping[str, GainSpec]) -> None:
    """Raise InputError if `name` is not a gain; the message suggests a similar known name."""
    if name not in specs:
        raise InputError("no such gain", file=source or None, key=f"gains.{name}", remedy=nearest(name, specs))


def _check_value(name: str, value: float, source: object, specs: Mapping[str, GainSpec]) -> None:
    """Raise InputError if the value of a gain is not finite, has the wrong sign or exceeds its bound."""
    spec = specs[name]
    low_ok = value >= 0 if spec.zero_allowed else value > 0
    if not np.isfinite(value) or not low_ok or value > spec.below:
        least = "at least 0" if spec.zero_allowed else "greater than 0"
        most = f" and at most {spec.below:.3g}" if np.isfinite(spec.below) else ""
        raise InputError(
            f"must be {least}{most}",
            file=source or None,
            key=name if "." in name else f"gains.{name}",
            value=value,
            remedy=f"{spec.meaning}, in {spec.unit}",
        )


def load_gains(name_or_path: str, *, own: Mapping[str, GainSpec] | None = None) -> Gains:
    """Load a built-in gain file by name, or a gain file by path; a file must contain every gain that has no default.

    Args:
        name_or_path: name of a built-in gain file, or path of a gain file.
        own: further gains that the file may contain: the gains of a law of the user's own (`LawSource.gains`).

    Raises:
        InputError: the file is unreadable, a gain is unknown or missing, a unit is wrong, or a value is out of bounds.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> gains = load_gains("default")
        >>> gains["k_v"], gains["lookahead"], gains.provenance
        (1.5, 0.8, 'chosen by hand for the built-in law, whose paper prints no gain')
    """
    path = pick(str(name_or_path), LIBRARY, what="gains")
    model = load_model(path, _GainFile)
    stated_values: dict[str, float] = {}
    ranges: dict[str, tuple[float, float]] = {}
    specs = {**GAINS, **_chosen(own or {})}
    mistakes = Mistakes()
    for name, quantity in model.gains.items():
        with mistakes.collected():
            stated = _read_gain(name, quantity, path, specs)
            stated_values[name] = stated.value
            if stated.range is not None:
                ranges[name] = stated.range
    mistakes.check()
    for name, spec in specs.items():
        with mistakes.collected():
            if name not in stated_values and spec.default is None:
                remedy = f'add {name} = {{ value = ..., unit = "{spec.unit}" }} ({spec.meaning})'
                raise InputError("is missing", file=path, key=f"gains.{name}", remedy=remedy)
    mistakes.check()
    values = {n: stated_values.get(n, spec.default or 0.0) for n, spec in specs.items()}
    ranges = {n: spec.range for n, spec in specs.items() if spec.range is not None} | ranges
    return Gains(model.name, values, model.provenance, str(path), ranges, own or {})


def _read_gain(name: str, quantity: Quantity, path: Path, specs: Mapping[str, GainSpec]) -> Quantity:
    _check_name(name, path, specs)
    with mistakes_in(path, f"gains.{name}.unit"):
        stated = quantity.within(specs[name].unit)
    for value in (stated.value, *(stated.range or ())):
        _check_value(name, value, path, specs)
    if stated.range is not None and not stated.range[0] <= stated.value <= stated.range[1]:
        raise InputError(
            "is outside its own range",
            file=path,
            key=f"gains.{name}",
            value=stated.value,
            remedy=f"the stated range is {stated.range[0]:g} to {stated.range[1]:g}",
        )
    return stated


def write_gains(gains: Gains, *, warning: str = "") -> str:
    """Return the text of a gain file with the values of `gains`; `load_gains` reads the same values from it.

    A range that does not contain the gain's value is omitted. `warning` becomes a comment in the first line.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.control import load_gains, write_gains
        >>> tuned = load_gains("default").with_values({"k_v": 2.5}, provenance="tried by hand")
        >>> _ = Path("brisk.toml").write_text(write_gains(tuned))
        >>> load_gains("brisk.toml")["k_v"], load_gains("brisk.toml").provenance
        (2.5, 'tried by hand')
    """
    lines = [
        *([f"# {quoted(warning)[1:-1]}"] if warning else []),
        'kind = "gains"',
        f"name = {quoted(gains.name)}",
        f"provenance = {quoted(gains.provenance)}",
        "",
        "[gains]",
    ]
    specs = gains.specs
    for name, value in gains.values.items():
        low, high = gains.ranges.get(name, (np.inf, -np.inf))  # a range that no longer contains the value is omitted
        stated = f", range = [{low!r}, {high!r}]" if low <= value <= high else ""
        lines.append(
            f'{name} = {{ value = {float(value)!r}, unit = "{specs[name].unit}"{stated} }} # {specs[name].meaning}'
        )
    return "\n".join(lines) + "\n"
