"""The closed loop as one block: many runs at once, compiled."""

from surctl.simulation.batch.case import Case, Knob, check_speeds, knobs
from surctl.simulation.batch.fly import ENGINES, BatchResult, Engine, SlowerEngine, simulate_batch
from surctl.simulation.batch.tick import Loop, Structure, build_loop

__all__ = [
    "ENGINES",
    "BatchResult",
    "Case",
    "Engine",
    "Knob",
    "Loop",
    "SlowerEngine",
    "Structure",
    "build_loop",
    "check_speeds",
    "knobs",
    "simulate_batch",
]
