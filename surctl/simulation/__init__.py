"""Scenarios as files, the world of a run, the reference closed loop and its metrics."""

from surctl.simulation.explanation import Explanation, explain
from surctl.simulation.fit import Finding, findings
from surctl.simulation.metrics import Metrics
from surctl.simulation.run import SENSING, Record, Run, Sensing, advance, simulate
from surctl.simulation.scenario import LIBRARY, Obstacle, Scenario, load_scenario
from surctl.simulation.world import Body, World, build_world

__all__ = [
    "LIBRARY",
    "SENSING",
    "Body",
    "Explanation",
    "Finding",
    "Metrics",
    "Obstacle",
    "Record",
    "Run",
    "Scenario",
    "Sensing",
    "World",
    "advance",
    "build_world",
    "explain",
    "findings",
    "load_scenario",
    "simulate",
]
