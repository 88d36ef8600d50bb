"""Cruise speeds at which a linear loop is judged: how they are checked, and its figures over all of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.vehicle import Vehicle
from surctl.vehicle.linearise import check_trim
from surctl.verification.linear_table import LINEAR_METRICS, linear_table

__all__ = ["OverSpeeds", "check_held", "cruise_speeds", "over_speeds", "speeds_text", "worst_place", "worst_text"]

_SAME = 1e-6  # share by which two figures may differ and be called the same


def cruise_speeds(given: Sequence[float], *, key: str) -> tuple[float, ...]:
    """The speeds [m/s], slowest first.

    Raises:
        InputError: none, one that is not finite and greater than 0, or one twice; it names the key.

    Example:
        >>> from surctl.verification import cruise_speeds
        >>> cruise_speeds([0.2, 0.05], key="cruise_m_per_s")
        (0.05, 0.2)
    """
    if not given:
        raise InputError("names no speed", key=key, value=list(given), remedy="write at least one, or leave it out")
    for speed in given:
        if not (np.isfinite(speed) and speed > 0):
            raise InputError("must be finite and greater than 0", key=key, value=speed, remedy="give it in m/s")
    for speed in given:
        if list(given).count(speed) > 1:
            raise InputError("has a speed twice", key=key, value=speed, remedy="name each once")
    return tuple(sorted(float(speed) for speed in given))


def check_held(speeds: Sequence[float], vehicle: Vehicle, *, cap: float, key: str) -> None:
    """InputError for a speed [m/s] above the cap [m/s] of what is flown, or one that the vehicle's thrust cannot hold.

    Example:
        >>> from surctl.vehicle import load_vehicle
        >>> from surctl.verification import check_held
        >>> check_held((0.1, 0.3), load_vehicle("sur400"), cap=0.22, key="--cruise")
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: --cruise = 0.3: is above the cap, 0.22 m/s; lower it, or raise the cap
    """
    for speed in speeds:
        if speed > cap:
            remedy = "lower it, or raise the cap"
            raise InputError(f"is above the cap, {cap:g} m/s", key=key, value=speed, remedy=remedy)
        try:
            check_trim(vehicle, np.array([speed, 0.0, 0.0, 0.0]))
        except InputError as error:
            problem = f"{error.problem} N by {vehicle.name}"
            raise InputError(problem, key=key, value=speed, remedy="lower it") from None


def worst_place(ill: NDArray[np.float64]) -> NDArray[np.intp]:
    """Where along the first axis, the speeds, the worst entry stands; shape of the rest.

    Larger is worse, NaN worst. Entries that differ by rounding alone are one: the first, the slowest speed, stands for
    all.

    Example:
        >>> import numpy as np
        >>> from surctl.verification import worst_place
        >>> worst_place(np.array([[0.81, 2.0], [0.81 + 1e-15, 3.0]])).tolist()
        [0, 1]
    """
    size = np.where(np.isnan(ill), np.inf, ill)
    return np.asarray(np.isclose(size, size.max(axis=0), rtol=_SAME, atol=0.0).argmax(axis=0))


def worst_text(ill: NDArray[np.float64], speeds: Sequence[float]) -> str:
    """The speed [m/s] with the largest of these entries for people, as `worst_place`; where all are one, every speed.

    Example:
        >>> import numpy as np
        >>> from surctl.verification import worst_text
        >>> worst_text(np.array([1.6, 1.7]), (0.05, 0.2)), worst_text(np.array([1.7, 1.7]), (0.05, 0.2))
        ('0.2 m/s', 'every speed')
    """
    place = int(worst_place(ill))
    return "every speed" if place == worst_place(-ill) else f"{speeds[place]:g} m/s"


def speeds_text(speeds: Sequence[float]) -> str:
    """The speeds with their unit, for a sentence: "0.05, 0.15 and 0.2 m/s".

    Example:
        >>> from surctl.verification import speeds_text
        >>> speeds_text((0.05, 0.15, 0.2)), speeds_text((0.15,))
        ('0.05, 0.15 and 0.2 m/s', '0.15 m/s')
    """
    words = [f"{speed:g}" for speed in speeds]
    return " and ".join([*([", ".join(words[:-1])] if len(words) > 1 else []), words[-1]]) + " m/s"


@dataclass(frozen=True, eq=False)
class OverSpeeds:
    """Linear figures of one set of gains at several cruise speeds.

    Attributes:
        cruise: (k,) [m/s].
        figures: column of `LINEAR_METRICS` → (k,).
    """

    cruise: tuple[float, ...]
    figures: Mapping[str, NDArray[np.float64]]

    def worst(self, name: str) -> tuple[float, float]:
        """The worst value of a figure and its speed [m/s]; one without a better side is worst where it is least."""
        place = int(worst_place(self._ill(name)))
        return float(self.figures[name][place]), self.cruise[place]

    def worst_at(self, name: str) -> str:
        """Where a figure is worst, for people."""
        return worst_text(self._ill(name), self.cruise)

    def _ill(self, name: str) -> NDArray[np.float64]:
        values = self.figures[name]
        return values if LINEAR_METRICS[name].better == "low" else -values

    def to_dict(self) -> dict[str, Any]:
        """Plain data: the figures at each speed, and of each the worst with its speed."""
        worst = {name: dict(zip(("value", "cruise_m_per_s"), self.worst(name), strict=True)) for name in self.figures}
        at = [
            {"cruise_m_per_s": speed} | {name: float(values[k]) for name, values in self.figures.items()}
            for k, speed in enumerate(self.cruise)
        ]
        return {"at": at, "worst": worst}


def over_speeds(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    *,
    cruise: Sequence[float],
    dt: float,
    columns: Collection[str] = ("delay_margin_s", "disk_margin", "sensitivity_peak", "slowest_pole_per_s"),
) -> OverSpeeds:
    """The columns of `linear_table` at each cruise speed [m/s]; `dt`: control period [s].

    Raises:
        InputError: as `linear_table`.

    Example:
        >>> from surctl.control import load_gains
        >>> from surctl.vehicle import load_vehicle
        >>> from surctl.verification import over_speeds
        >>> gains = load_gains("default").values
        >>> found = over_speeds(load_vehicle("sur400"), gains, cruise=(0.05, 0.15, 0.22), dt=0.05)
        >>> found.worst_at("delay_margin_s"), found.worst_at("slowest_pole_per_s")
        ('every speed', '0.05 m/s')
    """
    table = linear_table(vehicle, {}, base=gains, cruise=list(cruise), dt=dt, columns=columns)
    return OverSpeeds(tuple(cruise), {name: table[name] for name in columns})
