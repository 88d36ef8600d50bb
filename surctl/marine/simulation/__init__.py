"""Scenario files, the simulated world, the closed loop of one run and of batches, metrics, and findings of `lint`."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.errors import Finding
    from surctl.marine.simulation.batch.case import Case, law_numbers, vehicle_law
    from surctl.marine.simulation.batch.engines import BatchResult, simulate_batch
    from surctl.marine.simulation.explanation import explain, priority_timeline
    from surctl.marine.simulation.fit import findings
    from surctl.marine.simulation.loop import simulate
    from surctl.marine.simulation.metrics import METRICS, STOPS, Metrics
    from surctl.marine.simulation.mission_system import mission_system
    from surctl.marine.simulation.obstacle import Obstacle
    from surctl.marine.simulation.physics import Contact, OwnPhysics, Physics
    from surctl.marine.simulation.plan_file import Mission
    from surctl.marine.simulation.record_file import RUN_FORMATS, save_record
    from surctl.marine.simulation.reflectors import ECHOES, Reflectors
    from surctl.marine.simulation.run import SENSING, Record, Run, Sensing
    from surctl.marine.simulation.safety import SafetyClaim
    from surctl.marine.simulation.scenario import (
        LIBRARY,
        Disturbance,
        PaperFigure,
        Scenario,
        load_scenario,
    )
    from surctl.marine.simulation.sensors import Sensors
    from surctl.marine.simulation.thruster_faults import ThrusterFault
    from surctl.marine.simulation.world import Body, World

__all__ = [
    "ECHOES",
    "LIBRARY",
    "METRICS",
    "RUN_FORMATS",
    "SENSING",
    "STOPS",
    "BatchResult",
    "Body",
    "Case",
    "Contact",
    "Disturbance",
    "Finding",
    "Metrics",
    "Mission",
    "Obstacle",
    "OwnPhysics",
    "PaperFigure",
    "Physics",
    "Record",
    "Reflectors",
    "Run",
    "SafetyClaim",
    "Scenario",
    "Sensing",
    "Sensors",
    "ThrusterFault",
    "World",
    "explain",
    "findings",
    "law_numbers",
    "load_scenario",
    "mission_system",
    "priority_timeline",
    "save_record",
    "simulate",
    "simulate_batch",
    "vehicle_law",
]

load_at_first_use(__name__)
