"""Missions as subjects of an assessment: margins, regions, the no-contact claim and runs of a vehicle under its law."""

from surctl.marine.assessment.assumptions import assumptions
from surctl.marine.assessment.loop import LoopAnalysis
from surctl.marine.assessment.mission import Mission
from surctl.marine.assessment.motion import DEFAULT_REGIONS

__all__ = [
    "DEFAULT_REGIONS",
    "LoopAnalysis",
    "Mission",
    "assumptions",
]
