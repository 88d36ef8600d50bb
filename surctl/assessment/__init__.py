"""One assessment of a subject: every page, command and status reads its figures and verdicts here."""

from surctl.assessment.assessment import Assessment, Figure, Line, Part, Subject, assess
from surctl.assessment.closed_loop import ClosedLoop
from surctl.assessment.comparison import Comparison
from surctl.assessment.loop import LoopAnalysis
from surctl.assessment.mission import Mission
from surctl.assessment.motion import DEFAULT_REGIONS

__all__ = [
    "DEFAULT_REGIONS",
    "Assessment",
    "ClosedLoop",
    "Comparison",
    "Figure",
    "Line",
    "LoopAnalysis",
    "Mission",
    "Part",
    "Subject",
    "assess",
]
