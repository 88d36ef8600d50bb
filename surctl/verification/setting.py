"""Gains, speeds and radii with which the claims of the library are evaluated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from surctl.errors import InputError

OVERSHOOT = 0.25 / 0.22  # ratio of the robot's speed to its commanded speed that the braking claims assume
_FASTEST = 0.25  # [m/s] least upper bound of the robot's speed in the braking claims
_ALIASES = {"margin": "standoff"}  # name of d_s in the gain file


@dataclass(frozen=True)
class Setting:
    """The gains and speeds of the library's claims; the defaults are our choice, because the paper gives no values.

    Attributes:
        k1: along-track gain [1/s].
        k2: depth gain [1/s].
        k3: convergence coefficient of equation (20) of the paper.
        lookahead: lookahead distance Δ_h [m].
        delta: scale of the safety distance δ in equation (20) [m]; the claims cover δ up to 2 `delta`.
        kappa: barrier gain κ of the corrected avoidance law [1/s].
        standoff: standoff distance d_s of the corrected avoidance law [m].
        radius: anti-collision radius R_OB [m].
        speed: speed v_d = U_d [m/s] of the target point that moves along the path.
        speed_max: largest speed [m/s], both of the robot (U_h) and of the obstacle (u_OB).
        avoidance_speed: robot speed u_dm in the paper's figures [m/s].
        obstacle_speed: obstacle speed u_OB in the paper's figures [m/s].
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
        """The largest speed [m/s] of the robot in the braking claims, including overshoot beyond the speed limit."""
        return max(_FASTEST, OVERSHOOT * self.speed_max)

    def __post_init__(self) -> None:
        """Raise InputError for a value that is not positive and finite, or for inconsistent speeds."""
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not (np.isfinite(value) and value > 0):
                raise InputError("must be greater than 0", key=entry.name, value=value, remedy="correct the gain")
        if self.speed_max < self.speed:
            problem = f"must not be below the speed of the path's target, {self.speed:g} m/s"
            raise InputError(problem, key="speed_max", value=self.speed_max, remedy="raise it")
        if self.obstacle_speed >= self.avoidance_speed:
            problem = f"must be less than the avoidance speed, {self.avoidance_speed:g} m/s"
            remedy = "lower it: law (20) has no equilibrium in front of a faster obstacle"
            raise InputError(problem, key="obstacle_speed", value=self.obstacle_speed, remedy=remedy)


def setting_from(gains: Mapping[str, float] | None) -> Setting:
    """Return the setting with the given gains; gains that no claim uses are ignored.

    A gain δ ≤ 0 is ignored, because it cannot be the safety distance of the printed law; `Setting.delta` then has its
    default value.

    Raises:
        InputError: a gain is not one finite number greater than 0.

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
