"""The library of region claims: one robot, one law, wider and wider."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from surctl.control import Gains
from surctl.errors import InputError, nearest
from surctl.vehicle import Vehicle
from surctl.verification.region.claim import RegionClaim
from surctl.verification.region.heading import HeadingClaim
from surctl.verification.region.heading_proof import prove_heading
from surctl.verification.region.proof import RegionProof, prove_region
from surctl.verification.region.statement import RegionStatement

__all__ = ["REGION_CLAIMS", "prove_statement", "region_statement"]


def _entries(*entries: tuple[str, str, dict[str, Any]]) -> Mapping[str, RegionStatement]:
    return {name: RegionStatement(name=name, statement=statement, **rest) for name, statement, rest in entries}


REGION_CLAIMS: Mapping[str, RegionStatement] = _entries(
    ("region-cruise-20", "mass and drag off by ±20 %, any heading, saturated thrust", {"attempts": 100}),
    (
        "region-cruise-20-soft",
        "the same with k1 0.15, look-ahead 1.2 m, k_v 0.35",
        {"gains": {"k1": 0.15, "lookahead": 1.2, "k_v": 0.35}},
    ),
    (
        "region-cruise-20-sampled",
        "the same as region-cruise-20, commands held for a period",
        {"sampled": True, "attempts": 100},
    ),
    (
        "region-cruise-20-lag",
        "that with the thrust's lag too, the heading turning at 0.1 rad/s at most",
        {"sampled": True, "lagged": True, "yaw_rate_rad_per_s": 0.1, "attempts": 60},
    ),
    (
        "region-cruise-20-spin",
        "the same while it looks around, turning no faster than the gain spin",
        {"sampled": True, "lagged": True, "spinning": True, "attempts": 60},
    ),
    (
        "region-cruise-ranges",
        "the ranges of the vehicle file, thrust lower by 15 %",
        {"ranges": True, "thrust_share": 0.15, "rate_per_s": 0.01, "attempts": 240},
    ),
    (
        "region-cruise-current",
        "mass and drag off by ±20 %, a steady current of 0.05 m/s from anywhere: how close to the path it settles",
        {"current_m_per_s": 0.05, "rate_per_s": 0.01},
    ),
    (
        "region-cruise-20-force",
        "the same as region-cruise-20, pushed by 0.25 N of waves and thrust error: how close it settles",
        {"force_n": 0.25, "attempts": 60},
    ),
    (
        "region-cruise-20-noise",
        "pushed by 0.1 N, its place measured to 5 mm and its velocity to 1 mm/s: how close it settles",
        {
            "force_n": 0.1, "place_error_m": 0.005, "velocity_error_m_per_s": 0.001, "rate_per_s": 0.01,
            "attempts": 60,
        },
    ),
    (
        "region-heading-20",
        "the loop of 8 states steered by heading (own soft gains): every number off by ±20 %, saturated thrust",
        {"loop": "heading", "attempts": 3, "cells": 250},
    ),
    (
        "region-heading-20-slow",
        "the same at 0.01/s, as far out as it goes",
        {"loop": "heading", "rate_per_s": 0.01, "attempts": 30, "cells": 2500},
    ),
    (
        "region-heading-ranges",
        "the same over the ranges of the vehicle file, thrust lower by 15 %",
        {"loop": "heading", "ranges": True, "thrust_share": 0.15, "rate_per_s": 0.01, "attempts": 20},
    ),
)  # fmt: skip


def region_statement(name: str) -> RegionStatement:
    """The region claim of that name.

    Raises:
        InputError: no such claim, with the nearest known name.
    """
    if name not in REGION_CLAIMS:
        raise InputError("unknown claim", key="claim", value=name, remedy=nearest(name, REGION_CLAIMS))
    return REGION_CLAIMS[name]


def prove_statement(
    statement: RegionStatement,
    vehicle: Vehicle,
    gains: Gains,
    *,
    seed: int = 0,
    cruise: float | None = None,
    cap: float | None = None,
) -> RegionProof:
    """Prove a region claim about a vehicle flown with these gains, with the effort that it states.

    Raises:
        InputError, NotApplicable: as `RegionStatement.claim`.
    """
    claim: RegionClaim | HeadingClaim = statement.claim(vehicle, gains, cruise=cruise, cap=cap)
    if isinstance(claim, HeadingClaim):
        return prove_heading(claim, rounds=statement.attempts, cells=statement.cells)
    return prove_region(claim, attempts=statement.attempts, seed=seed)
