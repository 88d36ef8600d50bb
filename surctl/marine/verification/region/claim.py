"""A region claim about a cruise as data: loop, ranges of the parameters, decay rate, vehicles it cannot be about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from surctl.certcheck.region_claim import EXCLUDES
from surctl.errors import InputError, NotApplicable
from surctl.marine.control import Gains, build_law
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.assumptions import check_alike, check_no_integral
from surctl.marine.verification.region.turning import TurningClaim

Range = tuple[float, float]

_AXES = {"mass_kg": "m11", "linear_drag": "Xu", "quadratic_drag": "Xuu"}  # surge; sway must have equal values


@dataclass(frozen=True)
class RegionClaim:
    """Claim about the cruise of a vehicle under the exported law, for all parameters in given ranges.

    All quantities are in SI units; pairs are (least, largest).

    Attributes:
        name: name of the claim.
        mass, linear, quadratic: true mass [kg], linear drag [N s/m] and quadratic drag [N s²/m²] of surge and sway.
        asymmetry: largest difference of a drag coefficient between surge and sway, divided by the mean of both values;
            2 makes the values of surge and sway independent.
        thrust: least of the thrust limits of the horizontal axes, of the plant and of the law [N].
        lag: time constant of the thrust lag [s]; (0, 0) for a loop without lag.
        yaw_rate: largest yaw rate |r| [rad/s]; within this limit the heading may change arbitrarily.
        current: largest speed of a constant current [m/s]; only for a loop without thrust lag and in continuous time.
        force: largest horizontal disturbance force, varying arbitrarily [N].
        place_error, velocity_error: largest error of the measured position [m] and of the measured velocity [m/s]; the
            errors vary arbitrarily.
        model: mass, linear and quadratic drag in the law's model.
        gains: the gains k1, lookahead, k_v, k_i and wait.
        cruise, cap: speed of the target point on the path, and largest commanded speed [m/s].
        period: control period [s], during which the command is constant; 0 for a loop in continuous time.
        rate: decay rate a [1/s] of the Lyapunov function V: V̇ ≤ −a V.
        digests: SHA-256 of the vehicle's parameters, and SHA-256 of the law's instruction list.
    """

    name: str
    mass: Range
    linear: Range
    quadratic: Range
    asymmetry: float
    thrust: float
    lag: Range
    yaw_rate: float
    model: tuple[float, float, float]
    gains: Mapping[str, float]
    cruise: float
    cap: float
    period: float
    rate: float
    digests: tuple[str, str] = ("0" * 64, "0" * 64)
    current: float = 0.0
    force: float = 0.0
    place_error: float = 0.0
    velocity_error: float = 0.0

    def __post_init__(self) -> None:
        """Raise InputError for a number out of bounds, NotApplicable for integral action or a cruise speed ≥ cap."""
        for key in ("mass", "linear", "quadratic", "lag"):
            low, high = getattr(self, key)
            if not 0 <= low <= high or (key == "mass" and low == 0):
                raise InputError("is not a range", key=key, value=(low, high), remedy="give (least, largest)")
        for key in ("force", "place_error", "velocity_error"):
            if not getattr(self, key) >= 0:
                raise InputError("must be at least 0", key=key, value=getattr(self, key), remedy="correct it")
        for key in ("thrust", "cruise", "cap", "rate"):
            if not getattr(self, key) > 0:
                raise InputError("must be greater than 0", key=key, value=getattr(self, key), remedy="correct it")
        if self.gains["k_i"]:
            raise NotApplicable("the claim is about a loop without integral action and k_i is not 0", to="these gains")
        if self.current and (self.period or self.lag[1]):
            raise InputError(
                "is not supported together with thrust lag or held commands", key="current", value=self.current,
                remedy="leave out sampled and lagged",
            )  # fmt: skip
        if self.cruise >= self.cap:
            why = f"the cruise speed of {self.cruise:g} m/s is not below the cap of {self.cap:g} m/s"
            raise NotApplicable(why, to="these speeds")

    @property
    def size(self) -> int:
        """Return the number of states: position and velocity in the path frame, and also the thrust if it has a lag."""
        return 6 if self.lag[1] > 0 else 4

    @property
    def ideal(self) -> bool:
        """Return whether the loop has no lag, held commands, current, disturbance force or error of measurement."""
        more = (self.period, self.current, self.force, self.place_error, self.velocity_error)
        return self.size == 4 and not any(more)

    def turning(self) -> TurningClaim | None:
        """Return the same claim about a turning cruise, for a proof by cells of headings; None if there is none."""
        drag = (self.linear, self.model[1]), (self.quadratic, self.model[2])
        if self.lag[1] or self.period or self.current or self.asymmetry >= 2:
            return None
        if any(high and not model for (_, high), model in drag):
            return None
        ends = [end / model for pair, model in drag for end in pair if model] or [1.0]
        mass, linear, quadratic = self.model
        return TurningClaim(
            name=self.name,
            mass_factor=(self.mass[0] / mass, self.mass[1] / mass),
            drag_factor=(min(ends), max(ends)),
            mass_asymmetry=0.0,
            drag_asymmetry=self.asymmetry,
            thrust=(self.thrust, self.thrust),
            yaw_limit=0.0,  # equal masses have no Munk moment
            yaw_rate=self.yaw_rate,
            mass=(mass, mass),
            linear=(linear, linear),
            quadratic=(quadratic, quadratic),
            gains=self.gains,
            cruise=self.cruise,
            cap=self.cap,
            rate=self.rate,
            force=self.force,
            place_error=self.place_error,
            velocity_error=self.velocity_error,
        )

    def document(self, *, offset: float, ultimate_bound: tuple[float, float]) -> dict[str, Any]:
        """Return the claim as data of a certificate, with the offset [m] and the ultimate bound [m] to be stated."""
        mass, linear, quadratic = self.model
        return {
            "system": "cruise",
            "excludes": list(EXCLUDES),
            "vehicle": {
                "mass_kg": list(self.mass),
                "linear_drag": list(self.linear),
                "quadratic_drag": list(self.quadratic),
                "asymmetry": self.asymmetry,
                "thrust_n": self.thrust,
                "lag_s": list(self.lag),
                "yaw_rate_rad_per_s": self.yaw_rate,
                "current_m_per_s": self.current,
                "force_n": self.force,
                "place_error_m": self.place_error,
                "velocity_error_m_per_s": self.velocity_error,
            },
            "law": {
                "mass_kg": mass,
                "linear_drag": linear,
                "quadratic_drag": quadratic,
                **{key: self.gains[key] for key in ("k1", "lookahead", "k_v", "k_i", "wait")},
                "cruise": self.cruise,
                "cap": self.cap,
                "period_s": self.period,
            },
            "motion": {"rate_per_s": self.rate, "offset_m": offset, "ultimate_bound_m": list(ultimate_bound)},
            "sha256_vehicle": self.digests[0],
            "sha256_law": self.digests[1],
        }


def region_claim(
    name: str,
    vehicle: Vehicle,
    gains: Gains,
    *,
    share: float | None = 0.2,
    thrust_share: float = 0.0,
    asymmetry: float = 0.05,
    sampled: bool = False,
    lagged: bool = False,
    yaw_rate: float = 0.5,
    cruise: float = 0.15,
    cap: float = 0.22,
    rate: float = 0.05,
    current: float = 0.0,
    force: float = 0.0,
    place_error: float = 0.0,
    velocity_error: float = 0.0,
) -> RegionClaim:
    """Return the claim about the cruise of a vehicle under the exported law with the given gains.

    Args:
        name: name of the claim.
        vehicle: the vehicle that the law's model describes; its parameters of surge and sway must be equal.
        gains: gains of the law.
        share: relative error of mass and drag; None takes the ranges of the vehicle file.
        thrust_share: largest relative reduction of the thrust limits.
        asymmetry: largest difference of a true drag coefficient between surge and sway, divided by their mean.
        sampled, lagged: whether the control period and the vehicle's thrust lag are part of the claim.
        yaw_rate: largest yaw rate |r| [rad/s].
        cruise, cap: speed of the target point on the path, and largest commanded speed [m/s].
        rate: decay rate of the Lyapunov function V [1/s].
        current: largest speed of a constant current [m/s].
        force: largest force of waves and thrust errors [N].
        place_error, velocity_error: largest error of the measured position [m] and of the measured velocity [m/s].

    Raises:
        NotApplicable: surge and sway differ, integral action is on, or the cruise speed is not below the cap.
        InputError: a number is out of bounds, or a current is combined with thrust lag or with a control period.
    """
    check_alike(vehicle, ranges=share is None)
    check_no_integral(gains)
    ranges, model = {}, []
    for key, surge in _AXES.items():
        value, known = vehicle[surge], vehicle.parameters[surge].range
        model.append(value)
        ranges[key] = (value, value) if known is None else (float(known[0]), float(known[1]))
        if share is not None:
            ranges[key] = (round(value * (1 - share), 9), round(value * (1 + share), 9))
    limit = min(vehicle["Fu_max"], vehicle["Fv_max"])
    lag = vehicle["thrust_lag"] if lagged else 0.0
    law = build_law()
    return RegionClaim(
        name=name,
        mass=ranges["mass_kg"],
        linear=ranges["linear_drag"],
        quadratic=ranges["quadratic_drag"],
        asymmetry=asymmetry,
        thrust=round(limit * (1 - thrust_share), 9),
        lag=(lag, lag),
        yaw_rate=yaw_rate,
        model=(model[0], model[1], model[2]),
        gains={key: gains[key] for key in ("k1", "lookahead", "k_v", "k_i", "wait")},
        cruise=cruise,
        cap=cap,
        period=law.dt if sampled else 0.0,
        rate=rate,
        current=current,
        force=force,
        place_error=place_error,
        velocity_error=velocity_error,
        digests=(vehicle.digest(), law.block.digest()),
    )
