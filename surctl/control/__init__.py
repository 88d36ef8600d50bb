"""The controller: gain files, velocity control, and control laws, each as one object."""

from surctl.control.build import MODES, build_law
from surctl.control.gains import GAINS, LIBRARY, Gains, load_gains, write_gains
from surctl.control.law import (
    DEGRADED,
    NONFINITE,
    SATURATED,
    SWITCHED,
    TRAPPED,
    Law,
    LawStep,
)
from surctl.control.ports import CONTACT_SLOTS, INPUTS, PARAMETERS, law_inputs, law_parameters
from surctl.control.registry import LAW_NAMES, LAWS, LawName
from surctl.control.routines import in_real
from surctl.control.stopping import BARRIER_NAMES, MOVERS, Barrier, Movers

__all__ = [
    "BARRIER_NAMES",
    "CONTACT_SLOTS",
    "DEGRADED",
    "GAINS",
    "INPUTS",
    "LAWS",
    "LAW_NAMES",
    "LIBRARY",
    "MODES",
    "MOVERS",
    "NONFINITE",
    "PARAMETERS",
    "SATURATED",
    "SWITCHED",
    "TRAPPED",
    "Barrier",
    "Gains",
    "Law",
    "LawName",
    "LawStep",
    "Movers",
    "build_law",
    "in_real",
    "law_inputs",
    "law_parameters",
    "load_gains",
    "write_gains",
]
