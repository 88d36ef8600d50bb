"""Scenario files, the simulated world, the reference closed loop, batches of closed loops, and their metrics."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.marine.simulation.batch import (
        ENGINES,
        BatchResult,
        Case,
        CaseParameter,
        Engine,
        SlowerEngine,
        case_parameters,
        check_speeds,
        simulate_batch,
    )
    from surctl.marine.simulation.explanation import Explanation, explain, priority_timeline
    from surctl.marine.simulation.fit import Finding, findings, held_share, thruster_findings
    from surctl.marine.simulation.iosystem import ClosedLoopSystem, closed_loop_system
    from surctl.marine.simulation.loop import Stepper, simulate
    from surctl.marine.simulation.margin import margin_needed, turn_rate
    from surctl.marine.simulation.metrics import (
        GONE,
        LATE,
        LINK_LOST,
        METRICS,
        STANDSTILL,
        STOPPED_LIMIT,
        STOPS,
        Metrics,
        MetricSpec,
    )
    from surctl.marine.simulation.numbers import law_numbers
    from surctl.marine.simulation.obstacle import Obstacle
    from surctl.marine.simulation.physics import Contact, OwnPhysics, Physics, PhysicsMaker, advance
    from surctl.marine.simulation.plan_file import Mission, mission_scenario, read_mission
    from surctl.marine.simulation.record_file import (
        LAYOUT,
        RECORD_FORMATS,
        RUN_FORMATS,
        RecordFormat,
        SceneFile,
        record_columns,
        save_record,
        save_scene,
        write_layout,
    )
    from surctl.marine.simulation.reflectors import ECHOES, EchoModel, Reflectors
    from surctl.marine.simulation.run import (
        SENSING,
        Attitude,
        DepthChange,
        Record,
        Run,
        Sensing,
        attitude_of,
        depth_changes,
    )
    from surctl.marine.simulation.safety import SafetyClaim, safety_claim
    from surctl.marine.simulation.scaling import (
        disturbed,
        mission_size,
        scaled_scenario,
        straight_mission,
        two_leg_mission,
    )
    from surctl.marine.simulation.scenario import LIBRARY, Disturbance, PaperFigure, Scenario, load_scenario
    from surctl.marine.simulation.sensors import Sensors
    from surctl.marine.simulation.stopping import stop_reason, time_limit_reason
    from surctl.marine.simulation.thruster_faults import ThrusterFault, ThrusterUse, thruster_use
    from surctl.marine.simulation.world import Body, World, build_world

__all__ = [
    "ECHOES",
    "ENGINES",
    "GONE",
    "LATE",
    "LAYOUT",
    "LIBRARY",
    "LINK_LOST",
    "METRICS",
    "RECORD_FORMATS",
    "RUN_FORMATS",
    "SENSING",
    "STANDSTILL",
    "STOPPED_LIMIT",
    "STOPS",
    "Attitude",
    "BatchResult",
    "Body",
    "Case",
    "CaseParameter",
    "ClosedLoopSystem",
    "Contact",
    "DepthChange",
    "Disturbance",
    "EchoModel",
    "Engine",
    "Explanation",
    "Finding",
    "MetricSpec",
    "Metrics",
    "Mission",
    "Obstacle",
    "OwnPhysics",
    "PaperFigure",
    "Physics",
    "PhysicsMaker",
    "Record",
    "RecordFormat",
    "Reflectors",
    "Run",
    "SafetyClaim",
    "Scenario",
    "SceneFile",
    "Sensing",
    "Sensors",
    "SlowerEngine",
    "Stepper",
    "ThrusterFault",
    "ThrusterUse",
    "World",
    "advance",
    "attitude_of",
    "build_world",
    "case_parameters",
    "check_speeds",
    "closed_loop_system",
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
    "priority_timeline",
    "read_mission",
    "record_columns",
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
    "write_layout",
]

load_at_first_use(
    __name__,
    {
        "batch": "ENGINES BatchResult Case CaseParameter Engine SlowerEngine case_parameters check_speeds"
        " simulate_batch",
        "explanation": "Explanation explain priority_timeline",
        "fit": "Finding findings held_share thruster_findings",
        "iosystem": "ClosedLoopSystem closed_loop_system",
        "loop": "Stepper simulate",
        "margin": "margin_needed turn_rate",
        "metrics": "GONE LATE LINK_LOST METRICS STANDSTILL STOPPED_LIMIT STOPS MetricSpec Metrics",
        "numbers": "law_numbers",
        "obstacle": "Obstacle",
        "physics": "Contact OwnPhysics Physics PhysicsMaker advance",
        "plan_file": "Mission mission_scenario read_mission",
        "record_file": "LAYOUT RECORD_FORMATS RUN_FORMATS RecordFormat SceneFile record_columns save_record save_scene"
        " write_layout",
        "reflectors": "ECHOES EchoModel Reflectors",
        "run": "Attitude DepthChange Record Run SENSING Sensing attitude_of depth_changes",
        "safety": "SafetyClaim safety_claim",
        "scaling": "disturbed mission_size scaled_scenario straight_mission two_leg_mission",
        "scenario": "LIBRARY Disturbance PaperFigure Scenario load_scenario",
        "sensors": "Sensors",
        "stopping": "stop_reason time_limit_reason",
        "thruster_faults": "ThrusterFault ThrusterUse thruster_use",
        "world": "Body World build_world",
    },
)
