"""Perception: the sonar array, its range filters, obstacle points, a local map, localisation by a base station."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.marine.sensing.calibration.estimation import OUTLIER_RULE, Calibration, Estimate, calibrate
    from surctl.marine.sensing.calibration.file import (
        SensorCalibration,
        calibrate_file,
        calibrate_table_ii,
        calibration_rows,
        file_stems,
        pick_calibration,
        sonar_fragment,
    )
    from surctl.marine.sensing.calibration.table2 import RangeTest, table_ii
    from surctl.marine.sensing.equipment import INCIDENCE_LIMITS, SURFACE_MODELS, Equipment, SurfaceModel
    from surctl.marine.sensing.localisation.base_station import BaseStation, OwnState
    from surctl.marine.sensing.localisation.delivery import Delivery, delayed, delayed_symbols
    from surctl.marine.sensing.localisation.movers import Movers, MoverTracker, mover_step
    from surctl.marine.sensing.localisation.own_state import OwnEstimate, OwnStateFilter
    from surctl.marine.sensing.mapping.contacts import ContactMemory, Contacts, expected_range, sonar_contacts
    from surctl.marine.sensing.mapping.local_map import LocalMap
    from surctl.marine.sensing.mapping.numbers import map_step, map_view
    from surctl.marine.sensing.ranging.filters import (
        FilterUpdate,
        LmsStep,
        SensorFilter,
        gate,
        lms_step,
        weighted_average,
    )
    from surctl.marine.sensing.ranging.tracker import RangeTracker, Ranging
    from surctl.marine.sensing.replay.file import Recording, filtered_rows, read_readings, sonar_array
    from surctl.marine.sensing.replay.tracked import Readings, Replay, SensorSummary, Tracked, replay_readings, track
    from surctl.marine.sensing.sonar.array import SonarArray
    from surctl.marine.sensing.sonar.detection import (
        ECHO_KEY,
        echo_keys,
        echo_uniform,
        firing_block,
        firing_block_symbols,
        uniform_symbols,
    )
    from surctl.marine.sensing.sonar.echo import Beam, beam_of, echo_range, echo_samples
    from surctl.marine.sensing.sonar.fault_block import SLOT, Arrival, fault_ports, fault_slots, faulty_samples
    from surctl.marine.sensing.sonar.faults import (
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
    from surctl.marine.sensing.sonar.firing import fire, firing_samples, true_range
    from surctl.marine.sensing.sonar.reflector import REFLECTORS, Reflector, Surfaces, detection_odds
    from surctl.marine.sensing.sonar.returns import (
        certain_range,
        corner_points,
        echo_number,
        level_range,
        rim,
        weak_range,
    )
    from surctl.marine.sensing.sonar.returns_block import certain_range_symbols, weak_range_symbols
    from surctl.marine.sensing.sonar.solids import Cone, Solid, SolidBox, SolidDisc, SolidWalls
    from surctl.marine.sensing.sonar.sound import Medium, speed_of_sound

__all__ = [
    "ECHO_KEY",
    "FAULT_KINDS",
    "INCIDENCE_LIMITS",
    "LONGEST_DELAY",
    "OUTLIER_RULE",
    "REFLECTORS",
    "SLOT",
    "SURFACE_MODELS",
    "Arrival",
    "BaseStation",
    "Beam",
    "Calibration",
    "Cone",
    "ContactMemory",
    "Contacts",
    "Delivery",
    "Equipment",
    "Estimate",
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
    "OwnEstimate",
    "OwnState",
    "OwnStateFilter",
    "RangeTest",
    "RangeTracker",
    "Ranging",
    "Readings",
    "Recording",
    "Reflector",
    "Replay",
    "SensorCalibration",
    "SensorFilter",
    "SensorSummary",
    "Solid",
    "SolidBox",
    "SolidDisc",
    "SolidWalls",
    "SonarArray",
    "SurfaceModel",
    "Surfaces",
    "Tracked",
    "beam_of",
    "calibrate",
    "calibrate_file",
    "calibrate_table_ii",
    "calibration_rows",
    "certain_range",
    "certain_range_symbols",
    "check_faults",
    "corner_points",
    "delayed",
    "delayed_symbols",
    "detection_odds",
    "echo_keys",
    "echo_number",
    "echo_range",
    "echo_samples",
    "echo_uniform",
    "expected_range",
    "fault_ports",
    "fault_slots",
    "fault_state",
    "faulty",
    "faulty_samples",
    "file_stems",
    "filtered_rows",
    "fire",
    "firing_block",
    "firing_block_symbols",
    "firing_samples",
    "gate",
    "level_range",
    "lms_step",
    "map_step",
    "map_view",
    "mover_step",
    "pick_calibration",
    "read_readings",
    "replay_readings",
    "rim",
    "sonar_array",
    "sonar_contacts",
    "sonar_fragment",
    "speed_of_sound",
    "table_ii",
    "track",
    "true_range",
    "uniform_symbols",
    "weak_range",
    "weak_range_symbols",
    "weighted_average",
]

load_at_first_use(
    __name__,
    {
        "calibration.estimation": "OUTLIER_RULE Calibration Estimate calibrate",
        "calibration.file": "SensorCalibration calibrate_file calibrate_table_ii calibration_rows file_stems"
        " pick_calibration sonar_fragment",
        "calibration.table2": "RangeTest table_ii",
        "equipment": "INCIDENCE_LIMITS SURFACE_MODELS Equipment SurfaceModel",
        "localisation.base_station": "BaseStation OwnState",
        "localisation.delivery": "Delivery delayed delayed_symbols",
        "localisation.movers": "Movers MoverTracker mover_step",
        "localisation.own_state": "OwnEstimate OwnStateFilter",
        "mapping.contacts": "ContactMemory Contacts expected_range sonar_contacts",
        "mapping.local_map": "LocalMap",
        "mapping.numbers": "map_step map_view",
        "ranging.filters": "FilterUpdate LmsStep SensorFilter gate lms_step weighted_average",
        "ranging.tracker": "RangeTracker Ranging",
        "replay.file": "Recording filtered_rows read_readings sonar_array",
        "replay.tracked": "Readings Replay SensorSummary Tracked replay_readings track",
        "sonar.array": "SonarArray",
        "sonar.detection": "ECHO_KEY echo_keys echo_uniform firing_block firing_block_symbols uniform_symbols",
        "sonar.echo": "Beam beam_of echo_range echo_samples",
        "sonar.fault_block": "SLOT Arrival fault_ports fault_slots faulty_samples",
        "sonar.faults": "FAULT_KINDS LONGEST_DELAY Fault FaultChances FaultKind FaultState check_faults fault_state"
        " faulty",
        "sonar.firing": "fire firing_samples true_range",
        "sonar.reflector": "REFLECTORS Reflector Surfaces detection_odds",
        "sonar.returns": "certain_range corner_points echo_number level_range rim weak_range",
        "sonar.returns_block": "certain_range_symbols weak_range_symbols",
        "sonar.solids": "Cone Solid SolidBox SolidDisc SolidWalls",
        "sonar.sound": "Medium speed_of_sound",
    },
)
