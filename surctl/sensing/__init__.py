"""What the robot feels: the sonar array, its filters, contacts, and what the base station tells."""

from surctl.sensing.array import SonarArray, fire, true_range
from surctl.sensing.base_station import BaseStation, OwnState
from surctl.sensing.echo import heard_samples, range_to_box, range_to_disc, range_to_walls
from surctl.sensing.estimate import ContactMemory, Contacts, expected_range, sonar_contacts
from surctl.sensing.filters import FilterUpdate, LmsStep, SensorFilter, gate, lms_step, weighted_average
from surctl.sensing.noise import NOISE_STATE, NoiseStream, draw_normals, noise_states
from surctl.sensing.plain import (
    PlainLmsStep,
    PlainUpdate,
    plain_average,
    plain_filter,
    plain_gate,
    plain_lms_step,
)
from surctl.sensing.ranging import RangeTracker, Ranging
from surctl.sensing.table2 import RangeTest, table_ii

__all__ = [
    "NOISE_STATE",
    "BaseStation",
    "ContactMemory",
    "Contacts",
    "FilterUpdate",
    "LmsStep",
    "NoiseStream",
    "OwnState",
    "PlainLmsStep",
    "PlainUpdate",
    "RangeTest",
    "RangeTracker",
    "Ranging",
    "SensorFilter",
    "SonarArray",
    "draw_normals",
    "expected_range",
    "fire",
    "gate",
    "heard_samples",
    "lms_step",
    "noise_states",
    "plain_average",
    "plain_filter",
    "plain_gate",
    "plain_lms_step",
    "range_to_box",
    "range_to_disc",
    "range_to_walls",
    "sonar_contacts",
    "table_ii",
    "true_range",
    "weighted_average",
]
