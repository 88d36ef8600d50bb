"""The vehicle: parameters, equations (1)–(3) of the paper (kinematics, dynamics), linearisation, identification."""

from surctl.vehicle.attainable import Attainable, attainable
from surctl.vehicle.dynamics import (
    PLANT_DISTURBANCE,
    PLANT_PARAMETERS,
    PLANT_STATE,
    Plant,
    build_plant,
    check_equation_3,
    plant_layout,
    plant_parameters,
    plant_state,
    steady_speed,
    trim_thrust,
)
from surctl.vehicle.frames import FRAME_TEXT, FRAMES, Frame, check_frame, heading_velocity, swap_body, swap_pose
from surctl.vehicle.geometry import sphere
from surctl.vehicle.identify import FITTED, Identified, identify
from surctl.vehicle.iosystem import plant_system
from surctl.vehicle.kinematics import jacobian, planar_rotation
from surctl.vehicle.linearise import linearise, plant_jacobians
from surctl.vehicle.motion_log import LOG_MOTION, LOG_THRUST, MotionLog, read_motion_log
from surctl.vehicle.parameters import LIBRARY, Parameter, Vehicle, load_vehicle
from surctl.vehicle.specs import PARAMETERS, TERMS, ParameterSpec, PlantForm, parameter_spec
from surctl.vehicle.thrusters import DEFAULT_ORDER, Actuators, Swivel, Thruster
from surctl.vehicle.vehicle_file import write_vehicle

__all__ = [
    "DEFAULT_ORDER",
    "FITTED",
    "FRAMES",
    "FRAME_TEXT",
    "LIBRARY",
    "LOG_MOTION",
    "LOG_THRUST",
    "PARAMETERS",
    "PLANT_DISTURBANCE",
    "PLANT_PARAMETERS",
    "PLANT_STATE",
    "TERMS",
    "Actuators",
    "Attainable",
    "Frame",
    "Identified",
    "MotionLog",
    "Parameter",
    "ParameterSpec",
    "Plant",
    "PlantForm",
    "Swivel",
    "Thruster",
    "Vehicle",
    "attainable",
    "build_plant",
    "check_equation_3",
    "check_frame",
    "heading_velocity",
    "identify",
    "jacobian",
    "linearise",
    "load_vehicle",
    "parameter_spec",
    "planar_rotation",
    "plant_jacobians",
    "plant_layout",
    "plant_parameters",
    "plant_state",
    "plant_system",
    "read_motion_log",
    "sphere",
    "steady_speed",
    "swap_body",
    "swap_pose",
    "trim_thrust",
    "write_vehicle",
]
