"""Several cruise speeds: which are refused, and linear metrics at every speed with the worst of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.vehicle import Vehicle
from surctl.marine.vehicle.linearise import WITHIN_LAW, check_cruise
from surctl.marine.verification.cruise_loop import TRACKING_LAW
from surctl.marine.verification.linear_table import LINEAR_METRICS, linear_table
from surctl.verification.linear import short_margins
from surctl.verification.loops import worst_place


def cruise_speeds(speeds: Sequence[float], *, key: str) -> tuple[float, ...]:
    """Check cruise speeds [m/s]; return them, slowest first.

    Raises:
        InputError: there is no speed, or a speed is not finite, not greater than 0, or repeated; the error names the
            key.

    Example:
        >>> from surctl.marine.verification.speeds import cruise_speeds
        >>> cruise_speeds([0.2, 0.05], key="cruise_m_per_s")
        (0.05, 0.2)
    """
    if not speeds:
        raise InputError("names no speed", key=key, value=list(speeds), remedy="write at least one, or omit the key")
    for speed in speeds:
        if not (np.isfinite(speed) and speed > 0):
            raise InputError("must be finite and greater than 0", key=key, value=speed, remedy="give it in m/s")
    for speed in speeds:
        if list(speeds).count(speed) > 1:
            raise InputError("has a speed twice", key=key, value=speed, remedy="name each speed once")
    return tuple(sorted(float(speed) for speed in speeds))


def check_held(speeds: Sequence[float], vehicle: Vehicle, *, cap: float, key: str) -> None:
    """Raise InputError if a speed [m/s] exceeds the speed cap [m/s] or needs more thrust than the vehicle has.

    Example:
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification.speeds import check_held
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
            check_cruise(vehicle, speed)
        except InputError as error:
            remedy = "lower the speed" + " or raise Fu_reverse" * (error.remedy == WITHIN_LAW)
            problem = f"{vehicle.name} {error.problem}"
            raise InputError(problem, key=key, value=speed, remedy=remedy) from None


def speeds_text(speeds: Sequence[float]) -> str:
    """Return the speeds with their unit as text for a sentence: "0.05, 0.15 and 0.2 m/s".

    Example:
        >>> from surctl.marine.verification.speeds import speeds_text
        >>> speeds_text((0.05, 0.15, 0.2)), speeds_text((0.15,))
        ('0.05, 0.15 and 0.2 m/s', '0.15 m/s')
    """
    words = [f"{speed:g}" for speed in speeds]
    return " and ".join([*([", ".join(words[:-1])] if len(words) > 1 else []), words[-1]]) + " m/s"


@dataclass(frozen=True, eq=False)
class OverSpeeds:
    """Linear metrics of one gain set at several cruise speeds.

    Attributes:
        cruise: (k,) cruise speeds [m/s].
        figures: mapping from the name of a metric of `LINEAR_METRICS` to the metric's values (k,) at the k speeds.
    """

    cruise: tuple[float, ...]
    figures: Mapping[str, NDArray[np.float64]]

    def worst(self, name: str) -> tuple[float, float]:
        """Return the worst value of a metric and its speed [m/s].

        The worst value is the largest value if low values of the metric are better, otherwise the least value.
        """
        place = int(worst_place(self._ill(name)))
        return float(self.figures[name][place]), self.cruise[place]

    def where(self, name: str) -> str:
        """Return the speed of the worst value as text, or "every speed" if all values count as equal."""
        same = worst_place(self._ill(name)) == worst_place(-self._ill(name))
        return "every speed" if same else f"{self.worst(name)[1]:g} m/s"

    @property
    def short(self) -> str:
        """The margins at the worst corner that do not suffice at some speed, as text; empty if both do."""
        disk, delay = ((value, f"at {u:.3g} m/s") for value, u in map(self.worst, ("disk_margin", "delay_margin_s")))
        return short_margins(disk, delay)

    @property
    def sentence(self) -> str:
        """The margins that do not suffice, as a sentence of gains that have both margins at the largest speed."""
        return f"margins below {max(self.cruise):g} m/s, where the vehicle starts and turns: {self.short}"

    def _ill(self, name: str) -> NDArray[np.float64]:
        values = self.figures[name]
        return values if LINEAR_METRICS[name].better == "low" else -values

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON: the metrics at each speed, and the worst value of each metric with its speed."""
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
    law: str = TRACKING_LAW,
    uncertainty: float | None = None,
) -> OverSpeeds:
    """Return the columns of `linear_table` at each cruise speed [m/s]; `dt` is the control period [s].

    Raises:
        InputError: `linear_table` rejects its arguments.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import over_speeds
        >>> gains = load_gains("default").values
        >>> over = over_speeds(load_vehicle("sur400"), gains, cruise=(0.05, 0.15, 0.22), dt=0.05)
        >>> pole, speed = over.worst("slowest_pole_per_s")
        >>> round(pole, 3), speed
        (-0.065, 0.05)
    """
    about: dict[str, Any] = {"columns": columns, "law": law, "uncertainty": uncertainty}
    return OverSpeeds(tuple(cruise), linear_table(vehicle, {}, base=gains, cruise=list(cruise), dt=dt, **about))


_SLOWER = (0.05, 0.35, 0.7)
"""Speeds between rest and the cruise speed at which margins are examined, as shares of the cruise speed."""


def slow_margins(vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float, **about: Any) -> OverSpeeds:
    """Return the margins at the worst corner at the cruise speed [m/s] and three slower ones, as `over_speeds`.

    The Munk moment falls with the square of the speed, so that some gains fit a fast vehicle better than a slow one.

    Example:
        >>> from surctl.marine.tuning import derive_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification.speeds import slow_margins
        >>> rov = load_vehicle("bluerov2-wu")
        >>> gains = derive_gains(rov, cruise=0.33).gains.values
        >>> slow_margins(rov, gains, cruise=0.33, dt=0.05).short
        'a disk margin of 0.27 at 0.0165 m/s ...'
    """
    speeds = (*(share * cruise for share in _SLOWER), cruise)
    return over_speeds(vehicle, gains, cruise=speeds, dt=dt, columns=("disk_margin", "delay_margin_s"), **about)
