"""The library behind the commands: what a command uses is loaded when it is first needed, so commands start fast."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.assessment import Assessment, Figure, Part, assess
    from surctl.export import Records, SerialLine, connect, emulated, emulated_target
    from surctl.export.bundle import check_folder
    from surctl.export.envelope import as_records
    from surctl.export.prove import gain_box
    from surctl.files import file_name, prepare_folder, read_toml, validate, write_file
    from surctl.ir.cache import find_compiler, stored_numbers
    from surctl.lyapunov import load_problem
    from surctl.marine.allocation import allocate, working_flags
    from surctl.marine.assessment import LoopAnalysis, Mission, assumptions, judged_contact, missions_of
    from surctl.marine.bridge import Act, Bridge, Ended, LinkQuality, RehearsalResult, SessionRecord, SimulatedSub, Wire
    from surctl.marine.bridge.bridge import plan_session
    from surctl.marine.bridge.inputs import parse_site
    from surctl.marine.bridge.live import Address, parse_address, run_session
    from surctl.marine.bridge.rehearsal import ACTIONS, rehearse
    from surctl.marine.bridge.wire import mode_of
    from surctl.marine.control import (
        BARRIER, BARRIER_NAMES, GainSpec, Gains, LAW_NAMES, Law, MOVERS, PATH_FOLLOWING, check_forces, default_law,
        law_ref, law_source, load_gains, write_gains,
    )  # fmt: skip
    from surctl.marine.engine import BatchCase, EngineOptions, mujoco_physics
    from surctl.marine.engine.fluid import parse_plant
    from surctl.marine.engine.mjcf import mujoco_library, write_mjcf
    from surctl.marine.engine.physics import simulate_with_steppers
    from surctl.marine.engine.pictures import check_pictures, check_screen, watched
    from surctl.marine.export import CompiledLaw, LinkFaults, LinkedLaw, build_bundle, closed_form, operating_envelope
    from surctl.marine.export.origin import fitting_certificates, load_certificates, origin_of
    from surctl.marine.export.robot_bundle import replay_of
    from surctl.marine.guidance import MAX_WAYPOINTS
    from surctl.marine.report import (
        plot_attainable, plot_mission, plot_prediction, plot_priority, plot_region, save_animation, save_film, save_run,
    )  # fmt: skip
    from surctl.marine.report.animation import check_animation
    from surctl.marine.report.bench import Bench
    from surctl.marine.report.files import run_labels, save_margins, save_tuning, save_verdicts
    from surctl.marine.report.goals import COLUMN_TITLES, SHOWN
    from surctl.marine.report.plan_view import describe
    from surctl.marine.reproduction import Row, reproduce
    from surctl.marine.reproduction.reproduction import write_reproduction
    from surctl.marine.sensing import FAULT_KINDS, Fault, FaultChances, OwnState, SonarArray
    from surctl.marine.sensing.sonar.faults import check_faults
    from surctl.marine.simulation import (
        Case, ECHOES, LIBRARY as SCENARIOS, METRICS, OwnPhysics, RUN_FORMATS, Run, SENSING, SafetyClaim,
        Scenario, Sensing, ThrusterFault, explain, findings, law_numbers, load_scenario, priority_timeline, save_record,
        simulate, vehicle_law,
    )  # fmt: skip
    from surctl.marine.simulation.campaign.campaign import Campaign, CampaignFolder, law_of, load_replay, run_campaign
    from surctl.marine.simulation.campaign.worlds import (
        MonteCarlo, Plan as CampaignPlan, RandomWorlds, WORLDS_VEHICLE, world_template,
    )  # fmt: skip
    from surctl.marine.simulation.clearance import start_findings
    from surctl.marine.simulation.echo_fit import level_findings
    from surctl.marine.simulation.explanation import failure, stop_reason
    from surctl.marine.simulation.fit import held_share, thruster_findings
    from surctl.marine.simulation.loop import simulate_case
    from surctl.marine.simulation.numbers import fed_ranges
    from surctl.marine.simulation.plan_file import mission_scenario, read_mission
    from surctl.marine.simulation.run import depth_changes
    from surctl.marine.simulation.scaling import mission_size, straight_mission
    from surctl.marine.simulation.sensors import Sensors, SonarTable
    from surctl.marine.simulation.thruster_faults import thruster_use
    from surctl.marine.study import Plan, Study, load_plan
    from surctl.marine.study.conduct import assessed
    from surctl.marine.tuning import (
        Derivation, Goal, MissionSweep, Request, build_cases, conditions, default_cruise, derive_gains, gain_ranges,
        gains_for, load_goals, picked_gains, tuned_gains,
    )  # fmt: skip
    from surctl.marine.tuning.derived import REQUIRED, has_tuned, shared_gains
    from surctl.marine.tuning.evaluation import check_goals, judged_goals
    from surctl.marine.tuning.goals import goals_at, with_floor
    from surctl.marine.tuning.request import default_tuned
    from surctl.marine.tuning.sweep import check_column
    from surctl.marine.vehicle import (
        Identified, LIBRARY as VEHICLES, MotionLog, Prediction, Vehicle, identify, load_vehicle, sphere, write_vehicle,
    )  # fmt: skip
    from surctl.marine.vehicle.gazebo import gazebo_vehicle
    from surctl.marine.vehicle.identification.identify import held_out_windows
    from surctl.marine.vehicle.identification.model import LONGEST
    from surctl.marine.vehicle.linearise import WITHIN_LAW, beyond_law, command_range
    from surctl.marine.vehicle.logs.joining import load_log_map
    from surctl.marine.vehicle.logs.read import FORMATS, read_mapped_log, read_recording, topic_lines
    from surctl.marine.vehicle.motion_log import check_frame, in_sequence, read_motion_log
    from surctl.marine.vehicle.specs import AXES, undamped
    from surctl.marine.vehicle.thruster_file import axis_ends
    from surctl.marine.verification import law_corners, sonar_margins, sweep_locus
    from surctl.marine.verification.braking import braking_claim_named, prove_braking
    from surctl.marine.verification.braking_claims import NOT_RESTED_ON
    from surctl.marine.verification.corners import corners
    from surctl.marine.verification.cruise_loop import TRACKING_LAW, has_cruise_loop
    from surctl.marine.verification.library import applicable_claims
    from surctl.marine.verification.linear import bearable_speed, cap_above, slowest_mode
    from surctl.marine.verification.mission import USUAL, prove_scenario, slower
    from surctl.marine.verification.region import (
        RegionStatement, applicable_region, load_region, prove_statement, region_statement, write_region,
    )  # fmt: skip
    from surctl.marine.verification.speeds import OverSpeeds, check_held, cruise_speeds, slow_margins
    from surctl.own_code import label, own_file
    from surctl.priority import check_fallback
    from surctl.report import plot_locus
    from surctl.report.theme import save_figure
    from surctl.system import LinearLoop
    from surctl.tuning import SobolIndices, Span, SweepTable, Tuning, load_loop_goals, make_design, parse_axis, saltelli
    from surctl.tuning.loop_responses import sensitivity_curves
    from surctl.tuning.outcome import Finals, Miss
    from surctl.units import in_unit, number_and_unit
    from surctl.verification import Claim, Inapplicable, LoopCorners, Verdict, decide, load_claim
    from surctl.verification.claim_file import write_claim
    from surctl.verification.formula import Statement, text_of
    from surctl.verification.formula.parser import clipped
    from surctl.verification.linear import LEAST_DISK_MARGIN, short_margin

load_at_first_use(__name__, cache=False)
