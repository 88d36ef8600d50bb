"""The linearised closed loop: margins of all loops opened at once, poles, and the exactly sampled loop."""

from surctl.verification.linear.corners import Corners, corners
from surctl.verification.linear.disk import (
    LEAST_DISK_MARGIN,
    DiskMargin,
    disk_margin,
    disk_profile,
    screened_peaks,
    structured_bounds,
)
from surctl.verification.linear.interop import closed_system, loop_system, open_system, sampled_loop_system
from surctl.verification.linear.margin_speed import margin_speed
from surctl.verification.linear.modes import Mode, bearable_speed, cap_above, cap_above_bearable, slowest_mode
from surctl.verification.linear.open_loop import OpenLoop
from surctl.verification.linear.places import DISK_PLACES, open_loop
from surctl.verification.linear.sampled import SampledLimits, largest_period, sampled_limits, sampled_poles
from surctl.verification.linear.sensitivity import Sensitivity, sensitivity_of
from surctl.verification.linear.side import LinearSide, Pole, linear_side, worst_linear_side
from surctl.verification.linear.worst import corner_margin, least_disk

__all__ = [
    "DISK_PLACES",
    "LEAST_DISK_MARGIN",
    "Corners",
    "DiskMargin",
    "LinearSide",
    "Mode",
    "OpenLoop",
    "Pole",
    "SampledLimits",
    "Sensitivity",
    "bearable_speed",
    "cap_above",
    "cap_above_bearable",
    "closed_system",
    "corner_margin",
    "corners",
    "disk_margin",
    "disk_profile",
    "largest_period",
    "least_disk",
    "linear_side",
    "loop_system",
    "margin_speed",
    "open_loop",
    "open_system",
    "sampled_limits",
    "sampled_loop_system",
    "sampled_poles",
    "screened_peaks",
    "sensitivity_of",
    "slowest_mode",
    "structured_bounds",
    "worst_linear_side",
]
