"""A claim about braking as data: vehicle, obstacle, measurements, and the numbers of the law's speed bound."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, sqrt
from typing import Any, Literal

from surctl.certcheck.braking_claim import ASSUMES
from surctl.marine.control import Barrier, Gains
from surctl.marine.control.stopping import BRAKE
from surctl.marine.guidance.braking import Brakes, Watch, brakes_of
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.assumptions import check_no_integral

Pair = tuple[float, float]


@dataclass(frozen=True)
class LawNumbers:
    """Numbers that define the law's speed bound, and the response of its velocity loop to a speed above the bound.

    Attributes:
        barrier: name of the barrier.
        own: braking capability of the law's model, at the share of the thrust limit that the law relies on.
        margin, reaction, brake, k_v, k_i: the law's gains of these names, in m, s, 1, 1/s and 1/s².
        cap: largest speed that the law wants [m/s].
        limit: smaller one of the thrust limits of surge and sway [N].
        mass, linear, quadratic: mass [kg], linear drag [N s/m] and quadratic drag [N s²/m²] of (surge, sway) in the
            law's model.
    """

    barrier: Barrier
    own: Brakes
    margin: float
    reaction: float
    brake: float
    k_v: float
    k_i: float
    cap: float
    limit: float
    mass: Pair
    linear: Pair
    quadratic: Pair

    def document(self) -> dict[str, Any]:
        """Return the numbers as data of a certificate."""
        own = self.own
        return {
            "barrier": self.barrier,
            "margin_m": self.margin,
            "reaction_s": self.reaction,
            "brake": self.brake,
            "limit_n": self.limit,
            "k_v_per_s": self.k_v,
            "k_i_per_s2": self.k_i,
            "gain": BRAKE,
            "cap_m_per_s": self.cap,
            "mass_kg": list(self.mass),
            "linear_drag": list(self.linear),
            "quadratic_drag": list(self.quadratic),
            "stopping": {
                "lightest_kg": own.masses[0],
                "heaviest_kg": own.masses[1],
                "most_n": own.most,
                "lag_s": own.lag,
                "linear_drag": own.linear[1],
                "quadratic_drag": own.quadratic[1],
            },
        }


def law_numbers(barrier: Barrier, vehicle: Vehicle, gains: Gains, *, cap: float = 0.22) -> LawNumbers:
    """Return the numbers that describe the guarded law with `vehicle` as the law's model and a speed cap [m/s].

    Raises:
        NotApplicable: integral action is on.
    """
    check_no_integral(gains)
    return LawNumbers(
        barrier,
        brakes_of(vehicle, share=gains["brake"]),
        gains["margin"],
        gains["reaction"],
        gains["brake"],
        gains["k_v"],
        gains["k_i"],
        cap,
        float(min(vehicle.thrust_limit[:2])),
        (vehicle["m11"], vehicle["m22"]),
        (vehicle["Xu"], vehicle["Yv"]),
        (vehicle["Xuu"], vehicle["Yvv"]),
    )


@dataclass(frozen=True)
class BrakingClaim:
    """A claim about braking before one obstacle at a time; `certcheck.braking_claim` lists its assumptions.

    Attributes:
        name: name of the claim.
        brakes: braking capability of the true vehicle over its ranges; its masses are those of the lighter axis.
        watch: control period, largest age of a measured range, largest error of the range, and largest error of the
            measured own speed.
        drag: `along` for drag along the velocity, `axes` for drag of each axis separately, at any heading.
        obstacles: approach speeds v_o of the obstacles [m/s], in rising order.
        fastest: largest own speed [m/s].
        sideways: largest own speed perpendicular to the direction of the obstacle [m/s].
        turn: largest yaw rate while the vehicle brakes [rad/s].
        side: largest thrust perpendicular to the direction of the obstacle [N].
        law: numbers of the law; None for the braking rule alone: the vehicle brakes unless the measured range is at
            least the range needed.
        speeds: own speeds for which the table of the certificate has entries [m/s], at most `fastest`.
        digests: SHA-256 of the vehicle's parameters, and SHA-256 of the law's instruction list.
        ratio: largest ratio of the masses in surge and sway, the heavier one over the lighter one.
    """

    name: str
    brakes: Brakes
    watch: Watch
    drag: Literal["along", "axes"]
    obstacles: tuple[float, ...]
    fastest: float
    sideways: float = 0.0
    turn: float = 0.0
    side: float = 0.0
    law: LawNumbers | None = None
    speeds: tuple[float, ...] = (0.10, 0.15, 0.22)
    digests: tuple[str, str] = ("0" * 64, "0" * 64)
    ratio: float = 1.0

    def braking_with(self, least: float) -> BrakingClaim:
        """Return the claim with another guaranteed braking force [N]; less of it ends sooner after a decision to brake.

        If the masses differ, the thrust across is what is left of the largest thrust.
        """
        most = self.brakes.most
        side = self.side if self.ratio == 1 else ceil(sqrt(max(most**2 - least**2, 0.0)) * 1e9) / 1e9
        return replace(self, brakes=replace(self.brakes, least=least), side=side)

    def document(self, table: dict[str, Any], limit: float) -> dict[str, Any]:
        """Return the claim as data of a certificate, with its table and the largest obstacle speed `limit` [m/s]."""
        b, w = self.brakes, self.watch
        return {
            "system": "braking",
            "assumes": list(ASSUMES),
            "vehicle": {
                "mass_kg": _pair(b.masses),
                "mass_ratio": _plain(self.ratio),
                "linear_drag": _pair(b.linear),
                "quadratic_drag": _pair(b.quadratic),
                "drag": self.drag,
                "brake_n": _plain(b.least),
                "most_n": _plain(b.most),
                "side_n": _plain(self.side),
                "lag_s": b.lag,
            },
            "encounter": {
                "obstacles_m_per_s": list(self.obstacles),
                "current_m_per_s": b.current,
                "disturbance_n": b.disturbance,
                "sideways_m_per_s": self.sideways,
                "turn_rad_per_s": self.turn,
                "fastest_m_per_s": self.fastest,
            },
            "watch": {
                "period_s": w.period,
                "age_s": w.age,
                "range_error_m": w.range_error,
                "speed_error_m_per_s": w.speed_error,
            },
            "law": None if self.law is None else self.law.document(),
            "table": table,
            "limit_obstacle_m_per_s": limit,
            "sha256_vehicle": self.digests[0],
            "sha256_law": self.digests[1],
        }


def _plain(value: float) -> float:
    return round(value, 9)


def _pair(ends: tuple[float, float]) -> list[float]:
    return [_plain(end) for end in ends]
