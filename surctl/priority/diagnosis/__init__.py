"""Analysis of a task stack before a run: whether NSB equals strict priority, which tasks conflict, singular poses."""

from __future__ import annotations

from surctl.priority.diagnosis.diagnose import Diagnosis, diagnose
from surctl.priority.diagnosis.laws import commutator_norms

__all__ = ["Diagnosis", "commutator_norms", "diagnose"]
