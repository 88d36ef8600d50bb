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
        plant_layout,
        plant_parameters,
        plant_state,
        plant_thrust_limit,
        steady_speed,
        trim_thrust,
    )
    from surctl.marine.vehicle.geometry import GRAVITY, WATER, sphere
    from surctl.marine.vehicle.identification.identify import HELD_OUT, Identified, identify
    from surctl.marine.vehicle.identification.model import CONSTANT_FORCE, FITTED
    from surctl.marine.vehicle.identification.prediction import Prediction, predict
    from surctl.marine.vehicle.linearise import linearise, vehicle_plant
    from surctl.marine.vehicle.motion_log import FRAME_TEXT, FRAMES, LOG_MOTION, LOG_THRUST, LOG_TILT, Frame, MotionLog
    from surctl.marine.vehicle.parameters import LIBRARY, Parameter, Vehicle, load_vehicle, write_vehicle
    from surctl.marine.vehicle.specs import PARAMETERS, SPECS, TERMS, ParameterSpec, PlantForm
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
    "SPECS",
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
    "build_plant",
    "identify",
    "jacobian",
    "linearise",
    "load_vehicle",
    "planar_rotation",
    "plant_layout",
    "plant_parameters",
    "plant_state",
    "plant_thrust_limit",
    "predict",
    "sphere",
    "steady_speed",
    "trim_thrust",
    "vehicle_plant",
    "write_vehicle",
]

load_at_first_use(__name__)
