"""What the robot feels: the sonar array, its filters, contacts, and what the base station tells."""

from surctl.sensing.array import SonarArray, fire, heard, true_range
from surctl.sensing.base_station import BaseStation, OwnState
from surctl.sensing.delivery import Delivery, delayed, delayed_symbols
from surctl.sensing.echo import Beam, beam_of, echo_range, heard_samples
from surctl.sensing.equipment import Equipment
from surctl.sensing.estimate import ContactMemory, Contacts, expected_range, sonar_contacts
from surctl.sensing.fault_block import SLOT, Arrival, fault_ports, fault_slots, faulty_samples
from surctl.sensing.faults import (
    FAULT_KINDS,
    LONGEST_DELAY,
    Fault,
    FaultChances,
    FaultKind,
    FaultState,
    check_faults,
    fault_state,
    faulty,
)
from surctl.sensing.filters import FilterUpdate, LmsStep, SensorFilter, gate, lms_step, weighted_average
from surctl.sensing.local_map import LocalMap
from surctl.sensing.movers import Movers, MoverTracker, mover_step
from surctl.sensing.noise import NOISE_STATE, NoiseStream, draw_normals, draw_uniforms, noise_states
from surctl.sensing.own_state import OwnEstimate, OwnStateFilter
from surctl.sensing.own_state_numbers import own_state_step
from surctl.sensing.plain import PlainLmsStep, PlainUpdate, plain_average, plain_filter, plain_gate, plain_lms_step
from surctl.sensing.ranging import RangeTracker, Ranging
from surctl.sensing.solids import Cone, Solid, SolidBox, SolidDisc, SolidWalls
from surctl.sensing.sound import Medium, speed_of_sound
from surctl.sensing.table2 import RangeTest, table_ii

__all__ = [
    "FAULT_KINDS",
    "LONGEST_DELAY",
    "NOISE_STATE",
    "SLOT",
    "Arrival",
    "BaseStation",
    "Beam",
    "Cone",
    "ContactMemory",
    "Contacts",
    "Delivery",
    "Equipment",
    "Fault",
    "FaultChances",
    "FaultKind",
    "FaultState",
    "FilterUpdate",
    "LmsStep",
    "LocalMap",
    "Medium",
    "MoverTracker",
    "Movers",
    "NoiseStream",
    "OwnEstimate",
    "OwnState",
    "OwnStateFilter",
    "PlainLmsStep",
    "PlainUpdate",
    "RangeTest",
    "RangeTracker",
    "Ranging",
    "SensorFilter",
    "Solid",
    "SolidBox",
    "SolidDisc",
    "SolidWalls",
    "SonarArray",
    "beam_of",
    "check_faults",
    "delayed",
    "delayed_symbols",
    "draw_normals",
    "draw_uniforms",
    "echo_range",
    "expected_range",
    "fault_ports",
    "fault_slots",
    "fault_state",
    "faulty",
    "faulty_samples",
    "fire",
    "gate",
    "heard",
    "heard_samples",
    "lms_step",
    "mover_step",
    "noise_states",
    "own_state_step",
    "plain_average",
    "plain_filter",
    "plain_gate",
    "plain_lms_step",
    "sonar_contacts",
    "speed_of_sound",
    "table_ii",
    "true_range",
    "weighted_average",
]
