"""The controller: gain files, velocity control, and control laws (each law is one object)."""

from surctl.marine.control.build import MODES, build_law, law_options
from surctl.marine.control.decision import Decision, Situation, TaskLevel
from surctl.marine.control.gains import GAINS, LIBRARY, Gains, GainSpec, load_gains, write_gains
from surctl.marine.control.law import DEGRADED, SATURATED, SWITCHED, TRAPPED, WORKING, Law
from surctl.marine.control.ports import ARC_LENGTHS, CONTACT_SLOTS, FED, INPUTS, PARAMETERS
from surctl.marine.control.registry import LAW_NAMES, LAWS, SONARLESS, check_forces, default_law, law_ref, law_source
from surctl.marine.control.source import AVOIDANCE, BARRIER, PATH_FOLLOWING, LawSource
from surctl.marine.control.stopping import BARRIER_NAMES, MOVERS, Barrier, Movers
from surctl.system import NONFINITE

__all__ = [
    "ARC_LENGTHS",
    "AVOIDANCE",
    "BARRIER",
    "BARRIER_NAMES",
    "CONTACT_SLOTS",
    "DEGRADED",
    "FED",
    "GAINS",
    "INPUTS",
    "LAWS",
    "LAW_NAMES",
    "LIBRARY",
    "MODES",
    "MOVERS",
    "NONFINITE",
    "PARAMETERS",
    "PATH_FOLLOWING",
    "SATURATED",
    "SONARLESS",
    "SWITCHED",
    "TRAPPED",
    "WORKING",
    "Barrier",
    "Decision",
    "GainSpec",
    "Gains",
    "Law",
    "LawSource",
    "Movers",
    "Situation",
    "TaskLevel",
    "build_law",
    "check_forces",
    "default_law",
    "law_options",
    "law_ref",
    "law_source",
    "load_gains",
    "write_gains",
]
