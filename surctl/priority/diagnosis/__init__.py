"""What a stack of tasks will do before anything moves: is NSB strict priority here, who conflicts, what is singular."""

from __future__ import annotations

from surctl.priority.diagnosis.commutator import commutator_norms, equals_strict_priority
from surctl.priority.diagnosis.diagnose import diagnose
from surctl.priority.diagnosis.result import Diagnosis

__all__ = ["Diagnosis", "commutator_norms", "diagnose", "equals_strict_priority"]
