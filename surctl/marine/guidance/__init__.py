"""Guidance of the robot: path tracking, obstacle avoidance, and the choice of a course past several obstacles."""

from surctl.marine.guidance.avoidance import FORMS, AvoidanceForm
from surctl.marine.guidance.contacts import FAR, Cone, Contact, inside
from surctl.marine.guidance.following import AHEAD, FOLLOWING, PASSED, ROW, SKIPS, Follower, follow
from surctl.marine.guidance.path import AT_CORNER, BEND, MAX_WAYPOINTS, PASS, VISIT, Path
from surctl.marine.guidance.sectors import SAME_CONTACT, Sector
from surctl.marine.guidance.tracking import GUIDANCE, Guidance

__all__ = [
    "AHEAD", "AT_CORNER", "BEND", "FAR", "FOLLOWING", "FORMS", "GUIDANCE", "MAX_WAYPOINTS", "PASS", "PASSED", "ROW",
    "SAME_CONTACT", "SKIPS", "VISIT", "AvoidanceForm", "Cone", "Contact", "Follower", "Guidance", "Path", "Sector",
    "follow", "inside",
]  # fmt: skip
