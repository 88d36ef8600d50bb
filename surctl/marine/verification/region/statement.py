"""Region claims as TOML files: their keys, keys without effect, and the laws that they are about."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, StrictBool, StrictFloat, StrictInt, StrictStr

from surctl.errors import InputError, NotApplicable
from surctl.files import Strict, load_model, quoted, require_doubles
from surctl.marine.control import Gains, build_law, law_source
from surctl.marine.guidance import Guidance
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.assumptions import check_alike, check_no_integral, check_sway_force, nine_decimals
from surctl.marine.verification.cruise_loop import has_cruise_loop
from surctl.marine.verification.region.steering import SteeringClaim
from surctl.marine.verification.region.turning import TurningClaim
from surctl.own_code import label

_MASSES = frozenset({"mass_share", "mass_asymmetry", "at_rest", "curvature_per_m", "speed_share"})
_HORIZONTAL = frozenset(
    {
        "ranges", "thrust_share", "asymmetry", "mass_asymmetry", "sampled", "lagged", "yaw_rate_rad_per_s", "spinning",
        "current_m_per_s", "force_n", "place_error_m", "velocity_error_m_per_s", "at_rest", "curvature_per_m",
        "attempts",
    }
)  # fmt: skip
_WITHOUT: Mapping[str, tuple[str, Set[str]]] = {
    "cruise": ("the cruise with equal masses", _MASSES),
    "turning": ("the turning loop", {"ranges", "speed_share"}),
    "steered": ("the heading loop of craft without sway force", _HORIZONTAL),
}
"""Each loop in words, and the keys that have no effect on it."""

_STEERING_GAINS = ("k_psi", "k_r", "crab_time", "sideslip", "lookahead", "k_i")


class RegionStatement(Strict):
    """A region claim without its vehicle and gains; SI units.

    Attributes:
        kind: kind of the TOML file.
        name: name of the claim.
        statement: the claim in words.
        loop: `cruise` for the exported law and equal masses in surge and sway, `turning` for the exported law and any
            masses, `steered` for the heading loop of craft without sway force under the law `steered`.
        share: relative error of mass and drag (`turning`: of drag only).
        mass_share: relative error of the masses (`turning` and `steered`).
        speed_share: largest relative deviation of the surge speed from the cruise speed (`steered` only).
        ranges: whether the ranges of the vehicle file replace `share`.
        thrust_share: largest relative reduction of the thrust limits.
        asymmetry: largest difference of a true drag coefficient between surge and sway, divided by their mean. For
            `turning`, the difference is that of the ratios of true to stated coefficient (of the two linear, and of
            the two quadratic ones).
        mass_asymmetry: largest difference of the ratios of true to stated mass in surge and in sway, divided by their
            mean (`turning` only).
        sampled, lagged: whether the control period and the vehicle's thrust lag are part of the claim.
        yaw_rate_rad_per_s: largest yaw rate.
        spinning: whether the value of the gain `spin` replaces `yaw_rate_rad_per_s`.
        cruise_m_per_s, cap_m_per_s: speed of the target point on the path, and largest commanded speed.
        rate_per_s: decay rate a of the Lyapunov function V: V̇ ≤ −a V.
        current_m_per_s: largest constant current.
        force_n: largest force of waves and thrust errors, varying arbitrarily.
        place_error_m, velocity_error_m_per_s: largest errors of measured position and velocity, varying arbitrarily.
        at_rest: whether the region must contain a vehicle at rest (`turning` only).
        curvature_per_m: largest curvature of the path (`turning` only).
        gains: gains that replace those of the gain file.
        attempts: number of start values of the search (`turning`: of convex programs).
    """

    kind: Literal["region"] = "region"
    name: StrictStr = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,59}$")
    statement: StrictStr = ""
    loop: Literal["cruise", "turning", "steered"] = "cruise"
    share: StrictFloat = Field(default=0.2, ge=0, lt=1)
    mass_share: StrictFloat = Field(default=0.05, ge=0, lt=1)
    speed_share: StrictFloat = Field(default=0.1, ge=0, lt=1)
    ranges: StrictBool = False
    thrust_share: StrictFloat = Field(default=0.0, ge=0, lt=1)
    asymmetry: StrictFloat = Field(default=0.05, ge=0, le=2)
    mass_asymmetry: StrictFloat = Field(default=0.05, ge=0, lt=2)
    sampled: StrictBool = False
    lagged: StrictBool = False
    yaw_rate_rad_per_s: StrictFloat = Field(default=0.5, ge=0)
    spinning: StrictBool = False
    cruise_m_per_s: StrictFloat = Field(default=0.15, gt=0)
    cap_m_per_s: StrictFloat = Field(default=0.22, gt=0)
    rate_per_s: StrictFloat = Field(default=0.05, gt=0)
    current_m_per_s: StrictFloat = Field(default=0.0, ge=0)
    force_n: StrictFloat = Field(default=0.0, ge=0)
    place_error_m: StrictFloat = Field(default=0.0, ge=0)
    velocity_error_m_per_s: StrictFloat = Field(default=0.0, ge=0)
    at_rest: StrictBool = False
    curvature_per_m: StrictFloat = Field(default=0.0, ge=0)
    gains: dict[str, StrictFloat] = Field(default_factory=dict)
    attempts: StrictInt = Field(default=80, ge=1)

    def require(self, law: str, guidance: Guidance = "los") -> None:
        """Raise NotApplicable unless the claim is about the loop of a law with a guidance, given by their names."""
        if self.loop == "steered":
            fits = law == "steered"
        else:  # damping in a law changes every command a little
            fits = has_cruise_loop(law, guidance) and not law_source(law).damping
        if not fits:
            raise NotApplicable(f"{self.name} is about another loop", to=f"law {label(law)} with guidance {guidance}")

    def claim(
        self, vehicle: Vehicle, gains: Gains, *, cruise: float | None = None, cap: float | None = None
    ) -> TurningClaim | SteeringClaim:
        """Return the claim for a vehicle and its gains; `cruise` and `cap` [m/s] replace the default speeds.

        If the claim file sets one of the two speeds, both remain as the file states them.

        Raises:
            InputError: a gain is unknown, the cruise speed is not below the cap, or the file sets a key that its loop
                does not use.
            NotApplicable: the vehicle or the gains violate an assumption of the claim.
        """
        own = {key for key in ("cruise_m_per_s", "cap_m_per_s") if key in self.model_fields_set}
        cruise = self.cruise_m_per_s if cruise is None or own else cruise
        cap = self.cap_m_per_s if cap is None or own else cap
        if own and cruise >= cap:  # a mistake in the claim file, not in the caller's speeds
            raise InputError(
                "must be below the cap on commanded speed", key="cruise", value=cruise, remedy="raise the cap"
            )
        if self.loop == "steered":
            gains = gains.with_own({**gains.own, **law_source("steered").gains})
        gains = replace(gains, source="").with_values(self.gains)  # a message must not name the gain file
        if self.loop == "cruise":  # surge and sway are alike, and both masses are off by the same factor
            check_alike(vehicle, ranges=self.ranges)
        self._check_keys()
        claim = self._steered if self.loop == "steered" else self._turning
        return claim(vehicle, gains, cruise, cap)

    def _check_keys(self) -> None:
        """Raise InputError for a key with another value than its default that this loop does not use."""
        loop, without = _WITHOUT[self.loop]
        for key in sorted(self.model_fields_set & without):
            if getattr(self, key) != type(self).model_fields[key].default:
                raise InputError(f"has no effect on {loop}", key=key, value=getattr(self, key), remedy="leave it out")

    def _turning(self, vehicle: Vehicle, gains: Gains, cruise: float, cap: float) -> TurningClaim:
        check_sway_force(vehicle)
        if vehicle.form.tilts:
            raise NotApplicable("it rolls and pitches, and the claim is about motion in the horizontal plane")
        if by_surge := [name for axis, name in vehicle.form.ahead() if axis == 1]:
            raise NotApplicable(
                f"it has {by_surge[0]}, and the law's model of the sway drag depends on the cruise speed"
            )
        check_no_integral(gains)
        drag = None if self.ranges else self.share
        mass, apart = (drag, 0.0) if self.loop == "cruise" else (self.mass_share, self.mass_asymmetry)
        limits, law = vehicle.thrust_limit * (1 - self.thrust_share), build_law()
        return TurningClaim(
            name=self.name,
            mass_factor=_factors(vehicle, mass, "m11", "m22"),
            drag_factor=_factors(vehicle, drag, "Xu", "Yv", "Xuu", "Yvv"),
            mass_asymmetry=apart if mass != 0 else 0.0,
            drag_asymmetry=self.asymmetry if drag != 0 else 0.0,
            thrust=(nine_decimals(limits[0], up=False), nine_decimals(limits[1], up=False)),
            yaw_limit=float(limits[3]),
            yaw_rate=gains["spin"] if self.spinning else self.yaw_rate_rad_per_s,
            mass=(vehicle["m11"], vehicle["m22"]),
            linear=(vehicle["Xu"], vehicle["Yv"]),
            quadratic=(vehicle["Xuu"], vehicle["Yvv"]),
            gains={key: gains[key] for key in ("k1", "lookahead", "k_v", "k_i", "wait")},
            cruise=cruise,
            cap=cap,
            rate=self.rate_per_s,
            rest=self.at_rest,
            digests=(vehicle.digest(), law.block.digest()),
            terms={name: vehicle[name] for name in vehicle.form.terms},
            curvature=self.curvature_per_m,
            current=self.current_m_per_s,
            lag=vehicle["thrust_lag"] if self.lagged else 0.0,
            period=law.dt if self.sampled else 0.0,
            force=self.force_n,
            place_error=self.place_error_m,
            velocity_error=self.velocity_error_m_per_s,
        )

    def _steered(self, vehicle: Vehicle, gains: Gains, cruise: float, cap: float) -> SteeringClaim:
        if vehicle["Fv_max"] > 0:
            raise NotApplicable("it has a sway force, and the claim is about craft that are steered by their heading")
        if 0 < round(vehicle.fin_share(cruise), 12) < 1:
            raise NotApplicable("it steers by fins and thrusters together, which the claim does not cover")
        if vehicle.form.tilts:
            raise NotApplicable("it rolls and pitches, and the claim is about motion in the horizontal plane")
        check_no_integral(gains)
        claim = SteeringClaim(
            name=self.name,
            mass_factor=_factors(vehicle, self.mass_share),
            drag_factor=_factors(vehicle, self.share),
            speed=(round(cruise * (1 - self.speed_share), 9), round(cruise * (1 + self.speed_share), 9)),
            vehicle=vehicle,
            gains={key: gains[key] for key in _STEERING_GAINS},
            cruise=cruise,
            cap=cap,
            rate=self.rate_per_s,
            digest=build_law("steered").block.digest(),
        )
        claim.dynamics()
        return claim


def _factors(vehicle: Vehicle, share: float | None, *names: str) -> tuple[float, float]:
    """Return 1 ± a share; without one, the ranges of the named parameters relative to their values."""
    if share is not None:
        return round(1 - share, 9), round(1 + share, 9)
    stated = [(vehicle[name], vehicle.parameters[name].range) for name in names if vehicle[name]]
    ends = [end / value for value, known in stated for end in (known or (value, value))]
    return float(np.floor(1e9 * min(ends)) / 1e9), float(np.ceil(1e9 * max(ends)) / 1e9)


def load_region(path: Path) -> RegionStatement:
    """Read a region claim from a TOML file.

    ::

        kind = "region"
        name = "my-region"
        share = 0.3                # mass and drag uncertain by ±30 %; `ranges = true` takes those of the vehicle file
        force_n = 0.2              # largest force of waves and thrust errors
        rate_per_s = 0.01
        [gains]                    # gains that replace those of the gain file
        k_v = 0.5

    Every key is an attribute of `RegionStatement`; a key that is left out has its default value.

    Raises:
        InputError: the file is not a region claim; the message names file, key, value and remedy.
    """
    statement = load_model(path, RegionStatement)
    require_doubles(path)
    return statement


def write_region(statement: RegionStatement) -> str:
    """Return the statement as TOML text with every key; `load_region` reads this text back without change."""

    def literal(value: object) -> str:
        if isinstance(value, bool):
            return str(value).lower()
        return quoted(value) if isinstance(value, str) else repr(value)

    plain = {key: value for key, value in statement.model_dump().items() if key != "gains"}
    _, without = _WITHOUT[statement.loop]
    lines = [f"{key} = {literal(value)}" for key, value in plain.items() if key not in without]
    if statement.gains:
        lines += ["", "[gains]", *(f"{key} = {value!r}" for key, value in statement.gains.items())]
    return "\n".join(lines) + "\n"
