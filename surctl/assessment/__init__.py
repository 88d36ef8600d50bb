"""One assessment of a subject: every page, command and status reads its figures and verdicts here."""

from surctl.assessment.assessment import Assessment, Assumption, Figure, Line, Part, Subject, assess
from surctl.assessment.closed_loop import ClosedLoop
from surctl.assessment.comparison import Comparison

__all__ = [
    "Assessment",
    "Assumption",
    "ClosedLoop",
    "Comparison",
    "Figure",
    "Line",
    "Part",
    "Subject",
    "assess",
]
