"""Reader of the claim of a certificate of the heading-steered loop; it rejects missing and unknown keys."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from surctl.certcheck.document import Rejected, record
from surctl.certcheck.region_claim import Pair, number, ordered

__all__ = ["EXCLUDES", "HeadingClaim", "read_claim"]

EXCLUDES = (
    "the path is one straight leg, and its target moves along it at the cruise speed",
    "surge and sway have the same mass; heave, roll and pitch are not coupled to the other motions",
    "the surge command is (11) as printed: it may have either sign and has no speed cap",
    "the law is the paper's, which steers by heading; the exported law steers by velocity",
    "there is no obstacle, wall or unknown area; no inequality constraint of the priority problem is active",
    "measured pose and velocity are exact; thrust has no lag, and commands are not held for a control period",
    "the water is at rest; there are no waves and no thrust bias",
)
"""Restrictions of the claim; a certificate repeats the restrictions word for word."""

_RANGES = (
    "mass_kg", "heave_mass_kg", "yaw_inertia_kg_m2", "surge_linear", "surge_quadratic", "sway_linear",
    "sway_quadratic", "heave_linear", "heave_quadratic", "yaw_linear", "yaw_quadratic",
)  # fmt: skip
_LIMITS = ("surge_n", "sway_n", "heave_n", "yaw_nm")
_LAW = (
    "mass_kg", "heave_mass_kg", "yaw_inertia_kg_m2", "linear_drag", "quadratic_drag", "k1", "k_z", "lookahead", "k",
    "k_psi", "k_r", "cruise",
)  # fmt: skip


@dataclass(frozen=True)
class HeadingClaim:
    """The claim about the heading-steered loop; SI units.

    Attributes:
        ranges: (least, largest) of each true vehicle parameter, by its name in the certificate.
        limits: least thrust limit of each body axis.
        law: mass and drag in the law's model, and the law's gains.
        rate: decay rate a of V̇ ≤ −a V [1/s].
        offset: the region contains every |y_e| ≤ offset [m] at x_e = 0, with the heading along the path and the
            target's velocity.
        beside: the region contains every |y_e| ≤ beside [m] at x_e = x*, where the vehicle comes to rest.
        extent: largest values of |x|, |y| [m] and |ψ| [rad] in the region.
        depth: the region contains every |z_e| ≤ depth [m] at zero heave velocity.
        ultimate_bound: largest |x_e| [m] at rest; the deviations y_e, z_e and ψ go to 0.
    """

    ranges: Mapping[str, Pair]
    limits: Mapping[str, Fraction]
    law: Mapping[str, Fraction]
    rate: Fraction
    offset: Fraction
    beside: Fraction
    extent: tuple[Fraction, Fraction, Fraction]
    depth: Fraction
    ultimate_bound: Fraction

    @property
    def velocity_gain(self) -> Fraction:
        """Return the gain from velocity error to thrust in the law, m k [N s/m]."""
        return self.law["mass_kg"] * self.law["k"]

    @property
    def trim(self) -> Pair:
        """Return the least and the largest surge drag at the cruise speed [N]."""
        v = self.law["cruise"]
        low, high = (self.ranges["surge_linear"][i] * v + self.ranges["surge_quadratic"][i] * v * v for i in (0, 1))
        return low, high

    @property
    def command(self) -> Pair:
        """Return the least and the largest surge command [m/s] of a vehicle at rest relative to the target."""
        v = self.law["cruise"]
        fed = self.law["linear_drag"] * v + self.law["quadratic_drag"] * v * v
        low, high = (v + (trim - fed) / self.velocity_gain for trim in self.trim)
        return low, high


def read_claim(claim: Any) -> HeadingClaim:
    """Return the claim of a certificate.

    Raises:
        Rejected: a key is missing or unknown, a number has the wrong type or sign, or the stated restrictions are not
            those of this kind of claim.
    """
    top = record(claim, ("system", "excludes", "vehicle", "law", "motion", "sha256_vehicle"), "claim")
    if top["system"] != "heading":
        raise Rejected(f"claim.system {top['system']!r} is not known; known: heading")
    if top["excludes"] != list(EXCLUDES):
        raise Rejected("claim.excludes differs from the text that this checker expects")
    if not isinstance(top["sha256_vehicle"], str) or not re.fullmatch("[0-9a-f]{64}", top["sha256_vehicle"]):
        raise Rejected("claim.sha256_vehicle is not a SHA-256")
    vehicle = record(top["vehicle"], (*_RANGES, "limits"), "claim.vehicle")
    limits = record(vehicle["limits"], _LIMITS, "claim.vehicle.limits")
    law = record(top["law"], _LAW, "claim.law")
    motion = record(
        top["motion"], ("rate_per_s", "offset_m", "beside_m", "extent", "depth_m", "ultimate_bound_m"), "claim.motion"
    )
    ranges = {}
    for key in _RANGES:
        ranges[key] = ordered(vehicle[key], f"claim.vehicle.{key}", above=key.endswith(("_kg", "_m2")))
    extent = motion["extent"]
    if not isinstance(extent, list) or len(extent) != 3:
        raise Rejected("claim.motion.extent must be [x, y, psi]")
    x, y, psi = (number(entry, "claim.motion.extent", above=True) for entry in extent)
    drag = ("linear_drag", "quadratic_drag")
    return HeadingClaim(
        ranges=ranges,
        limits={key: number(limits[key], f"claim.vehicle.limits.{key}", above=True) for key in _LIMITS},
        law={key: number(law[key], f"claim.law.{key}", above=key not in drag) for key in _LAW},
        rate=number(motion["rate_per_s"], "claim.motion.rate_per_s", above=True),
        offset=number(motion["offset_m"], "claim.motion.offset_m", above=True),
        beside=number(motion["beside_m"], "claim.motion.beside_m", above=True),
        extent=(x, y, psi),
        depth=number(motion["depth_m"], "claim.motion.depth_m", above=True),
        ultimate_bound=number(motion["ultimate_bound_m"], "claim.motion.ultimate_bound_m"),
    )
