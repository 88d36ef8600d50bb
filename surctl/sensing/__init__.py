"""What the robot feels: the sonar array, its filters, contacts, and what the base station tells."""

from surctl.sensing.array import SonarArray, fire, true_range
from surctl.sensing.base_station import BaseStation, OwnState
from surctl.sensing.estimate import ContactMemory, Contacts, expected_range, sonar_contacts
from surctl.sensing.filters import FilterUpdate, LmsStep, SensorFilter, gate, lms_step, weighted_average
from surctl.sensing.table2 import RangeTest, table_ii

__all__ = [
    "BaseStation",
    "ContactMemory",
    "Contacts",
    "FilterUpdate",
    "LmsStep",
    "OwnState",
    "RangeTest",
    "SensorFilter",
    "SonarArray",
    "expected_range",
    "fire",
    "gate",
    "lms_step",
    "sonar_contacts",
    "table_ii",
    "true_range",
    "weighted_average",
]
