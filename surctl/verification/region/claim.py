"""The claim of a region certificate: whose loop, over which ranges, how fast, how far."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from surctl.certcheck.region_claim import EXCLUDES
from surctl.control import Gains, build_law
from surctl.errors import InputError, NotApplicable
from surctl.vehicle import Vehicle
from surctl.verification.assumptions import check_alike, check_no_integral

__all__ = ["RegionClaim", "region_claim"]

Range = tuple[float, float]

_AXES = {"mass_kg": "m11", "linear_drag": "Xu", "quadratic_drag": "Xuu"}  # sway has the same


@dataclass(frozen=True)
class RegionClaim:
    """The cruise of the law that flies, robust over a vehicle's ranges; SI units, pairs are (least, largest).

    Attributes:
        name: of the claim.
        mass, linear, quadratic: true mass and drag of surge and sway [kg, N s/m, N s²/m²].
        asymmetry: largest |surge − sway| / mean of a drag coefficient; 2 leaves them independent.
        thrust: least limit of a horizontal thrust axis, the plant's or the law's [N].
        lag: thrust lag [s]; (0, 0) claims nothing about a lag.
        yaw_rate: largest |r| [rad/s]; any heading motion below it.
        current: largest speed of a current that never changes [m/s]; without lag and held commands only.
        force: largest horizontal force beside the thrust, changing as it likes [N].
        place_error, velocity_error: largest error of the measured place [m] and velocity [m/s], changing as they like.
        model: mass, linear and quadratic drag as the law believes them.
        gains: k1, lookahead, k_v, k_i, wait.
        cruise, cap: speed of the path's target and largest commanded speed [m/s].
        period: control period [s]; 0 claims nothing about sampling.
        rate: a of V̇ ≤ −a V [1/s].
        digests: SHA-256 of the vehicle's numbers and of the law's text.
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
        """Raise InputError for an empty range, or integral action, which the claim does not know."""
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
            raise NotApplicable("k_i is not 0 and the claim is about a loop without integral action", to="these gains")
        if self.current and (self.period or self.lag[1]):
            raise InputError(
                "is not known together with lag or held commands", key="current", value=self.current,
                remedy="leave sampled and lagged out",
            )  # fmt: skip
        if self.cruise >= self.cap:
            why = f"the cruise speed of {self.cruise:g} m/s is not below the cap of {self.cap:g} m/s"
            raise NotApplicable(why, to="these speeds")

    @property
    def size(self) -> int:
        """Number of states: place and velocity in the path frame, and with lag the thrust."""
        return 6 if self.lag[1] > 0 else 4

    def document(self, *, offset: float, ultimate_bound: tuple[float, float]) -> dict[str, Any]:
        """The claim as a certificate states it, with the offset [m] it holds and where it settles [m]."""
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
    """The claim about a vehicle flown with these gains.

    Args:
        name: of the claim.
        vehicle: what the law believes; its surge and sway must be alike.
        gains: of the law.
        share: mass and drag may be off by this share; None takes the ranges of the vehicle file.
        thrust_share: the thrust limit may be lower by this share.
        asymmetry: of the true drag of surge and sway.
        sampled, lagged: whether the control period and the vehicle's thrust lag are in the claim.
        yaw_rate: largest |r| [rad/s].
        cruise, cap: [m/s].
        rate: [1/s].
        current: largest speed of a steady current [m/s].
        force: largest force of waves and of what the thrust is off by [N].
        place_error, velocity_error: of what is measured [m, m/s].

    Raises:
        NotApplicable: surge and sway differ, or integral action is on.
        InputError: a cruise speed that is not below the cap, or a current together with lag or held commands.
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
