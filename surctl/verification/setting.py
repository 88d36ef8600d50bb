"""The numbers a claim is about: gains, speeds and radii."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from surctl.errors import InputError

__all__ = ["OVERSHOOT", "Setting", "setting_from"]

OVERSHOOT = 0.25 / 0.22  # own speed over the commanded one that claims about braking count on
_FASTEST = 0.25  # [m/s] the least that they range over
_ALIASES = {"margin": "standoff"}  # the gain file's word for d_s


@dataclass(frozen=True)
class Setting:
    """Gains and speeds of the library's claims; the defaults are chosen, the paper prints none.

    Attributes:
        k1: along-track gain [1/s].
        k2: depth gain [1/s].
        k3: convergence coefficient of (20).
        lookahead: Δ_h [m].
        delta: largest δ of (20) that the printed claims range over [m].
        kappa: barrier gain of the corrected avoidance law [1/s].
        standoff: d_s of the corrected avoidance law [m].
        radius: R_OB, anti-collision radius [m].
        speed: v_d = U_d, speed of the path's target [m/s].
        speed_max: largest speed U_h and u_OB [m/s].
        avoidance_speed: u_dm of the printed figures [m/s].
        obstacle_speed: u_OB of the printed figures [m/s].
    """

    k1: float = 0.5
    k2: float = 0.5
    k3: float = 1.0
    lookahead: float = 0.5
    delta: float = 0.1
    kappa: float = 0.5
    standoff: float = 0.1
    radius: float = 0.5
    speed: float = 0.15
    speed_max: float = 0.25
    avoidance_speed: float = 0.22
    obstacle_speed: float = 0.15

    @property
    def fastest(self) -> float:
        """Largest own speed [m/s] that claims about braking range over: overshoot beyond the cap included."""
        return max(_FASTEST, OVERSHOOT * self.speed_max)

    def __post_init__(self) -> None:
        """Raise InputError for a number that is not positive and finite, or a cap below the cruise speed."""
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not (np.isfinite(value) and value > 0):
                raise InputError("must be greater than 0", key=entry.name, value=value, remedy="correct the gain")
        if self.speed_max < self.speed:
            raise InputError(
                f"must not be below the speed of the path's target, {self.speed:g} m/s",
                key="speed_max",
                value=self.speed_max,
                remedy="raise it",
            )
        if self.obstacle_speed >= self.avoidance_speed:
            raise InputError(
                f"must be less than the avoidance speed, {self.avoidance_speed:g} m/s",
                key="obstacle_speed",
                value=self.obstacle_speed,
                remedy="(20) settles nowhere before a faster obstacle",
            )


def setting_from(gains: Mapping[str, float] | None) -> Setting:
    """The setting with the gains that bear its names; other gains do not enter a claim and are passed over.

    A δ ≤ 0 is not the printed law's safety distance: the claims about the print keep their own δ.

    Raises:
        InputError: a gain that is not one finite number greater than 0.

    Example:
        >>> from surctl.verification import setting_from
        >>> setting = setting_from({"k1": 0.3, "margin": 0.05, "k_v": 1.5})  # k_v enters no claim
        >>> setting.k1, setting.standoff, setting.lookahead
        (0.3, 0.05, 0.5)
    """
    known = {entry.name for entry in fields(Setting)}
    named = {_ALIASES.get(name, name): (name, value) for name, value in (gains or {}).items()}
    values = {field: _number(*entry) for field, entry in named.items() if field in known}
    if values.get("delta", 1.0) <= 0:
        del values["delta"]
    return Setting(**values)


def _number(name: str, value: object) -> float:
    try:
        return float(np.asarray(value, dtype=float).reshape(()))
    except (TypeError, ValueError):
        raise InputError("must be one number", key=name, value=value, remedy="give the gain as a number") from None
