"""What moves: parameters with provenance, kinematics (1)–(2), dynamics (3), linearisation."""

from surctl.vehicle.dynamics import (
    PLANT_DISTURBANCE,
    PLANT_PARAMETERS,
    PLANT_STATE,
    Plant,
    build_plant,
    plant_parameters,
    steady_speed,
    trim_thrust,
)
from surctl.vehicle.kinematics import jacobian, planar_rotation
from surctl.vehicle.linearise import linearise, plant_jacobians
from surctl.vehicle.parameters import LIBRARY, PARAMETERS, Parameter, Vehicle, load_vehicle

__all__ = [
    "LIBRARY",
    "PARAMETERS",
    "PLANT_DISTURBANCE",
    "PLANT_PARAMETERS",
    "PLANT_STATE",
    "Parameter",
    "Plant",
    "Vehicle",
    "build_plant",
    "jacobian",
    "linearise",
    "load_vehicle",
    "planar_rotation",
    "plant_jacobians",
    "plant_parameters",
    "steady_speed",
    "trim_thrust",
]
