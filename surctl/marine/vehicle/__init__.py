"""The vehicle: parameters, equations (1)–(3) of the paper (kinematics, dynamics), linearisation, identification."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use
from surctl.tasks.task import jacobian, planar_rotation

if TYPE_CHECKING:
    from surctl.marine.vehicle.dynamics import (
        PLANT_DISTURBANCE,
        PLANT_PARAMETERS,
        PLANT_STATE,
        Plant,
        build_plant,
        check_equation_3,
        plant_layout,
        plant_parameters,
        plant_state,
        plant_thrust_limit,
        steady_speed,
        trim_thrust,
    )
    from surctl.marine.vehicle.gazebo import gazebo_vehicle
    from surctl.marine.vehicle.geometry import GRAVITY, WATER, floating_depth, missing_buoyancy, sphere
    from surctl.marine.vehicle.identification.identify import (
        HELD_OUT,
        Identified,
        held_out_windows,
        identify,
        velocity_notes,
    )
    from surctl.marine.vehicle.identification.model import CONSTANT_FORCE, FITTED
    from surctl.marine.vehicle.identification.prediction import Prediction, predict, predict_with
    from surctl.marine.vehicle.linearise import linearise, plant_jacobians, plant_system
    from surctl.marine.vehicle.logs.read import read_mapped_log, read_recording, topic_lines
    from surctl.marine.vehicle.motion_log import (
        FRAME_TEXT,
        FRAMES,
        LOG_MOTION,
        LOG_THRUST,
        LOG_TILT,
        Frame,
        MotionLog,
        check_frame,
        heading_velocity,
        in_sequence,
        read_motion_log,
        swap_body,
        swap_pose,
    )
    from surctl.marine.vehicle.parameters import LIBRARY, Parameter, Vehicle, load_vehicle, write_vehicle
    from surctl.marine.vehicle.specs import PARAMETERS, TERMS, ParameterSpec, PlantForm, parameter_spec
    from surctl.marine.vehicle.thruster_file import axis_ends, axis_limits
    from surctl.marine.vehicle.thrusters import DEFAULT_ORDER, Actuators, Attainable, Fin, Swivel, Thruster, attainable

__all__ = [
    "CONSTANT_FORCE",
    "DEFAULT_ORDER",
    "FITTED",
    "FRAMES",
    "FRAME_TEXT",
    "GRAVITY",
    "HELD_OUT",
    "LIBRARY",
    "LOG_MOTION",
    "LOG_THRUST",
    "LOG_TILT",
    "PARAMETERS",
    "PLANT_DISTURBANCE",
    "PLANT_PARAMETERS",
    "PLANT_STATE",
    "TERMS",
    "WATER",
    "Actuators",
    "Attainable",
    "Fin",
    "Frame",
    "Identified",
    "MotionLog",
    "Parameter",
    "ParameterSpec",
    "Plant",
    "PlantForm",
    "Prediction",
    "Swivel",
    "Thruster",
    "Vehicle",
    "attainable",
    "axis_ends",
    "axis_limits",
    "build_plant",
    "check_equation_3",
    "check_frame",
    "floating_depth",
    "gazebo_vehicle",
    "heading_velocity",
    "held_out_windows",
    "identify",
    "in_sequence",
    "jacobian",
    "linearise",
    "load_vehicle",
    "missing_buoyancy",
    "parameter_spec",
    "planar_rotation",
    "plant_jacobians",
    "plant_layout",
    "plant_parameters",
    "plant_state",
    "plant_system",
    "plant_thrust_limit",
    "predict",
    "predict_with",
    "read_mapped_log",
    "read_motion_log",
    "read_recording",
    "sphere",
    "steady_speed",
    "swap_body",
    "swap_pose",
    "topic_lines",
    "trim_thrust",
    "velocity_notes",
    "write_vehicle",
]

load_at_first_use(__name__)
