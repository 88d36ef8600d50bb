"""Perception: the sonar array, its range filters, obstacle points, a local map, localisation by a base station."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.marine.sensing.calibration.estimation import OUTLIER_RULE, Calibration, Estimate, calibrate
    from surctl.marine.sensing.calibration.file import (
        RangeTest,
        SensorCalibration,
        calibrate_file,
        calibrate_table_ii,
        calibration_rows,
        file_stems,
        pick_calibration,
        sonar_fragment,
        table_ii,
    )
    from surctl.marine.sensing.equipment import INCIDENCE_LIMITS, SURFACE_MODELS, Equipment, SurfaceModel
    from surctl.marine.sensing.localisation.base_station import (
        BaseStation,
        Delivery,
        OwnState,
        delayed_symbols,
    )
    from surctl.marine.sensing.localisation.movers import Movers, MoverTracker
    from surctl.marine.sensing.localisation.own_state import OwnEstimate, OwnStateFilter
    from surctl.marine.sensing.mapping.contacts import ContactMemory, Contacts, expected_range, sonar_contacts
    from surctl.marine.sensing.mapping.local_map import LocalMap
    from surctl.marine.sensing.ranging.filters import (
        FilterUpdate,
        LmsStep,
        SensorFilter,
        gate,
        lms_step,
        weighted_average,
    )
    from surctl.marine.sensing.ranging.tracker import RangeTracker, Ranging
    from surctl.marine.sensing.replay import (
        Readings,
        Recording,
        Replay,
        SensorSummary,
        Tracked,
        filtered_rows,
        read_readings,
        replay_readings,
        sonar_array,
        track,
    )
    from surctl.marine.sensing.sonar.array import Medium, SonarArray, speed_of_sound
    from surctl.marine.sensing.sonar.echo import Beam, beam_of, echo_range, echo_samples
    from surctl.marine.sensing.sonar.faults import (
        FAULT_KINDS,
        LONGEST_DELAY,
        SLOT,
        Arrival,
        Fault,
        FaultChances,
        FaultKind,
        check_faults,
        fault_ports,
        fault_slots,
        faulty_samples,
    )
    from surctl.marine.sensing.sonar.returns import (
        ECHO_KEY,
        REFLECTORS,
        Reflector,
        Surfaces,
        certain_range_symbols,
        detection_odds,
        echo_keys,
        echo_number,
        firing_block_symbols,
        level_range,
        rim,
        uniform_symbols,
        weak_range_symbols,
    )
    from surctl.marine.sensing.sonar.solids import Cone, Solid, SolidBox, SolidDisc, SolidWalls

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
    "certain_range_symbols",
    "check_faults",
    "delayed_symbols",
    "detection_odds",
    "echo_keys",
    "echo_number",
    "echo_range",
    "echo_samples",
    "expected_range",
    "fault_ports",
    "fault_slots",
    "faulty_samples",
    "file_stems",
    "filtered_rows",
    "firing_block_symbols",
    "gate",
    "level_range",
    "lms_step",
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
    "uniform_symbols",
    "weak_range_symbols",
    "weighted_average",
]

load_at_first_use(
    __name__,
    {
        "calibration.estimation": "OUTLIER_RULE Calibration Estimate calibrate",
        "calibration.file": "RangeTest SensorCalibration calibrate_file calibrate_table_ii calibration_rows file_stems"
        " pick_calibration sonar_fragment table_ii",
        "equipment": "INCIDENCE_LIMITS SURFACE_MODELS Equipment SurfaceModel",
        "localisation.base_station": "BaseStation Delivery OwnState delayed_symbols",
        "localisation.movers": "MoverTracker Movers",
        "localisation.own_state": "OwnEstimate OwnStateFilter",
        "mapping.contacts": "ContactMemory Contacts expected_range sonar_contacts",
        "mapping.local_map": "LocalMap",
        "ranging.filters": "FilterUpdate LmsStep SensorFilter gate lms_step weighted_average",
        "ranging.tracker": "RangeTracker Ranging",
        "replay": "Readings Recording Replay SensorSummary Tracked filtered_rows read_readings replay_readings"
        " sonar_array track",
        "sonar.array": "Medium SonarArray speed_of_sound",
        "sonar.echo": "Beam beam_of echo_range echo_samples",
        "sonar.faults": "FAULT_KINDS LONGEST_DELAY SLOT Arrival Fault FaultChances FaultKind check_faults"
        " fault_ports fault_slots faulty_samples",
        "sonar.returns": "ECHO_KEY REFLECTORS Reflector Surfaces certain_range_symbols detection_odds echo_keys"
        " echo_number firing_block_symbols level_range rim uniform_symbols weak_range_symbols",
        "sonar.solids": "Cone Solid SolidBox SolidDisc SolidWalls",
    },
)
