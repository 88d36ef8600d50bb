"""Perception: the sonar array, its range filters, obstacle points, a local map, localisation by a base station."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.marine.sensing.equipment import INCIDENCE_LIMIT, Equipment
    from surctl.marine.sensing.localisation.base_station import BaseStation, Delivery, OwnState
    from surctl.marine.sensing.localisation.own_state import OwnStateFilter
    from surctl.marine.sensing.mapping.local_map import LocalMap
    from surctl.marine.sensing.ranging.filters import SensorFilter
    from surctl.marine.sensing.ranging.tracker import RangeTracker
    from surctl.marine.sensing.sonar.array import SonarArray
    from surctl.marine.sensing.sonar.faults import FAULT_KINDS, Fault, FaultChances
    from surctl.marine.sensing.sonar.returns import REFLECTORS, Reflector, Surfaces

__all__ = [
    "FAULT_KINDS",
    "INCIDENCE_LIMIT",
    "REFLECTORS",
    "BaseStation",
    "Delivery",
    "Equipment",
    "Fault",
    "FaultChances",
    "LocalMap",
    "OwnState",
    "OwnStateFilter",
    "RangeTracker",
    "Reflector",
    "SensorFilter",
    "SonarArray",
    "Surfaces",
]

load_at_first_use(__name__)
