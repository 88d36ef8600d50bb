"""Reader of the claim of a `steering` certificate: the heading loop of a craft without sway force."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from surctl.certcheck.document import Rejected, record
from surctl.certcheck.region_claim import number, read_top
from surctl.certcheck.turning_claim import read_terms

__all__ = ["EXCLUDES", "STATES", "SteeringClaim", "read_claim"]

Pair = tuple[Fraction, Fraction]

STATES = ("y_e", "heading", "sway", "yaw_rate", "crab", "sway_model")
"""The states: cross-track error [m], heading to the path [rad], sway speed [m/s], yaw rate [rad/s], and the two filters
of the law: crab angle [rad] and modelled sway speed [m/s]."""

EXCLUDES = (
    "the path is one straight leg, on which the law commands a positive speed; guidance is los",
    "no obstacle is near, so that the law chooses the desired course and speed",
    "the surge loop is not covered: the surge speed, and that of the law's model, may vary in any way within "
    "speed_m_per_s",
    "measured position, heading and velocity are exact; there is no current and no wave",
    "the thrusters deliver every commanded yaw moment up to moment_nm, whatever the surge force; fins do so up to the "
    "share (speed / cruise)^2 of it below the cruise speed, with the side force of side_per_m times the moment",
    "the thrust has no lag; commands are not held, and the two filters of the law are continuous in time",
    "heave is 0, and roll and pitch are left out",
)
"""Restrictions of the claim; a certificate repeats the restrictions word for word."""


@dataclass(frozen=True)
class SteeringClaim:
    """Claim about the heading loop of the law `steered`; SI units, pairs are (least, largest) but where said.

    A true parameter is its value times a factor, which may differ from one parameter to the next and may vary in time.

    Attributes:
        mass_factor: range of the factors of m11, m22, m24 and m44.
        drag_factor: range of the factors of all drag coefficients.
        speed: range of the surge speed.
        mass: m11, m22, m44 in the law's model, and of the vehicle before its factor.
        linear, quadratic: drag (sway, yaw) in the law's model.
        vehicle_linear: linear drag (sway, yaw) of the vehicle before its factor.
        terms: the vehicle's terms beside equation (3), by name.
        moment: largest yaw moment of the thrusters and of the law [N m]; that of fins holds at the cruise speed.
        finned: whether the yaw moment is that of fins, which grows with the square of the surge speed.
        side: sway force for each N m of yaw moment [1/m], with its sign; 0 without fins.
        munk, centripetal: the law's yaw moment by u v and its sway force by u r [kg].
        k_psi, k_r, crab_time, sideslip, lookahead: the law's gains of these names.
        cruise, cap: cruise speed and largest commanded speed.
        rate: decay rate a of V̇ ≤ −a V [1/s].
        offset: the region contains the points with |y_e| = offset, and 0 for all other states.
    """

    mass_factor: Pair
    drag_factor: Pair
    speed: Pair
    mass: tuple[Fraction, Fraction, Fraction]
    linear: Pair
    quadratic: Pair
    vehicle_linear: Pair
    terms: Mapping[str, Fraction]
    moment: Fraction
    finned: bool
    side: Fraction
    munk: Fraction
    centripetal: Fraction
    k_psi: Fraction
    k_r: Fraction
    crab_time: Fraction
    sideslip: Fraction
    lookahead: Fraction
    cruise: Fraction
    cap: Fraction
    rate: Fraction
    offset: Fraction


def _numbers(value: Any, where: str, count: int, *, above: bool = False) -> list[Fraction]:
    if not isinstance(value, list) or len(value) != count:
        raise Rejected(f"{where} must have {count} entries")
    return [number(entry, where, above=above) for entry in value]


def _range(value: Any, where: str) -> Pair:
    low, high = _numbers(value, where, 2, above=True)
    if low > high:
        raise Rejected(f"{where}: the least value exceeds the largest")
    return low, high


def read_claim(claim: Any) -> SteeringClaim:
    """Return the claim of a certificate.

    Raises:
        Rejected: a key is missing or unknown, a number has the wrong type or sign, the vehicle has a term that the
            proof does not know, or the stated restrictions are not those of this kind of claim.
    """
    top = read_top(claim, "steered", EXCLUDES)
    vehicle = record(
        top["vehicle"],
        ("mass_factor", "drag_factor", "speed_m_per_s", "linear_drag", "terms", "moment_nm", "side_per_m"),
        "claim.vehicle",
    )
    gains = ("k_psi", "k_r", "crab_time", "sideslip", "lookahead", "cruise", "cap")
    law = record(
        top["law"],
        ("mass", "linear_drag", "quadratic_drag", "k_i", "fin_share", "munk", "centripetal", *gains),
        "claim.law",
    )
    motion = record(top["motion"], ("rate_per_s", "offset_m"), "claim.motion")
    if number(law["k_i"], "claim.law.k_i"):
        raise Rejected("claim.law.k_i must be 0: the certified loop has no integral action")
    share = number(law["fin_share"], "claim.law.fin_share")
    side = number(vehicle["side_per_m"], "claim.vehicle.side_per_m", least=-(10**9))
    if share not in (0, 1) or bool(share) != bool(side):
        raise Rejected("claim.law.fin_share must be 0 without a side force, or 1 with it: fins and thrusters together "
                       "are not covered")  # fmt: skip
    terms = read_terms(vehicle["terms"])
    for name, value in terms.items():
        if value and (name in ("m12", "m14", "Y0", "N0") or (name[0] in "YN" and name[-1] == "u")):
            raise Rejected(f"claim.vehicle.terms: {name} is not covered")
    mass = _numbers(law["mass"], "claim.law.mass", 3, above=True)
    linear, quadratic = (_numbers(law[key], f"claim.law.{key}", 2) for key in ("linear_drag", "quadratic_drag"))
    own = _numbers(vehicle["linear_drag"], "claim.vehicle.linear_drag", 2)
    return SteeringClaim(
        mass_factor=_range(vehicle["mass_factor"], "claim.vehicle.mass_factor"),
        drag_factor=_range(vehicle["drag_factor"], "claim.vehicle.drag_factor"),
        speed=_range(vehicle["speed_m_per_s"], "claim.vehicle.speed_m_per_s"),
        mass=(mass[0], mass[1], mass[2]),
        linear=(linear[0], linear[1]),
        quadratic=(quadratic[0], quadratic[1]),
        vehicle_linear=(own[0], own[1]),
        terms=terms,
        moment=number(vehicle["moment_nm"], "claim.vehicle.moment_nm", above=True),
        finned=bool(share),
        side=side,
        munk=number(law["munk"], "claim.law.munk", least=-(10**9)),
        centripetal=number(law["centripetal"], "claim.law.centripetal", above=True),
        **{key: number(law[key], f"claim.law.{key}", above=True) for key in gains},
        rate=number(motion["rate_per_s"], "claim.motion.rate_per_s", above=True),
        offset=number(motion["offset_m"], "claim.motion.offset_m", above=True),
    )
