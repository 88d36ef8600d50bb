"""The library of claims about braking: the bare rule with its tables, and the two barriers that fly."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from math import sqrt
from typing import Literal, NamedTuple

from surctl.control import Barrier, Gains, build_law
from surctl.errors import InputError, nearest
from surctl.guidance.braking import LEAST_THRUST, Brakes, Watch, brakes_of
from surctl.vehicle import Vehicle
from surctl.verification.assumptions import check_alike
from surctl.verification.braking.claim import BrakingClaim, law_numbers
from surctl.verification.setting import OVERSHOOT

__all__ = ["BRAKING_CLAIMS", "BrakingEntry", "braking_claim_named"]

_SPREAD = 0.2
_FASTEST, _CAP = 0.25, 0.22  # [m/s] own speed at most, under that cap
_SPEEDS = (0.10, 0.15, 0.22)  # [m/s] own speeds of the table
_SENSED = Watch(age=0.2, range_error=0.05, speed_error=0.01)
_COLUMNS = (0.0, 0.05, 0.10, 0.15)  # [m/s] obstacles of the rule's table


class BrakingEntry(NamedTuple):
    """What a name claims, and how it is built."""

    statement: str
    build: Callable[[str, Vehicle, Gains, float], BrakingClaim]


def _true(vehicle: Vehicle, share: float, *, wide: bool) -> Brakes:
    """Everything off by ±20 %, or the ranges of the vehicle file; linear drag off by ±20 % in both."""
    near = brakes_of(vehicle, share=share, spread=_SPREAD)
    return replace(brakes_of(vehicle, share=share), linear=near.linear) if wide else near


def _rule(*, wide: bool, sideways: float = 0.0) -> Callable[[str, Vehicle, Gains, float], BrakingClaim]:
    def build(name: str, vehicle: Vehicle, gains: Gains, cap: float) -> BrakingClaim:
        del gains
        check_alike(vehicle, ranges=wide)
        brakes = _true(vehicle, LEAST_THRUST, wide=wide)
        digests = (_digest(vehicle), "0" * 64)  # of no law
        return BrakingClaim(
            name, brakes, _SENSED, "along", _COLUMNS, _fastest(cap), sideways=sideways, speeds=_rows(cap),
            digests=digests,
        )  # fmt: skip

    return build


def _guarded(
    barrier: Barrier,
    *,
    wide: bool = False,
    drag: Literal["along", "axes"] = "along",
    sideways: float = 0.22,
    spins: bool = False,
    obstacle: float = 0.0,
) -> Callable[[str, Vehicle, Gains, float], BrakingClaim]:
    def build(name: str, vehicle: Vehicle, gains: Gains, cap: float) -> BrakingClaim:
        check_alike(vehicle, ranges=wide)
        numbers = law_numbers(barrier, vehicle, gains)
        # the inertia bound counts on `brake` of the thrust; the simple one needs all that is surely there
        brakes = _true(vehicle, LEAST_THRUST if barrier == "simple" else gains["brake"], wide=wide)
        if drag == "axes":  # each axis is limited by itself: a diagonal thrust is the larger one
            brakes = replace(brakes, most=brakes.most * sqrt(2))
        law = build_law(barrier=barrier, movers="barrier" if obstacle else "predict")
        return BrakingClaim(
            name,
            brakes,
            Watch(period=law.dt),
            drag,
            (obstacle,),
            _fastest(cap),
            sideways=sideways,
            turn=gains["spin"] if spins else 0.0,
            side=brakes.most,
            law=numbers,
            speeds=_rows(cap),
            digests=(_digest(vehicle), law.block.digest()),
        )

    return build


def _fastest(cap: float) -> float:
    """Largest own speed [m/s] under a cap: the table's, or as much beyond the cap as that is beyond 0.22 m/s."""
    return _FASTEST if cap <= _CAP else round(OVERSHOOT * cap, 9)


def _rows(cap: float) -> tuple[float, ...]:
    return _SPEEDS if cap <= _CAP else (*_SPEEDS, cap)


def _digest(vehicle: Vehicle) -> str:
    numbers = json.dumps({key: p.value for key, p in vehicle.parameters.items()}, sort_keys=True)
    return hashlib.sha256(numbers.encode()).hexdigest()


BRAKING_CLAIMS: Mapping[str, BrakingEntry] = {
    "braking-rule-20": BrakingEntry(
        "brake unless the range needed is there: table of ranges, all off by ±20 %, late and wrong sensors",
        _rule(wide=False),
    ),
    "braking-rule-ranges": BrakingEntry("the same over the ranges of the vehicle file", _rule(wide=True)),
    "braking-rule-20-plane": BrakingEntry(
        "the same as braking-rule-20 at up to 0.1 m/s across the direction that is latched",
        _rule(wide=False, sideways=0.1),
    ),
    "braking-inertia-20": BrakingEntry(
        "law guarded, barrier inertia, never touches what stands: all off by ±20 %, spinning, any sideways speed",
        _guarded("inertia", spins=True),
    ),
    "braking-inertia-ranges": BrakingEntry(
        "the same over the ranges of the vehicle file", _guarded("inertia", wide=True, spins=True)
    ),
    "braking-inertia-20-axes": BrakingEntry(
        "the same as braking-inertia-20 with drag and thrust limits axis by axis, 0.05 m/s sideways",
        _guarded("inertia", drag="axes", sideways=0.05, spins=True),
    ),
    "braking-inertia-20-movers": BrakingEntry(
        "barrier on movers too: what comes on at 0.05 m/s, all off by ±20 %, 0.1 m/s sideways",
        _guarded("inertia", obstacle=0.05, sideways=0.1),
    ),
    "braking-simple-20": BrakingEntry(
        "the same as braking-inertia-20 of barrier simple, not spinning", _guarded("simple")
    ),
}


def braking_claim_named(name: str, vehicle: Vehicle, gains: Gains, *, cap: float = _CAP) -> BrakingClaim:
    """The claim about braking of that name for a vehicle, its gains and the cap on its speed [m/s].

    Raises:
        InputError: no such claim, with the nearest known name.
        NotApplicable: a vehicle or gains whose numbers violate an assumption of it.
    """
    if name not in BRAKING_CLAIMS:
        raise InputError("unknown claim", key="claim", value=name, remedy=nearest(name, BRAKING_CLAIMS))
    return BRAKING_CLAIMS[name].build(name, vehicle, gains, cap)
