"""Scenarios as files, the world of a run, the reference closed loop, many loops at once, and their metrics."""

from surctl.simulation.batch import (
    ENGINES,
    BatchResult,
    Case,
    Engine,
    Knob,
    SlowerEngine,
    check_speeds,
    knobs,
    simulate_batch,
)
from surctl.simulation.disturbance import Disturbance
from surctl.simulation.explanation import Explanation, explain
from surctl.simulation.fit import Finding, findings
from surctl.simulation.halting import halt_reason
from surctl.simulation.metrics import HALT, METRICS, STOOD, STOPS, Metrics, MetricSpec
from surctl.simulation.obstacle import Obstacle
from surctl.simulation.paper_figure import PaperFigure
from surctl.simulation.record import Record
from surctl.simulation.run import SENSING, Run, Sensing, advance, law_numbers, simulate
from surctl.simulation.safety import SafetyClaim, safety_claim
from surctl.simulation.scenario import LIBRARY, Scenario, load_scenario
from surctl.simulation.sensors import Sensors
from surctl.simulation.world import Body, World, build_world

__all__ = [
    "ENGINES",
    "HALT",
    "LIBRARY",
    "METRICS",
    "SENSING",
    "STOOD",
    "STOPS",
    "BatchResult",
    "Body",
    "Case",
    "Disturbance",
    "Engine",
    "Explanation",
    "Finding",
    "Knob",
    "MetricSpec",
    "Metrics",
    "Obstacle",
    "PaperFigure",
    "Record",
    "Run",
    "SafetyClaim",
    "Scenario",
    "Sensing",
    "Sensors",
    "SlowerEngine",
    "World",
    "advance",
    "build_world",
    "check_speeds",
    "explain",
    "findings",
    "halt_reason",
    "knobs",
    "law_numbers",
    "load_scenario",
    "safety_claim",
    "simulate",
    "simulate_batch",
]
