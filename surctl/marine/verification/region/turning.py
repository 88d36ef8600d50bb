"""A claim about a turning cruise with different masses in surge and sway, and vehicles that it cannot be about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from surctl.certcheck.fields import written
from surctl.certcheck.turning_claim import EXCLUDES, read_claim
from surctl.certcheck.turning_claim import TurningClaim as Stated
from surctl.errors import InputError, NotApplicable
from surctl.marine.control import Gains, build_law
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.assumptions import check_no_integral, check_sway_force, nine_decimals

Pair = tuple[float, float]

_HEAVE: Pair = (0.1, 0.1)
"""Largest heave velocity [m/s] (the law commands no more) and heave acceleration [m/s²] that the claims assume."""

_TURN_RATE = 1.0
"""Largest yaw acceleration [rad/s²] that the claims assume."""


@dataclass(frozen=True)
class TurningClaim:
    """Claim about the cruise of a vehicle under the exported law, for all parameters in given ranges.

    A true parameter is its value in the law's model times a constant factor; SI units.

    Attributes:
        name: name of the claim.
        mass_factor, drag_factor: (least, largest) factor of the masses and of the drag coefficients.
        mass_asymmetry, drag_asymmetry: largest difference of the factors of the two masses, and of the two linear or
            the two quadratic drag coefficients, divided by their mean.
        thrust: least thrust limits (surge, sway) of the plant and of the law [N].
        yaw_limit: largest yaw moment of the thrusters [N m].
        yaw_rate: largest yaw rate |r| [rad/s]; within this limit the heading may change arbitrarily.
        mass, linear, quadratic: (surge, sway) values in the law's model.
        gains: the gains k1, lookahead, k_v, k_i and wait.
        cruise, cap: speed of the target point on the path, and largest commanded speed [m/s].
        rate: decay rate a [1/s] of the Lyapunov function V: V̇ ≤ −a V.
        rest: whether the region must also contain a vehicle at rest.
        jumps: deviations (δx_e, δU_x, δU_y) from the target [m, m/s] for which the search shapes the region; if there
            are none, it shapes the region for starts beside the path.
        digests: SHA-256 of the vehicle's parameters, and SHA-256 of the law's instruction list.
        terms: the vehicle's terms beside equation (3), by name; inertia is off by `mass_factor`, the others by
            `drag_factor`.
        heave, turn_rate: largest heave velocity and acceleration [m/s, m/s²], and largest yaw acceleration [rad/s²].
        curvature: largest curvature of the path [1/m].
        current: largest speed of a constant current [m/s].
        lag: time constant of the thrust lag [s]; 0 for thrust without lag.
        period: control period [s], during which the command is constant; 0 for a loop in continuous time.
        force, place_error, velocity_error: largest horizontal disturbance force [N], and largest errors of the measured
            position [m] and velocity [m/s], varying arbitrarily; only for a loop without lag and in continuous time.
    """

    name: str
    mass_factor: Pair
    drag_factor: Pair
    mass_asymmetry: float
    drag_asymmetry: float
    thrust: Pair
    yaw_limit: float
    yaw_rate: float
    mass: Pair
    linear: Pair
    quadratic: Pair
    gains: Mapping[str, float]
    cruise: float
    cap: float
    rate: float
    rest: bool = False
    jumps: tuple[tuple[float, float, float], ...] = ()
    digests: tuple[str, str] = ("0" * 64, "0" * 64)
    terms: Mapping[str, float] = field(default_factory=dict)
    heave: Pair = _HEAVE
    turn_rate: float = _TURN_RATE
    curvature: float = 0.0
    current: float = 0.0
    lag: float = 0.0
    period: float = 0.0
    force: float = 0.0
    place_error: float = 0.0
    velocity_error: float = 0.0

    def __post_init__(self) -> None:
        """Raise InputError for a number out of bounds, NotApplicable for integral action or a cruise speed ≥ cap."""
        for key in ("cruise", "cap", "rate"):
            if not getattr(self, key) > 0:
                raise InputError("must be greater than 0", key=key, value=getattr(self, key), remedy="correct it")
        if self.gains["k_i"]:
            raise NotApplicable("the claim is about a loop without integral action and k_i is not 0", to="these gains")
        if self.cruise >= self.cap:
            why = f"the cruise speed of {self.cruise:g} m/s is not below the cap of {self.cap:g} m/s"
            raise NotApplicable(why, to="these speeds")
        if self.behind and (self.curvature or self.terms.get("m12")):
            raise NotApplicable("thrust lag and held commands are not covered together with m12 or a curved path")
        for key in ("force", "place_error", "velocity_error"):
            if not getattr(self, key) >= 0:
                raise InputError("must be at least 0", key=key, value=getattr(self, key), remedy="correct it")
            if self.behind and getattr(self, key):
                raise InputError(
                    "is not supported together with thrust lag or held commands", key=key, value=getattr(self, key),
                    remedy="leave out sampled and lagged",
                )  # fmt: skip

    def document(
        self, *, offset: float, rest_offset: float | None, ultimate_bound: Pair, munk_moment: float
    ) -> dict[str, Any]:
        """Return the claim as data of a certificate, with the offsets [m], bound [m] and moment [N m] to be stated."""
        values = {
            **vars(self), **self.gains, "heave": self.heave[0], "heave_rate": self.heave[1],
            "lag": (self.lag, self.lag), "offset": offset, "rest_offset": rest_offset,
            "ultimate_bound": ultimate_bound, "munk_moment": munk_moment,
        }  # fmt: skip
        return {
            "system": "turning-cruise", "excludes": list(EXCLUDES), **written(Stated, values),
            "sha256_vehicle": self.digests[0], "sha256_law": self.digests[1],
        }  # fmt: skip

    @property
    def behind(self) -> bool:
        """Whether the thrust may differ from the present command: by a lag, or because a command is held."""
        return bool(self.lag or self.period)

    @property
    def late_parts(self) -> int:
        """Number of pairs of states that thrust lag and held commands add."""
        return (self.lag > 0) + (self.period > 0)

    @property
    def ideal(self) -> bool:
        """Whether the masses are equal, and there is no lag, held command, current, curve, force or error."""
        more = (self.mass_asymmetry, self.lag, self.period, self.current, self.curvature, self.terms)
        return self.mass[0] == self.mass[1] and not any((*more, self.force, self.place_error, self.velocity_error))

    @cached_property
    def stated(self) -> Stated:
        """Return the claim as the checker reads it, with a region that is not yet known."""
        return read_claim(self.document(offset=1.0, rest_offset=None, ultimate_bound=(1.0, 1.0), munk_moment=0.0))


def turning_claim(
    name: str,
    vehicle: Vehicle,
    gains: Gains,
    *,
    share: float | None = 0.2,
    mass_share: float | None = 0.05,
    asymmetry: float = 0.05,
    mass_asymmetry: float | None = None,
    thrust_share: float = 0.0,
    yaw_rate: float = 0.5,
    cruise: float = 0.15,
    cap: float = 0.22,
    rate: float = 0.05,
    rest: bool = False,
    curvature: float = 0.0,
    current: float = 0.0,
    lagged: bool = False,
    sampled: bool = False,
    force: float = 0.0,
    place_error: float = 0.0,
    velocity_error: float = 0.0,
) -> TurningClaim:
    """Return the claim about the cruise of a vehicle under the exported law; surge and sway may differ.

    Args:
        name: name of the claim.
        vehicle: the vehicle that the law's model describes.
        gains: gains of the law.
        share: relative error of the drag coefficients; None takes the ranges of the vehicle file.
        mass_share: relative error of the masses m11 and m22; None takes the ranges of the vehicle file.
        asymmetry: largest difference of the factors of the two linear or the two quadratic drag coefficients, divided
            by their mean.
        mass_asymmetry: the same for the factors of the two masses; None for the value of `asymmetry`.
        thrust_share: largest relative reduction of the thrust limits.
        yaw_rate: largest yaw rate |r| [rad/s].
        cruise, cap: speed of the target point on the path, and largest commanded speed [m/s].
        rate: decay rate of the Lyapunov function V [1/s].
        rest: whether the region must also contain a vehicle at rest.
        curvature: largest curvature of the path [1/m].
        current: largest speed of a constant current [m/s].
        lagged, sampled: whether the vehicle's thrust lag and the control period are part of the claim.
        force: largest force of waves and thrust errors [N].
        place_error, velocity_error: largest error of the measured position [m] and of the measured velocity [m/s].

    Raises:
        NotApplicable: the vehicle has no sway force, or rolls and pitches, or has sway drag that grows with the surge
            speed; or integral action is on, or the cruise speed is not below the cap.
        InputError: a number is out of bounds.
    """
    _check_form(vehicle)
    check_no_integral(gains)
    limits, law = vehicle.thrust_limit * (1 - thrust_share), build_law()

    def factors(error: float | None, *names: str) -> Pair:
        if error is not None:
            return round(1 - error, 9), round(1 + error, 9)
        stated = [(vehicle[name], vehicle.parameters[name].range) for name in names if vehicle[name]]
        ends = [end / value for value, known in stated for end in (known or (value, value))]
        return float(np.floor(1e9 * min(ends)) / 1e9), float(np.ceil(1e9 * max(ends)) / 1e9)

    return TurningClaim(
        name=name,
        mass_factor=factors(mass_share, "m11", "m22"),
        drag_factor=factors(share, "Xu", "Yv", "Xuu", "Yvv"),
        mass_asymmetry=(asymmetry if mass_asymmetry is None else mass_asymmetry) if mass_share != 0 else 0.0,
        drag_asymmetry=asymmetry if share != 0 else 0.0,
        thrust=(nine_decimals(limits[0], up=False), nine_decimals(limits[1], up=False)),
        yaw_limit=float(limits[3]),
        yaw_rate=yaw_rate,
        mass=(vehicle["m11"], vehicle["m22"]),
        linear=(vehicle["Xu"], vehicle["Yv"]),
        quadratic=(vehicle["Xuu"], vehicle["Yvv"]),
        gains={key: gains[key] for key in ("k1", "lookahead", "k_v", "k_i", "wait")},
        cruise=cruise,
        cap=cap,
        rate=rate,
        rest=rest,
        digests=(vehicle.digest(), law.block.digest()),
        terms={name: vehicle[name] for name in vehicle.form.terms},
        curvature=curvature,
        current=current,
        lag=vehicle["thrust_lag"] if lagged else 0.0,
        period=law.dt if sampled else 0.0,
        force=force,
        place_error=place_error,
        velocity_error=velocity_error,
    )


def _check_form(vehicle: Vehicle) -> None:
    """Raise NotApplicable for a vehicle whose motion the claim does not describe."""
    form = vehicle.form
    check_sway_force(vehicle)
    if form.tilts:
        raise NotApplicable("it rolls and pitches, and the claim is about motion in the horizontal plane")
    by_surge = [name for axis, name in form.ahead() if axis == 1]
    if by_surge:
        raise NotApplicable(f"it has {by_surge[0]}, and the law's model of the sway drag depends on the cruise speed")
