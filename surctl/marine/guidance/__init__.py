"""Guidance of the robot: path tracking, obstacle avoidance, and the choice of a course past several obstacles."""

from surctl.marine.guidance.avoidance import FORMS, AvoidanceForm, avoidance_course, encounter_side
from surctl.marine.guidance.contacts import (
    FAR,
    Cone,
    Contact,
    collision_cone,
    disc_contacts,
    inside,
    nearest_in_quadrants,
    point_contact,
    wall_contacts,
)
from surctl.marine.guidance.following import (
    AHEAD,
    FOLLOWING,
    PASSED,
    ROW,
    SKIPS,
    Follower,
    Window,
    follow,
    follow_on,
    window_next,
    window_values,
)
from surctl.marine.guidance.path import (
    AT_CORNER,
    BEND,
    MAX_WAYPOINTS,
    PASS,
    VISIT,
    Path,
    leg_end,
    next_leg,
    path_target,
    wheel_over,
)
from surctl.marine.guidance.sectors import SAME_CONTACT, Sector, choose_velocity, round_unknown, slowed
from surctl.marine.guidance.tracking import (
    GUIDANCE,
    Guidance,
    along_command,
    check_guidance,
    crosstrack_next,
    crosstrack_shift,
    path_error,
    progress_rate,
    tracking_velocity,
)

__all__ = [
    "AHEAD", "AT_CORNER", "BEND", "FAR", "FOLLOWING", "FORMS", "GUIDANCE", "MAX_WAYPOINTS", "PASS", "PASSED", "ROW",
    "SAME_CONTACT", "SKIPS", "VISIT", "AvoidanceForm", "Cone", "Contact", "Follower", "Guidance", "Path", "Sector",
    "Window", "along_command", "avoidance_course", "check_guidance", "choose_velocity", "collision_cone",
    "crosstrack_next", "crosstrack_shift", "disc_contacts", "encounter_side", "follow", "follow_on", "inside",
    "leg_end", "nearest_in_quadrants", "next_leg", "path_error", "path_target", "point_contact", "progress_rate",
    "round_unknown", "slowed", "tracking_velocity", "wall_contacts", "wheel_over", "window_next", "window_values",
]  # fmt: skip
