"""Scenario files, the simulated world, the closed loop of one run and of batches, metrics, and findings of `lint`."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.marine.simulation.batch.case import Case, case_parameters
    from surctl.marine.simulation.batch.engines import BatchResult, simulate_batch
    from surctl.marine.simulation.explanation import explain, priority_timeline, stop_reason, time_limit_reason
    from surctl.marine.simulation.fit import findings, held_share, thruster_findings
    from surctl.marine.simulation.loop import simulate
    from surctl.marine.simulation.metrics import METRICS, STOPS, Metrics
    from surctl.marine.simulation.mission_system import mission_system
    from surctl.marine.simulation.numbers import law_numbers
    from surctl.marine.simulation.obstacle import Obstacle
    from surctl.marine.simulation.physics import Contact, OwnPhysics, Physics
    from surctl.marine.simulation.plan_file import Mission, mission_scenario, read_mission
    from surctl.marine.simulation.record_file import RUN_FORMATS, save_record, save_scene
    from surctl.marine.simulation.reflectors import ECHOES, Reflectors
    from surctl.marine.simulation.run import SENSING, Record, Run, Sensing, depth_changes
    from surctl.marine.simulation.safety import SafetyClaim, margin_needed, safety_claim, turn_rate
    from surctl.marine.simulation.scaling import (
        disturbed,
        mission_size,
        scaled_scenario,
        straight_mission,
        two_leg_mission,
    )
    from surctl.marine.simulation.scenario import (
        LIBRARY,
        Disturbance,
        Finding,
        PaperFigure,
        Scenario,
        load_scenario,
    )
    from surctl.marine.simulation.sensors import Sensors
    from surctl.marine.simulation.thruster_faults import ThrusterFault, thruster_use
    from surctl.marine.simulation.world import Body, World, build_world

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
    "build_world",
    "case_parameters",
    "depth_changes",
    "disturbed",
    "explain",
    "findings",
    "held_share",
    "law_numbers",
    "load_scenario",
    "margin_needed",
    "mission_scenario",
    "mission_size",
    "mission_system",
    "priority_timeline",
    "read_mission",
    "safety_claim",
    "save_record",
    "save_scene",
    "scaled_scenario",
    "simulate",
    "simulate_batch",
    "stop_reason",
    "straight_mission",
    "thruster_findings",
    "thruster_use",
    "time_limit_reason",
    "turn_rate",
    "two_leg_mission",
]

load_at_first_use(__name__)
