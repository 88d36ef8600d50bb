"""The heading-steered loop of eight states: the claim about it, and its matrices in floating point for the search.

The matrices are those of `surctl.certcheck.heading_cells` in the middle of a cell. In the path frame, the state is
ξ = (x − x*, y, ψ, U_x − v, U_y, r), where x* is the steady along-track error and v the cruise speed; the heave states
(z, w) are decoupled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.heading_cells import rows
from surctl.certcheck.heading_claim import EXCLUDES, read_claim
from surctl.certcheck.heading_claim import HeadingClaim as Checked
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.assumptions import check_alike

Array = NDArray[np.float64]
Range = tuple[float, float]

HEADING_GAINS: Mapping[str, float] = {
    "k1": 0.15, "k_z": 0.15, "lookahead": 1.2, "k": 0.35, "k_psi": 0.8, "k_r": 1.5, "cruise": 0.15,
}  # fmt: skip
"""Gains of the heading-steered loop, which is softer than the exported law [1/s, 1/s, m, 1/s, 1/s, 1/s, m/s]."""

_NUMBERS = {
    "mass_kg": "m11", "heave_mass_kg": "m33", "yaw_inertia_kg_m2": "m44", "surge_linear": "Xu",
    "surge_quadratic": "Xuu", "sway_linear": "Yv", "sway_quadratic": "Yvv", "heave_linear": "Zw",
    "heave_quadratic": "Zww", "yaw_linear": "Nr", "yaw_quadratic": "Nrr",
}  # fmt: skip
_THRUST = {"surge_n": "Fu_max", "sway_n": "Fv_max", "heave_n": "Fw_max", "yaw_nm": "Fr_max"}


@dataclass(frozen=True)
class HeadingClaim:
    """Claim about the heading-steered loop, for all vehicle parameters in given ranges.

    All quantities are in SI units; pairs are (least, largest).

    Attributes:
        name: name of the claim.
        ranges: range of each true vehicle parameter, by its name in the certificate.
        limits: least thrust limit of each axis.
        law: mass and drag in the law's model, and the law's gains.
        rate: decay rate a [1/s] of the Lyapunov function V: V̇ ≤ −a V.
        digest: SHA-256 of the vehicle's parameters.
    """

    name: str
    ranges: Mapping[str, Range]
    limits: Mapping[str, float]
    law: Mapping[str, float]
    rate: float
    digest: str

    @cached_property
    def read(self) -> Checked:
        """Return the claim as the checker reads it, without stated offsets."""
        return read_claim(self.document(offset=1.0, beside=1.0, extent=(1.0, 1.0, 1.0), depth=1.0, ultimate_bound=1.0))

    @property
    def velocity_gain(self) -> float:
        """Return the product of mass and velocity gain k in the law's model [N s/m]."""
        return float(self.read.velocity_gain)

    @property
    def command(self) -> Range:
        """Return the least and the largest surge command [m/s] of a vehicle at rest relative to the target."""
        low, high = self.read.command
        return float(low), float(high)

    def document(
        self, *, offset: float, beside: float, extent: tuple[float, ...], depth: float, ultimate_bound: float
    ) -> dict[str, Any]:
        """Return the claim as data of a certificate."""
        return {
            "system": "heading",
            "excludes": list(EXCLUDES),
            "vehicle": {**{k: list(v) for k, v in self.ranges.items()}, "limits": dict(self.limits)},
            "law": dict(self.law),
            "motion": {
                "rate_per_s": self.rate, "offset_m": offset, "beside_m": beside, "extent": list(extent),
                "depth_m": depth, "ultimate_bound_m": ultimate_bound,
            },
            "sha256_vehicle": self.digest,
        }  # fmt: skip


