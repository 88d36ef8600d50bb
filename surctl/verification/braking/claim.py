"""What is claimed of the barrier with inertia: which vehicle, met by what, how well watched, by which law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from surctl.certcheck.braking_claim import ASSUMES, LEMMAS
from surctl.control import Barrier, Gains
from surctl.control.stopping import BRAKE
from surctl.guidance.braking import Brakes, Watch, brakes_of
from surctl.vehicle import Vehicle
from surctl.verification.assumptions import check_alike, check_no_integral

__all__ = ["BrakingClaim", "LawNumbers", "law_numbers"]


@dataclass(frozen=True)
class LawNumbers:
    """The law's bound, and how its velocity loop answers when it is exceeded.

    Attributes:
        barrier: name.
        own: what the law believes stops it, at the share of the thrust that it counts on.
        margin, reaction, brake, k_v, k_i: gains [m, s, 1, 1/s, 1/s²].
        limit: least thrust limit of surge and sway [N].
        mass, linear, quadratic: believed mass [kg] and drag [N s/m, N s²/m²] of surge and sway.
    """

    barrier: Barrier
    own: Brakes
    margin: float
    reaction: float
    brake: float
    k_v: float
    k_i: float
    limit: float
    mass: float
    linear: float
    quadratic: float

    def document(self) -> dict[str, Any]:
        """As a certificate states it."""
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
            "mass_kg": self.mass,
            "linear_drag": self.linear,
            "quadratic_drag": self.quadratic,
            "stopping": {
                "lightest_kg": own.masses[0],
                "heaviest_kg": own.masses[1],
                "most_n": own.most,
                "lag_s": own.lag,
                "linear_drag": own.linear[1],
                "quadratic_drag": own.quadratic[1],
            },
        }


def law_numbers(barrier: Barrier, vehicle: Vehicle, gains: Gains) -> LawNumbers:
    """The numbers of the guarded law for a vehicle that it believes in.

    Raises:
        NotApplicable: surge and sway differ, or integral action is on.
    """
    check_alike(vehicle)
    check_no_integral(gains)
    return LawNumbers(
        barrier,
        brakes_of(vehicle, share=gains["brake"]),
        gains["margin"],
        gains["reaction"],
        gains["brake"],
        gains["k_v"],
        gains["k_i"],
        float(min(vehicle.thrust_limit[:2])),
        vehicle["m11"],
        vehicle["Xu"],
        vehicle["Xuu"],
    )


@dataclass(frozen=True)
class BrakingClaim:
    """A claim about braking before one obstacle at a time; see `certcheck.braking_claim` for what it assumes.

    Attributes:
        name: of the claim.
        brakes: the true vehicle at the worst of its ranges.
        watch: what is known when, of the rule or the law.
        drag: `along` the velocity, or by `axes`, at any heading.
        obstacles: speeds v_o [m/s], rising, of what comes on.
        fastest: largest own speed [m/s].
        sideways: largest speed across the direction [m/s].
        turn: largest yaw rate while it brakes [rad/s].
        side: largest thrust across the direction [N].
        law: None for the bare rule: brake, unless the range needed is there.
        speeds: own speeds of the table [m/s], at most `fastest`.
        digests: SHA-256 of the vehicle's numbers and of the law's text.
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

    def document(self, table: dict[str, Any], limit: float) -> dict[str, Any]:
        """The claim as a certificate states it, with the figures of its table and the limit speed [m/s]."""
        b, w = self.brakes, self.watch
        return {
            "system": "braking",
            "assumes": list(ASSUMES),
            "lemmas": list(LEMMAS),
            "vehicle": {
                "mass_kg": _pair(b.masses),
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
