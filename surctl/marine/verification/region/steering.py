"""Claim `region-steered-20` about the heading loop of a craft without sway force: ranges, fins, dynamics.

The claim is one of kind `lyapunov`, and the slope rule finds and proves its region. Its dynamics are the texts of the
checker (`surctl.certcheck.steering`), which the checker compares with the law. In a region with small heading errors
(`SteeringClaim.largest_level`), `planned_yaw_rate` alone limits the yaw rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.steering import STEERED, STEERED_EXCLUDES, heading_loop
from surctl.errors import NotApplicable
from surctl.lyapunov.dynamics import Dynamics, Range, State
from surctl.marine.control.steering import steering_of, yaw_moment
from surctl.marine.vehicle import Vehicle
from surctl.verification.formula import parse, variable

Array = NDArray[np.float64]
Pair = tuple[float, float]

_BOX = {"y_e": 0.9, "psi": 1.2, "v": 0.6, "r": 1.5, "crab": 1.0, "sway": 0.6}
"""Bounds of the states in which a region is searched: y_e in look-ahead distances, speeds in cruise speeds."""


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

    def dynamics(self) -> Dynamics:
        """Return the loop in y_e, heading, sway speed, yaw rate, and the law's filters of crab angle and sway speed.

        Raises:
            NotApplicable: the craft has a term that the claim does not cover.
        """
        craft, p = self.vehicle.at_speed(self.cruise), self._law_numbers()
        known = {name: craft[name] for name in craft.form.terms}
        for name, value in known.items():
            if value and (name in ("m12", "m14", "Y0", "N0") or (name[0] in "YN" and name[-1] == "u")):
                raise NotApplicable(f"{name} is not covered")
        side = side_per_moment(craft)
        ranges = dict.fromkeys(("u", "u_model")[: 1 + bool(side)], self.speed)  # a law for fins has its own model
        own = [(name, self.mass_factor) for name in ("m11", "m22", "m44", "m24")]
        own += [
            (name, self.drag_factor) for force in "YN" for speed in "vr" for name in (*_OWN, *sorted(known))
            if name[0] == force and name[-1] == speed and name[1:-1] in ("", "u", "v", "r")
        ]  # fmt: skip
        for name, factors in own:
            if value := craft[name] if name in (*known, *_OWN) else 0.0:
                ends = value * factors[0], value * factors[1]
                ranges[name] = min(ends), max(ends)
        # the speed cap leaves a share of the modelled sway speed
        least = self.cap / np.hypot(self.cap, _BOX["sway"] * self.cruise)
        ranges["share"] = float(np.floor(1e4 * least) / 1e4), 1.0
        texts = heading_loop(p, ranges, side)
        nodes = {name: variable(name) for name in (*_BOX, *ranges)}
        units = {"y_e": float(steering_of(_symbols(p)).lookahead), "v": self.cruise, "sway": self.cruise}
        return Dynamics(
            self.name, "continuous",
            tuple(State(k, -end * units.get(k, 1.0), end * units.get(k, 1.0), STEERED[k]) for k, end in _BOX.items()),
            tuple(parse(texts[name], nodes) for name in _BOX),
            tuple(Range(name, float(low), float(high)) for name, (low, high) in ranges.items()),
            about={
                "system": "steered", "excludes": list(STEERED_EXCLUDES), "sha256_law": self.digest,
                "sha256_vehicle": self.vehicle.digest(),
            },
        )  # fmt: skip

    def largest_level(self, p: Array) -> float:
        """Return the level ≤ 1 of ξᵀ p ξ up to which the law limits the yaw rate by `planned_yaw_rate` alone.

        The law limits it also to what half the yaw moment can end, which is more than k_psi times a small heading
        error, and which the dynamics do not contain.

        Args:
            p: matrix (6, 6) of a region ξᵀ p ξ ≤ 1.
        """
        numbers, inverse = _symbols(self._law_numbers()), np.linalg.inv(p)
        most = float(yaw_moment(numbers, ca.SX(self.speed[0])) / (numbers["mass"][3] * numbers["k_psi"] ** 2))
        ahead, beside = float(steering_of(numbers).lookahead), np.sqrt(inverse[0, 0])
        rows = np.array([[slope, 1, 0, 0, 1, 0] for slope in (np.arctan(beside / ahead) / beside, 1 / ahead)])
        error = np.sqrt(np.einsum("ki,ij,kj->k", rows, inverse, rows).max())
        return float(min(1.0, (most / error) ** 2))

    def _law_numbers(self) -> dict[str, list[float]]:
        """Return the law's parameters by name, as far as the heading loop needs them."""
        craft = self.vehicle.at_speed(self.cruise)
        own = {name: getattr(craft, name) for name in ("mass", "quadratic_drag", "thrust_limit")}
        own |= {name: getattr(craft, name)(self.cruise) for name in ("fin_share", "munk", "centripetal")}
        own |= {"linear_drag": craft.drag_at(self.cruise), "cruise": self.cruise, "cap": self.cap}
        zeros = dict.fromkeys(("k_v", "wait", "brake", "ahead_limit"), 0.0)
        whole = {**zeros, **self.gains, **own}
        return {name: np.atleast_1d(value).astype(float).tolist() for name, value in whole.items()}


def _symbols(numbers: Mapping[str, Sequence[float]]) -> dict[str, ca.SX]:
    return {name: ca.SX(ca.DM(value)) for name, value in numbers.items()}


_OWN = ("m11", "m22", "m44", "Yv", "Yvv", "Nr", "Nrr")
"""The parameters of equation (3) in the heading loop."""


def side_per_moment(craft: Vehicle) -> float:
    """Return the sway force of the fins for each N m of their yaw moment [1/m]; 0 without fins."""
    if craft.actuators is None or not craft.actuators.fins:
        return 0.0
    columns = [craft.actuators.matrix[:, craft.actuators.slices[k]] for k in craft.actuators.fins]
    ratios = {round(float(y / n), 9) for column in columns for y, n in column[[1, 3]].T if n}
    if len(ratios) != 1:
        raise NotApplicable("its fins are not at one place along the hull, so that their side force has no fixed share")
    return ratios.pop()
