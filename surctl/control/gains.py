"""Gain files, which hold every tunable number of a law by name, with unit and meaning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from surctl.errors import InputError, nearest
from surctl.files import Quantity, Strict, load_model, pick, quoted

__all__ = ["GAINS", "LIBRARY", "GainSpec", "Gains", "load_gains", "write_gains"]

LIBRARY = Path(__file__).parent / "library"


@dataclass(frozen=True)
class GainSpec:
    """Unit and meaning of a gain, and its bounds.

    If `zero_allowed` is False, the gain must be greater than 0. A file may omit a gain that has a `default`.
    """

    unit: str
    meaning: str
    zero_allowed: bool = False
    below: float = float("inf")
    default: float | None = None


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
    """A named, complete set of gains in SI units: the values by name, and the ranges from the gain file."""

    name: str
    values: Mapping[str, float]
    provenance: str
    source: str = ""
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __getitem__(self, name: str) -> float:
        """Return the value of a gain; an unknown name raises InputError and the message suggests a similar name."""
        check_name(name, self.source)
        return self.values[name]

    def with_values(
        self, values: Mapping[str, float], *, provenance: str | None = None, how: str | None = None
    ) -> Gains:
        """Return a copy with some gains changed and checked; `how` is appended to the name of the gain set."""
        for name, value in values.items():
            check_name(name, self.source)
            check_value(name, float(value), self.source)
        merged = {**self.values, **{k: float(v) for k, v in values.items()}}
        name = self.name if how is None else f"{self.name.removesuffix(f'-{how}')}-{how}"
        return replace(self, name=name, values=merged, provenance=provenance or self.provenance)


def check_name(name: str, source: object) -> None:
    """Raise InputError if `name` is not a gain; the message suggests a similar known name."""
    if name not in GAINS:
        raise InputError("no such gain", file=source or None, key=f"gains.{name}", remedy=nearest(name, GAINS))


def check_value(name: str, value: float, source: object) -> None:
    """Raise InputError if the value of a gain is not finite, has the wrong sign or exceeds its bound."""
    spec = GAINS[name]
    low_ok = value >= 0 if spec.zero_allowed else value > 0
    if not np.isfinite(value) or not low_ok or value > spec.below:
        least = "at least 0" if spec.zero_allowed else "greater than 0"
        most = f" and at most {spec.below:.3g}" if np.isfinite(spec.below) else ""
        raise InputError(
            f"must be {least}{most}",
            file=source or None,
            key=f"gains.{name}",
            value=value,
            remedy=f"{spec.meaning}, in {spec.unit}",
        )


def load_gains(name_or_path: str) -> Gains:
    """Load a built-in gain file by name or another gain file by path; a file must contain all gains without default.

    Raises:
        InputError: the file is unreadable, a gain is unknown or missing, a unit is wrong, or a value is out of bounds.

    Example:
        >>> from surctl.control import load_gains
        >>> gains = load_gains("default")
        >>> gains["k_v"], gains["lookahead"], gains.provenance
        (1.5, 0.8, 'chosen by hand: the paper prints no gain')
    """
    path = pick(str(name_or_path), LIBRARY, what="gains")
    model = load_model(path, _GainFile)
    stated_values: dict[str, float] = {}
    ranges: dict[str, tuple[float, float]] = {}
    for name, quantity in model.gains.items():
        check_name(name, path)
        try:
            stated = quantity.within(GAINS[name].unit)
        except InputError as error:
            raise error.inside(path, f"gains.{name}.unit") from None
        check_value(name, stated.value, path)
        stated_values[name] = stated.value
        if stated.range is not None:
            for bound in stated.range:
                check_value(name, bound, path)
            if not stated.range[0] <= stated.value <= stated.range[1]:
                raise InputError(
                    "is outside its own range",
                    file=path,
                    key=f"gains.{name}",
                    value=stated.value,
                    remedy=f"the stated range is {stated.range[0]:g} to {stated.range[1]:g}",
                )
            ranges[name] = stated.range
    for name, spec in GAINS.items():
        if name not in stated_values and spec.default is None:
            raise InputError(
                "is missing",
                file=path,
                key=f"gains.{name}",
                remedy=f'add {name} = {{ value = ..., unit = "{spec.unit}" }} ({spec.meaning})',
            )
    values = {n: stated_values.get(n, spec.default or 0.0) for n, spec in GAINS.items()}
    return Gains(model.name, values, model.provenance, str(path), ranges)


def write_gains(gains: Gains, *, warning: str = "") -> str:
    """Return the text of a gain file with the values of `gains`; `load_gains` reads the same values from it.

    A range that does not contain its value is omitted. `warning` becomes a comment in the first line.

    Example:
        >>> from pathlib import Path
        >>> from surctl.control import load_gains, write_gains
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
    for name, value in gains.values.items():
        low, high = gains.ranges.get(name, (np.inf, -np.inf))  # a range that no longer contains the value is omitted
        stated = f", range = [{low!r}, {high!r}]" if low <= value <= high else ""
        lines.append(
            f'{name} = {{ value = {float(value)!r}, unit = "{GAINS[name].unit}"{stated} }} # {GAINS[name].meaning}'
        )
    return "\n".join(lines) + "\n"
