"""What the robot feels: the sonar array, its filters, contacts, and what the base station tells."""

from surctl.sensing.array import SonarArray, fire, heard, true_range
from surctl.sensing.base_station import BaseStation, OwnState
from surctl.sensing.echo import Beam, beam_of, echo_range, heard_samples
from surctl.sensing.estimate import ContactMemory, Contacts, expected_range, sonar_contacts
from surctl.sensing.filters import FilterUpdate, LmsStep, SensorFilter, gate, lms_step, weighted_average
from surctl.sensing.noise import NOISE_STATE, NoiseStream, draw_normals, noise_states
from surctl.sensing.solids import Cone, Solid, SolidBox, SolidDisc, SolidWalls
from surctl.sensing.sound import Medium, speed_of_sound
from surctl.sensing.table2 import RangeTest, table_ii

__all__ = [
    "NOISE_STATE",
    "BaseStation",
    "Beam",
    "Cone",
    "ContactMemory",
    "Contacts",
    "FilterUpdate",
    "LmsStep",
    "Medium",
    "NoiseStream",
    "OwnState",
    "RangeTest",
    "SensorFilter",
    "Solid",
    "SolidBox",
    "SolidDisc",
    "SolidWalls",
    "SonarArray",
    "beam_of",
    "draw_normals",
    "echo_range",
    "expected_range",
    "fire",
    "gate",
    "heard",
    "heard_samples",
    "lms_step",
    "noise_states",
    "sonar_contacts",
    "speed_of_sound",
    "table_ii",
    "true_range",
    "weighted_average",
]
