"""What the robot feels: the sonar array, its filters, contacts, and what the base station tells."""

from surctl.sensing.array import SonarArray, fire, true_range
from surctl.sensing.base_station import BaseStation, OwnState
from surctl.sensing.calibration import OUTLIER_RULE, Calibration, Estimate, calibrate
from surctl.sensing.calibration_file import (
    SensorCalibration,
    calibrate_file,
    calibrate_table_ii,
    calibration_rows,
    file_stems,
    pick_calibration,
    sonar_fragment,
)
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
from surctl.sensing.replay import Readings, Replay, SensorSummary, Tracked, replay_readings, track
from surctl.sensing.replay_file import Recording, filtered_rows, read_readings, sonar_array
from surctl.sensing.table2 import RangeTest, table_ii

__all__ = [
    "NOISE_STATE",
    "OUTLIER_RULE",
    "BaseStation",
    "Calibration",
    "ContactMemory",
    "Contacts",
    "Estimate",
    "FilterUpdate",
    "LmsStep",
    "NoiseStream",
    "OwnState",
    "PlainLmsStep",
    "PlainUpdate",
    "RangeTest",
    "RangeTracker",
    "Ranging",
    "Readings",
    "Recording",
    "Replay",
    "SensorCalibration",
    "SensorFilter",
    "SensorSummary",
    "SonarArray",
    "Tracked",
    "calibrate",
    "calibrate_file",
    "calibrate_table_ii",
    "calibration_rows",
    "draw_normals",
    "expected_range",
    "file_stems",
    "filtered_rows",
    "fire",
    "gate",
    "heard_samples",
    "lms_step",
    "noise_states",
    "pick_calibration",
    "plain_average",
    "plain_filter",
    "plain_gate",
    "plain_lms_step",
    "range_to_box",
    "range_to_disc",
    "range_to_walls",
    "read_readings",
    "replay_readings",
    "sonar_array",
    "sonar_contacts",
    "sonar_fragment",
    "table_ii",
    "track",
    "true_range",
    "weighted_average",
]
