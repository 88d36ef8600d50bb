"""Claim about the heading loop of a craft without sway force under the law `steered`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from surctl.certcheck import Rejected
from surctl.certcheck.steering_claim import EXCLUDES, read_claim
from surctl.certcheck.steering_claim import SteeringClaim as Stated
from surctl.errors import InputError, NotApplicable
from surctl.marine.control import Gains, build_law, law_source
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.assumptions import check_no_integral

__all__ = ["SteeringClaim", "side_per_moment", "steering_claim"]

Pair = tuple[float, float]

_GAINS = ("k_psi", "k_r", "crab_time", "sideslip", "lookahead")


@dataclass(frozen=True)
class SteeringClaim:
    """Claim about the heading loop of a craft under the law `steered`, for all parameters in given ranges; SI units.

    Attributes:
        name: name of the claim.
        mass_factor, drag_factor: (least, largest) factor of each entry of the inertia matrix, and of each drag
            coefficient.
        speed: (least, largest) surge speed.
        vehicle: the craft.
        gains: the gains k_psi, k_r, crab_time, sideslip, lookahead and k_i of the law.
        cruise, cap: cruise speed and largest commanded speed.
        rate: decay rate a of the Lyapunov function V: V̇ ≤ −a V.
        digest: SHA-256 of the law's instruction list.
    """

    name: str
    mass_factor: Pair
    drag_factor: Pair
    speed: Pair
    vehicle: Vehicle
    gains: Mapping[str, float]
    cruise: float
    cap: float
    rate: float
    digest: str = field(default="0" * 64)

    def document(self, *, offset: float) -> dict[str, Any]:
        """Return the claim as data of a certificate. `offset` [m] is the distance beside the path that it states."""
        craft = self.vehicle.at_speed(self.cruise)
        return {
            "system": "steered",
            "excludes": list(EXCLUDES),
            "vehicle": {
                "mass_factor": list(self.mass_factor),
                "drag_factor": list(self.drag_factor),
                "speed_m_per_s": list(self.speed),
                "linear_drag": [craft["Yv"], craft["Nr"]],
                "terms": {name: craft[name] for name in craft.form.terms},
                "moment_nm": float(craft.thrust_limit[3]),
                "side_per_m": side_per_moment(craft),
            },
            "law": {
                "mass": [craft["m11"], craft["m22"], craft["m44"]],
                "linear_drag": [float(n) for n in craft.drag_at(self.cruise)[[1, 3]]],
                "quadratic_drag": [craft["Yvv"], craft["Nrr"]],
                "fin_share": round(craft.fin_share(self.cruise), 12),
                "munk": craft.munk(self.cruise),
                "centripetal": craft.centripetal(self.cruise),
                **{key: self.gains[key] for key in (*_GAINS, "k_i")},
                "cruise": self.cruise,
                "cap": self.cap,
            },
            "motion": {"rate_per_s": self.rate, "offset_m": offset},
            "sha256_vehicle": self.vehicle.digest(),
            "sha256_law": self.digest,
        }

    def stated(self) -> Stated:
        """Return the claim as the checker reads it.

        Raises:
            NotApplicable: the craft has a term that the proof does not cover.
        """
        try:
            return read_claim(self.document(offset=1.0))
        except Rejected as reason:
            raise NotApplicable(str(reason).removeprefix("claim.vehicle.terms: ")) from None


def steering_claim(
    name: str,
    vehicle: Vehicle,
    gains: Gains,
    *,
    share: float = 0.2,
    mass_share: float = 0.025,
    speed_share: float = 0.1,
    cruise: float = 0.15,
    cap: float = 0.22,
    rate: float = 0.02,
) -> SteeringClaim:
    """Return the claim about the heading loop of a craft without sway force under the law `steered`.

    Args:
        name: name of the claim.
        vehicle: the craft that the law's model describes.
        gains: gains of the law, with or without its own ones.
        share: relative error of each drag coefficient.
        mass_share: relative error of each entry of the inertia matrix.
        speed_share: largest relative deviation of the surge speed from the cruise speed.
        cruise, cap: cruise speed and largest commanded speed [m/s].
        rate: decay rate of the Lyapunov function V [1/s].

    Raises:
        NotApplicable: the vehicle has a sway force, or terms that the proof does not cover, or integral action is on.
        InputError: the rate is not positive.
    """
    if vehicle["Fv_max"] > 0:
        raise NotApplicable("it has a sway force, and the claim is about craft that are steered by their heading")
    if 0 < round(vehicle.fin_share(cruise), 12) < 1:
        raise NotApplicable("it steers by fins and thrusters together, which the claim does not cover")
    if vehicle.form.tilts:
        raise NotApplicable("it rolls and pitches, and the claim is about motion in the horizontal plane")
    if not rate > 0:
        raise InputError("must be greater than 0", key="rate", value=rate, remedy="correct it")
    check_no_integral(gains)
    whole = gains.with_own(law_source("steered").gains)
    claim = SteeringClaim(
        name=name,
        mass_factor=(round(1 - mass_share, 9), round(1 + mass_share, 9)),
        drag_factor=(round(1 - share, 9), round(1 + share, 9)),
        speed=(round(cruise * (1 - speed_share), 9), round(cruise * (1 + speed_share), 9)),
        vehicle=vehicle,
        gains={key: whole[key] for key in (*_GAINS, "k_i")},
        cruise=cruise,
        cap=cap,
        rate=rate,
        digest=build_law("steered").block.digest(),
    )
    claim.stated()
    return claim


def side_per_moment(craft: Vehicle) -> float:
    """Return the sway force of the fins for each N m of their yaw moment [1/m]; 0 without fins."""
    if craft.actuators is None or not craft.actuators.fins:
        return 0.0
    columns = [craft.actuators.matrix[:, craft.actuators.slices[k]] for k in craft.actuators.fins]
    ratios = {round(float(y / n), 9) for column in columns for y, n in column[[1, 3]].T if n}
    if len(ratios) != 1:
        raise NotApplicable("its fins are not at one place along the hull, so that their side force has no fixed share")
    return ratios.pop()
