"""Analysis of a task stack before a run: whether NSB equals strict priority, which tasks conflict, singular poses."""

from __future__ import annotations

from surctl.priority.diagnosis.diagnose import diagnose
from surctl.priority.diagnosis.field import commutator_norms, equals_strict_priority
from surctl.priority.diagnosis.findings import Diagnosis

__all__ = ["Diagnosis", "commutator_norms", "diagnose", "equals_strict_priority"]