def heading_claim(
    name: str,
    vehicle: Vehicle,
    *,
    share: float | None = 0.2,
    thrust_share: float = 0.0,
    rate: float = 0.05,
    gains: Mapping[str, float] = HEADING_GAINS,
) -> HeadingClaim:
    """Return the claim about a vehicle under the heading-steered law.

    Args:
        name: name of the claim.
        vehicle: the vehicle that the law's model describes; its masses in surge and sway must be equal.
        share: relative error of every parameter; None takes the ranges of the vehicle file.
        thrust_share: largest relative reduction of the thrust limits.
        rate: decay rate of the Lyapunov function V [1/s].
        gains: gains of the loop.

    Raises:
        NotApplicable: the masses of surge and sway differ.
    """
    check_alike(vehicle, mass_alone=True, ranges=share is None)
    ranges = {}
    for key, symbol in _NUMBERS.items():
        value, known = vehicle[symbol], vehicle.parameters[symbol].range
        if share is not None:
            ranges[key] = (round(value * (1 - share), 9), round(value * (1 + share), 9))
        else:
            ranges[key] = (value, value) if known is None else (float(known[0]), float(known[1]))
    return HeadingClaim(
        name=name,
        ranges=ranges,
        limits={key: round(vehicle[symbol] * (1 - thrust_share), 9) for key, symbol in _THRUST.items()},
        law={
            "mass_kg": vehicle["m11"], "heave_mass_kg": vehicle["m33"], "yaw_inertia_kg_m2": vehicle["m44"],
            "linear_drag": vehicle["Xu"], "quadratic_drag": vehicle["Xuu"], **gains,
        },
        rate=rate,
        digest=vehicle.digest(),
    )  # fmt: skip


@dataclass(frozen=True)
class Limits:
    """Bounds at n points: on surge speed minus cruise speed, sway speed and yaw rate, and on the thrust shares.

    The thrust share φ of an axis is the deviation of the thrust from its value at cruise after saturation, divided by
    that before saturation (1: no saturation); `shares` holds the least values of φ for surge, sway and yaw.
    """

    surge: Array
    sway: Array
    turn: Array
    shares: tuple[Array, Array, Array]


def rows_at(claim: HeadingClaim, psi: Array, y: Array) -> tuple[Array, Array, list[Array], Array]:
    """Return rows (n, 6) that map the state ξ to speeds, surge force and yaw moment at n points (ψ, y).

    The rows give surge speed minus cruise speed, sway speed, surge force [N] for both extreme surge commands at rest,
    and yaw moment [N m].
    """
    at = rows(claim.law, claim.command, psi, y, np.zeros(2))
    forces = [claim.velocity_gain * (place.mid - at.surge.mid) for place in at.place]
    return at.surge.mid, at.sway.mid, forces, at.yaw.mid


def loops_at(claim: HeadingClaim, psi: Array, y: Array, limits: Limits) -> Array:
    """Return the state matrices A (k, 6, 6) at all vertices of the parameter ranges and all points (ψ, y).

    The order is fixed, and some matrices may be equal.
    """
    ranges, v, velocity_gain = claim.ranges, claim.law["cruise"], claim.velocity_gain
    one = np.ones(len(psi))
    drag = (
        ranges["surge_linear"][0] + ranges["surge_quadratic"][0] * np.maximum(0.828 * v, 2 * v - limits.surge),
        ranges["surge_linear"][1] + ranges["surge_quadratic"][1] * (2 * v + limits.surge),
    )
    held = (
        velocity_gain * limits.shares[1] + ranges["sway_linear"][0],
        velocity_gain + ranges["sway_linear"][1] + ranges["sway_quadratic"][1] * limits.sway,
    )
    spin = (ranges["yaw_linear"][0] * one, ranges["yaw_linear"][1] + ranges["yaw_quadratic"][1] * limits.turn)
    c, s, eye = np.cos(psi), np.sin(psi), np.eye(6)
    ahead, abeam = (np.stack([a, b], 1)[:, :, None] for a, b in ((c, s), (-s, c)))
    matrices = []
    surge, sway, forces, yaw = rows_at(claim, psi, y)
    for force in forces:
        for mass, pu, du, stiff in product(sorted(set(ranges["mass_kg"])), (limits.shares[0], one), drag, held):
            moved = ahead * (pu[:, None] * force - du[:, None] * surge)[:, None]
            moved = moved - abeam * (stiff[:, None] * sway)[:, None]
            for inertia, pr, dr in product(sorted(set(ranges["yaw_inertia_kg_m2"])), (limits.shares[2], one), spin):
                A = np.zeros((len(psi), 6, 6))
                A[:, 0, 3] = A[:, 1, 4] = A[:, 2, 5] = 1
                A[:, 3:5] = moved / mass
                A[:, 5] = (pr[:, None] * yaw - dr[:, None] * eye[5]) / inertia
                matrices.append(A)
    return np.concatenate(matrices)
