"""A claim about braking as data: vehicle, obstacle, measurements, and the numbers of the law's speed bound."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, sqrt
from typing import Any, Literal

from surctl.certcheck.braking_claim import ASSUMES, STOPPING, GuardedLaw
from surctl.certcheck.braking_claim import BrakingClaim as Stated
from surctl.certcheck.fields import written
from surctl.marine.control import Barrier, Gains
from surctl.marine.control.stopping import BRAKE
from surctl.marine.guidance.braking import Brakes, Watch, brakes_of
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.assumptions import check_no_integral, nine_decimals


def law_numbers(barrier: Barrier, vehicle: Vehicle, gains: Gains, *, cap: float = 0.22) -> GuardedLaw:
    """Return the numbers that describe the guarded law with `vehicle` as the law's model and a speed cap [m/s].

    Raises:
        NotApplicable: integral action is on.
    """
    check_no_integral(gains)
    own = brakes_of(vehicle, share=gains["brake"])
    pairs = [("m11", "m22"), ("Xu", "Yv"), ("Xuu", "Yvv")]
    mass, linear, quadratic = ((_exact(vehicle[surge]), _exact(vehicle[sway])) for surge, sway in pairs)
    believed = (*own.masses, own.most, own.lag, own.linear[1], own.quadratic[1])
    scalars = {key: _exact(gains[key]) for key in ("margin", "reaction", "brake", "k_v")}
    return GuardedLaw(
        barrier=barrier, limit=_exact(min(vehicle.thrust_limit[:2])), gain=_exact(BRAKE), cap=_exact(cap), mass=mass,
        linear=linear, quadratic=quadratic, stopping=dict(zip(STOPPING, map(_exact, believed), strict=True)), **scalars,
    )  # fmt: skip


def _exact(x: float) -> Fraction:
    return Fraction(repr(float(x)))


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
    law: GuardedLaw | None = None
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

    def document(self, needed: list[list[float]], limit: float) -> dict[str, Any]:
        """Return the claim as data of a certificate, with needed ranges [m] and the largest obstacle speed [m/s]."""
        b, w = self.brakes, self.watch
        values = {
            "mass": b.masses, "ratio": self.ratio, "linear": b.linear, "quadratic": b.quadratic, "drag": self.drag,
            "brake": b.least, "most": b.most, "side": self.side, "lag": b.lag, "obstacles": self.obstacles,
            "current": b.current, "disturbance": b.disturbance, "sideways": self.sideways, "turn": self.turn,
            "fastest": self.fastest, "period": w.period, "age": w.age, "range_error": w.range_error,
            "speed_error": w.speed_error, "speeds": self.speeds, "needed": needed, "limit": limit,
        }  # fmt: skip
        return {
            "system": "braking", "assumes": list(ASSUMES),
            **written(Stated, values | {name: _rounded(values[name], _UP.get(name)) for name in _COMPUTED}),
            "law": None if self.law is None else written(GuardedLaw, vars(self.law)),
            "sha256_vehicle": self.digests[0], "sha256_law": self.digests[1],
        }  # fmt: skip


_COMPUTED = ("mass", "ratio", "linear", "quadratic", "brake", "most", "side")
# all other numbers must equal those of the exported law and of the vehicle
# bounds of the thrust are rounded such that they hold for the vehicle
_UP = {"brake": False, "most": True, "side": True}


def _rounded(value: Any, up: bool | None) -> Any:
    if isinstance(value, tuple):
        return [_rounded(part, up) for part in value]
    return round(float(value), 9) if up is None else nine_decimals(value, up=up)
