"""The linearised closed loop of a mission: margins over the corners, poles, and the exactly sampled loop."""

from surctl.marine.verification.corners import Corners, corners
from surctl.marine.verification.linear.corner_margin import SlowMargins, corner_margin, least_disk, slow_margins
from surctl.marine.verification.linear.modes import Mode, bearable_speed, cap_above, cap_above_bearable, slowest_mode
from surctl.marine.verification.linear.side import (
    DISK_PLACES,
    LinearSide,
    Pole,
    SampledLimits,
    linear_side,
    margin_speed,
    open_loop,
    sampled_limits,
    worst_linear_side,
)

__all__ = [
    "DISK_PLACES", "Corners", "LinearSide", "Mode", "Pole", "SampledLimits", "SlowMargins", "bearable_speed",
    "cap_above", "cap_above_bearable", "corner_margin", "corners", "least_disk", "linear_side", "margin_speed",
    "open_loop", "sampled_limits", "slow_margins", "slowest_mode", "worst_linear_side",
]  # fmt: skip
