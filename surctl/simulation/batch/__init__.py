"""The closed loop as one compiled block that simulates many runs at once."""

from surctl.simulation.batch.case import Case, Parameter, check_speeds, parameters
from surctl.simulation.batch.engines import ENGINES, BatchResult, Engine, SlowerEngine, simulate_batch
from surctl.simulation.batch.loop import Loop, Structure, build_loop

__all__ = [
    "ENGINES",
    "BatchResult",
    "Case",
    "Engine",
    "Loop",
    "Parameter",
    "SlowerEngine",
    "Structure",
    "build_loop",
    "check_speeds",
    "parameters",
    "simulate_batch",
]
