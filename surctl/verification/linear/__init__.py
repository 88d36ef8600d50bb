"""Disk margins and sensitivity of a linearised loop with all loops opened at once."""

from surctl.verification.linear.disk import (
    LEAST_DISK_MARGIN,
    DiskMargin,
    disk_margin,
    disk_profile,
    screened_peaks,
    structured_bounds,
)
from surctl.verification.linear.open_loop import OpenLoop
from surctl.verification.linear.sensitivity import Sensitivity, sensitivity_of

__all__ = [
    "LEAST_DISK_MARGIN",
    "DiskMargin",
    "OpenLoop",
    "Sensitivity",
    "disk_margin",
    "disk_profile",
    "screened_peaks",
    "sensitivity_of",
    "structured_bounds",
]
