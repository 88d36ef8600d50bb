"""The library of region claims: one robot, one law, wider and wider."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from surctl.control import Gains
from surctl.errors import InputError, nearest
from surctl.vehicle import Vehicle
from surctl.verification.region.claim import RegionClaim, region_claim

__all__ = ["REGION_CLAIMS", "RegionEntry", "region_claim_named"]

_SOFT = {"k1": 0.15, "lookahead": 1.2, "k_v": 0.35}


class RegionEntry(NamedTuple):
    """What a name claims, how it is built, and how many attempts its search takes."""

    statement: str
    build: Callable[[str, Vehicle, Gains], RegionClaim]
    attempts: int


def _twenty(name: str, vehicle: Vehicle, gains: Gains) -> RegionClaim:
    return region_claim(name, vehicle, gains)


def _soft(name: str, vehicle: Vehicle, gains: Gains) -> RegionClaim:
    return region_claim(name, vehicle, gains.with_values(_SOFT))


def _sampled(name: str, vehicle: Vehicle, gains: Gains) -> RegionClaim:
    return region_claim(name, vehicle, gains, sampled=True)


def _lagged(name: str, vehicle: Vehicle, gains: Gains) -> RegionClaim:
    return region_claim(name, vehicle, gains, sampled=True, lagged=True, yaw_rate=0.1)


def _spinning(name: str, vehicle: Vehicle, gains: Gains) -> RegionClaim:
    return region_claim(name, vehicle, gains, sampled=True, lagged=True, yaw_rate=gains["spin"])


def _ranges(name: str, vehicle: Vehicle, gains: Gains) -> RegionClaim:
    return region_claim(name, vehicle, gains, share=None, thrust_share=0.15, rate=0.01)


REGION_CLAIMS: Mapping[str, RegionEntry] = {
    "region-cruise-20": RegionEntry("mass and drag off by ±20 %, any heading, saturated thrust", _twenty, 100),
    "region-cruise-20-soft": RegionEntry("the same with k1 0.15, look-ahead 1.2 m, k_v 0.35", _soft, 80),
    "region-cruise-20-sampled": RegionEntry("the same as region-cruise-20, commands held for a period", _sampled, 100),
    "region-cruise-20-lag": RegionEntry(
        "that with the thrust's lag too, the heading turning at 0.1 rad/s at most", _lagged, 60
    ),
    "region-cruise-20-spin": RegionEntry(
        "the same while it looks around, turning no faster than the gain spin", _spinning, 60
    ),
    "region-cruise-ranges": RegionEntry("the ranges of the vehicle file, thrust lower by 15 %", _ranges, 120),
}


def region_claim_named(name: str, vehicle: Vehicle, gains: Gains) -> RegionClaim:
    """The region claim of that name for a vehicle and its gains.

    Raises:
        InputError: no such claim, with the nearest known name; a vehicle or gains that it does not fit.
    """
    if name not in REGION_CLAIMS:
        raise InputError("unknown claim", key="claim", value=name, remedy=nearest(name, REGION_CLAIMS))
    return REGION_CLAIMS[name].build(name, vehicle, gains)
