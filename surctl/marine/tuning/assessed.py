"""Figures of an assessment that a goal may bound although the search does not compute them."""

from __future__ import annotations

from collections.abc import Mapping

from surctl.marine.simulation import MetricSpec

__all__ = ["ASSESSED", "PART_OF"]

ASSESSED: Mapping[str, MetricSpec] = {
    "nominal_disk_margin": MetricSpec("1", "disk margin of the nominal vehicle, all loops at once", "high"),
    "corner_slowest_pole_per_s": MetricSpec("1/s", "largest real part of a pole over the corners", "low"),
    "region_m": MetricSpec("m", "distance beside the path from which the return is proved", "high"),
    "region_within_m": MetricSpec("m", "distance within which the motion ends, proved", "low"),
    "contact_margin_m": MetricSpec("m", "gain margin beyond the one that braking needs", "high"),
    "time_ratio": MetricSpec("1", "arrival time over the ideal time (path length / cruise speed)", "low"),
}
"""Figures of an assessment by name; goals on them are checked at the end of a tuning (`finals`)."""

PART_OF: Mapping[str, str] = {
    **dict.fromkeys(
        (
            "disk_margin", "single_loop_disk_margin", "delay_margin_s", "slowest_pole_per_s",
            "nominal_disk_margin", "corner_slowest_pole_per_s",
        ),
        "loop",
    ),
    "region_m": "region",
    "region_within_m": "region",
    "contact_margin_m": "no contact",
    "time_ratio": "runs",
}  # fmt: skip
"""Part of an assessment with each figure that is checked at the end; those of the linear loop only for a law without a
linear model."""
