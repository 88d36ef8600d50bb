"""The closed loop as one compiled function that simulates many runs at once."""

from surctl.marine.simulation.batch.case import Case, CaseParameter, case_parameters, check_speeds
from surctl.marine.simulation.batch.engines import ENGINES, BatchResult, Engine, SlowerEngine, simulate_batch
from surctl.marine.simulation.batch.loop import Loop, Structure, build_loop

__all__ = [
    "ENGINES",
    "BatchResult",
    "Case",
    "CaseParameter",
    "Engine",
    "Loop",
    "SlowerEngine",
    "Structure",
    "build_loop",
    "case_parameters",
    "check_speeds",
    "simulate_batch",
]
