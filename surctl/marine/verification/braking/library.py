"""The library of claims about braking (`braking-rule-20` and others), and vehicles to which they do not apply."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import ceil, sqrt
from pathlib import Path
from typing import Literal

from surctl.certcheck.braking_claim import GuardedLaw
from surctl.errors import InputError, NotApplicable, nearest
from surctl.files import read_toml
from surctl.marine.control import Barrier, Gains, build_law
from surctl.marine.guidance.braking import LEAST_THRUST, Brakes, Watch, brakes_of
from surctl.marine.vehicle import Vehicle, steady_speed
from surctl.marine.vehicle.dynamics import check_equation_3
from surctl.marine.verification.assumptions import check_sway_force
from surctl.marine.verification.braking.claim import BrakingClaim, law_numbers
from surctl.verification.setting import OVERSHOOT

_SPREAD = 0.2
_APART = 0.05  # by how much the ratio of unequal masses may be off
_FASTEST, _CAP = 0.25, 0.22  # [m/s] largest own speed, and the speed cap that it belongs to
_BEYOND = 1.08  # largest speed in simulated runs, divided by the steady one
_SPEEDS = (0.10, 0.15, 0.22)  # [m/s] own speeds of the table
_SENSED = Watch(age=0.2, range_error=0.05, speed_error=0.01)
_COLUMNS = (0.0, 0.05, 0.10, 0.15)  # [m/s] approach speeds of obstacles in the rule's table


@dataclass(frozen=True)
class BrakingStatement:
    """A claim about braking without its vehicle and gains; SI units.

    Attributes:
        statement: the claim in words.
        barrier: barrier of the law `guarded`; None for the rule that brakes unless the range needed is available.
        wide: whether the ranges of the vehicle file replace ±20 %.
        drag: how drag acts if it is equal in surge and sway.
        sideways: largest own speed perpendicular to the direction of the obstacle.
        spins: whether the hull turns with the rate of the gain `spin`.
        obstacle: approach speed of the obstacles of a law; the rule has a table of them.
    """

    statement: str
    barrier: Barrier | None = None
    wide: bool = False
    drag: Literal["along", "axes"] = "along"
    sideways: float = 0.22
    spins: bool = False
    obstacle: float = 0.0

    def claim(self, name: str, vehicle: Vehicle, gains: Gains, cap: float) -> BrakingClaim:
        """Return the claim with a name, for a vehicle, its gains and its speed cap [m/s].

        Raises:
            NotApplicable: the vehicle or the gains violate an assumption of the claim.
        """
        _check(vehicle, wide=self.wide)
        # the inertia bound relies on the share `brake` of the thrust; all else needs all guaranteed thrust
        share = gains["brake"] if self.barrier == "inertia" else LEAST_THRUST
        acting, ratio = _drag(vehicle, self.drag, wide=self.wide), _ratio(vehicle, wide=self.wide)
        numbers = None if self.barrier is None else law_numbers(self.barrier, vehicle, gains, cap=cap)
        brakes = _true(vehicle, share, wide=self.wide)
        if acting == "axes":  # each axis has its own drag and its own limit: the largest thrust is on a diagonal
            brakes = replace(brakes, most=brakes.most * sqrt(2))
        rule = BrakingClaim(
            name, brakes, _SENSED, acting, _COLUMNS, _fastest(cap), sideways=self.sideways,
            side=0.0 if ratio == 1 else brakes.most, speeds=_rows(cap), digests=(vehicle.digest(), "0" * 64),
            ratio=ratio,
        )  # fmt: skip
        if numbers is None or self.barrier is None:
            return rule
        law = build_law(barrier=self.barrier, movers="barrier" if self.obstacle else "predict")
        guarded = replace(
            rule, watch=Watch(period=law.dt), obstacles=(self.obstacle,), law=numbers, side=brakes.most,
            fastest=max(_fastest(cap), _attained(numbers, brakes)), turn=gains["spin"] if self.spins else 0.0,
            digests=(vehicle.digest(), law.block.digest()),
        )  # fmt: skip
        return guarded.braking_with(brakes.least)


def _true(vehicle: Vehicle, share: float, *, wide: bool) -> Brakes:
    """Return the braking data of a vehicle whose mass and drag are uncertain by ±20 %; its masses of the lighter axis.

    If `wide`, the ranges of the vehicle file replace ±20 % for all parameters but linear drag.
    """
    near = brakes_of(vehicle, share=share, spread=_SPREAD)
    light = min(vehicle["m11"], vehicle["m22"])
    if wide:
        (low, high), (low2, high2) = _masses(vehicle)
        masses = min(low, low2), max(high, high2) if _equal(vehicle) else min(high, high2)
        return replace(brakes_of(vehicle, share=share), linear=near.linear, masses=masses)
    return replace(near, masses=(light * (1 - _SPREAD), light * (1 + _SPREAD)))


def _masses(vehicle: Vehicle) -> list[tuple[float, float]]:
    """Return the ranges of the masses in surge and sway; a mass without a range counts as exact."""
    return [vehicle.parameters[name].range or (vehicle[name], vehicle[name]) for name in ("m11", "m22")]


def _equal(vehicle: Vehicle) -> bool:
    surge, sway = _masses(vehicle)
    return vehicle["m11"] == vehicle["m22"] and surge == sway


def _ratio(vehicle: Vehicle, *, wide: bool) -> float:
    """Return the largest ratio of the masses in surge and sway; 1 for equal masses, which are then off in common."""
    if wide and not _equal(vehicle):
        (low, high), (low2, high2) = _masses(vehicle)
        return ceil(max(high / low2, high2 / low) * 1e9) / 1e9
    light, heavy = sorted((vehicle["m11"], vehicle["m22"]))
    return 1.0 if light == heavy else round(heavy / light * (1 + _APART), 9)


def _drag(vehicle: Vehicle, stated: Literal["along", "axes"], *, wide: bool) -> Literal["along", "axes"]:
    """Return how drag acts: axis by axis if surge and sway differ, because it is then not along the velocity."""
    for surge, sway in (("Xu", "Yv"), ("Xuu", "Yvv")):
        ranges = [vehicle.parameters[name].range for name in (surge, sway)]
        if vehicle[surge] != vehicle[sway] or (wide and ranges[0] != ranges[1]):
            return "axes"
    return stated


def _check(vehicle: Vehicle, *, wide: bool) -> None:
    """Raise NotApplicable if the vehicle violates an assumption of the claims."""
    check_sway_force(vehicle)
    check_equation_3(vehicle)
    if wide and not _equal(vehicle) and None in (vehicle.parameters["m11"].range, vehicle.parameters["m22"].range):
        values = " and ".join(f"{name} = {vehicle[name]:g} kg" for name in ("m11", "m22"))
        raise NotApplicable(
            f"{values} differ and the vehicle file has no ranges for both, over which the claim would hold"
        )


def _fastest(cap: float) -> float:
    return _FASTEST if cap <= _CAP else round(OVERSHOOT * cap, 9)


def _attained(law: GuardedLaw, brakes: Brakes) -> float:
    """Return the speed [m/s] at which the law ends up with the least drag of the claim, and what it overshoots by.

    The velocity loop pushes with m k_v (cap − v) and the drag of its model at the cap, on each axis with its own model.
    """
    steady, (low, low2) = 0.0, (brakes.linear[0], brakes.quadratic[0])
    cap = float(law.cap)
    for axis in zip(law.mass, law.linear, law.quadratic, strict=True):
        mass, linear, quadratic = map(float, axis)
        loop = mass * float(law.k_v)
        thrust, slope = loop * cap + linear * cap + quadratic * cap**2, loop + low
        steady = max(steady, steady_speed(thrust, slope, low2))
    return ceil(_BEYOND * steady * 1e3) / 1e3


def _rows(cap: float) -> tuple[float, ...]:
    return _SPEEDS if cap <= _CAP else (*_SPEEDS, cap)


BRAKING_CLAIMS: Mapping[str, BrakingStatement] = {
    name: BrakingStatement(**entries) for name, entries in read_toml(Path(__file__).with_name("library.toml")).items()
}


def braking_claim_named(name: str, vehicle: Vehicle, gains: Gains, *, cap: float = _CAP) -> BrakingClaim:
    """Return the claim about braking with a given name, for a vehicle, its gains and its speed cap [m/s].

    Raises:
        InputError: no claim has this name; the message gives the most similar known name.
        NotApplicable: the vehicle or the gains violate an assumption of the claim.
    """
    if name not in BRAKING_CLAIMS:
        raise InputError("unknown claim", key="claim", value=name, remedy=nearest(name, BRAKING_CLAIMS))
    return BRAKING_CLAIMS[name].claim(name, vehicle, gains, cap)
