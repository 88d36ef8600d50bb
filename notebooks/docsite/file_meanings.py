"""Kinds of input files, and the meaning of keys that the docstrings of their models do not state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pydantic import BaseModel

from surctl.control.gains import _GainFile
from surctl.lyapunov.problem import _ProblemTable
from surctl.simulation.scenario import _ScenarioFile
from surctl.study.plan import _StudyFile
from surctl.tuning.goals import GoalsFile
from surctl.vehicle.logs.log_map import LogMap
from surctl.vehicle.parameters import _VehicleFile
from surctl.vehicle.thruster_file import _AllocationTable, _ThrusterTable
from surctl.verification.claim_file import _ClaimTable
from surctl.verification.region.statement import RegionStatement

__all__ = ["FILES", "MEANINGS", "FileKind"]


@dataclass(frozen=True)
class FileKind:
    """A kind of file: its model, title, value of `kind`, purpose in one line, and text above its keys."""

    model: type[BaseModel]
    title: str
    kind: str
    purpose: str
    text: str


class _Vehicle(_VehicleFile):
    """A vehicle file with its thrusters in full."""

    thruster: tuple[_ThrusterTable, ...] = ()  # type: ignore[assignment]
    allocation: _AllocationTable | None = None  # type: ignore[assignment]


FILES: Mapping[str, FileKind] = {
    "vehicle": FileKind(
        _Vehicle,
        "Vehicle file",
        "vehicle",
        "mass, drag, thrust and thrusters, each with a source and a range",
        "The guide [Add a vehicle](../../add-a-vehicle.md) shows four ways to write one. Each table has the key "
        "`provenance`, the source of its numbers.",
    ),
    "scenario": FileKind(
        _ScenarioFile,
        "Scenario file",
        "scenario",
        "a mission: path, site, obstacles, disturbances and sensors",
        "The guides [Design a controller](../../design.md) and [Missions](../../missions.md) show examples. Positions "
        "are in the world frame ENU (x east, y north, z up), so depths are negative.",
    ),
    "gains": FileKind(
        _GainFile,
        "Gain file",
        "gains",
        "every tunable number of a law",
        "`surctl gains derive VEHICLE` and `surctl tune` write gain files. A law of your own adds its own gains "
        "([own law](../../own-law.md#its-own-gains)).",
    ),
    "goals": FileKind(
        GoalsFile,
        "Goals file",
        "goals",
        "hard and soft goals of a tuning",
        "The guide [Tune the gains](../../tune.md#goals-of-your-own) shows an example. A goal is about a "
        "metric and has `at_most` or `at_least`, or it has a `type` and is about the loop.",
    ),
    "claim": FileKind(
        _ClaimTable,
        "Claim file",
        "claim",
        "an inequality over a box that is to be proved or refuted",
        "The tutorial [Your own claim](../../tutorials/own-claim.md) shows an example. `left <= right` is claimed "
        "wherever all constraints hold.\n\nExpressions have numbers, names, `pi`, `+ - * / ^`, parentheses, and the "
        "functions `abs`, `acos`, `asin`, `atan`, `atan2`, `cos`, `cosh`, `exp`, `log` (natural), `max`, `min`, "
        "`select`, `sin`, `sinh`, `sqrt`, `tan` and `tanh`; `select(a, b, x, y)` is x if a ≤ b, and y otherwise.",
    ),
    "dynamics": FileKind(
        _ProblemTable,
        "Dynamics file",
        "lyapunov",
        "dynamics, with a Lyapunov function or a barrier to be proved or searched",
        'The guide [A region of attraction](../../region.md) shows examples of `kind = "lyapunov"` and of '
        '`kind = "barrier"`.',
    ),
    "region": FileKind(
        RegionStatement,
        "Region file",
        "region",
        "a region claim about the loop of a vehicle",
        "`surctl verify FILE --vehicle VEHICLE` proves it; `surctl list --show region-cruise-20` prints one.",
    ),
    "study": FileKind(
        _StudyFile,
        "Study file",
        "study",
        "the runs, sweep, claims and goals of `surctl study` and `surctl tune`",
        "`surctl new study NAME` writes one.",
    ),
    "log-map": FileKind(
        LogMap,
        "Log map",
        "log-map",
        "which fields of a log are motion and thrust",
        "The guide [Add a vehicle](../../add-a-vehicle.md#a-log-of-another-program) shows an example for a BlueROV2.",
    ),
}

_KIND = {"kind": "kind of the file", "name": "name in tables, pictures and messages", "note": "remark"}
_DELIVERY = {
    "period_s": "time between two measurements",
    "latency_s": "time from a measurement to its arrival",
    "loss": "probability that a message is lost",
    "gaps_s": "intervals (start, end) of the run without measurements",
}
_SOURCE = {"topic": "topic of the log; empty for a table", "unit": "unit of the fields"}
_TRAIL = {
    "speed_m_per_s": "speed on it; default: the scenario's cruise speed",
    "depth_m": "z on it; default: that of the leg before",
    "corner": "whether the robot must visit its end; default: the scenario's `corners`",
}

MEANINGS: Mapping[str, Mapping[str, str]] = {
    "_Vehicle": _KIND | {
        "hull": "`radius`: circle around the planform, for collisions",
        "inertia": "rigid-body and added mass together",
        "drag": "linear and quadratic drag; positive if it opposes positive motion",
        "thrust": "largest force on each axis, and lag; may be left out if thrusters are described",
        "force": "constant force and moment, such as trim or net buoyancy",
        "attitude": "weight, buoyancy and their centres; the vehicle then rolls and pitches",
        "thruster": "propellers, jets and fins",
        "allocation": "priorities of the allocation to thrusters",
    },
    "_ThrusterTable": {
        "name": "name, for faults and tables",
        "at_m": "point of attack in the body frame (x ahead, y left, z up)",
        "direction": "direction of the force on the vehicle at a positive command (a vector)",
        "forward": "largest force at positive commands",
        "reverse": 'largest force at negative commands; `"0 N"`: a water jet',
        "dead_band": "share of the command without force",
        "curve": "pairs (command from -1 to 1, force in N); straight lines if absent",
        "lag": "time constant; equal for all thrusters",
        "swivel": "joint of a vectored water jet",
        "fin": "makes it a fin or rudder: its force grows with the square of the speed",
        "provenance": "source of the numbers",
    },
    "_SwivelTable": {
        "axis": "axis of the joint in the body frame (a vector)",
        "range_deg": "smallest and largest angle",
        "rate_deg_per_s": "largest rate of the joint",
    },
    "_FinTable": {
        "lift": "force = lift × u² × deflection [rad], in N s²/m²",
        "limit_deg": "stop of the servo or stall angle, whichever is less",
    },
    "_AllocationTable": {
        "order": "levels, most important first: `yaw`, `force`, `horizontal`, `surge`, `sway`, `heave`, `effort`",
    },
    "_ScenarioFile": _KIND | {
        "title": "mission in words",
        "provenance": "source of the numbers",
        "vehicle": "default vehicle: name or file",
        "path_m": "waypoints, each [x, y]; legs and survey follow them",
        "leg": "legs after the waypoints",
        "survey": "parallel lines after the legs",
        "arc_error_m": "largest distance between an arc and its chords",
        "climb_m_per_s": "vertical speed between two depths",
        "depth_m": "z of the path, negative below the surface",
        "cruise_m_per_s": "desired speed along the path",
        "cap_m_per_s": "largest horizontal speed that the law may command",
        "arrival_m": "distance to the end at which the robot has arrived",
        "time_limit_s": "a run ends after this time; default: from the length of the path",
        "launch_m": "free water around the hull at the start",
        "depths_m": "lowest and highest z that the robot may use to leave a dead end",
        "corners": "whether corners may be skipped on a detour, or must be visited",
        "site": "size of the basin; one corner of its floor plan is the origin",
        "obstacles": "obstacles",
        "reflectors": "kinds of surfaces, by name: how they answer a sonar",
        "disturbance": "waves, current and thrust errors",
        "sonar": "range sensors",
        "base_station": "messages about moving obstacles",
        "own_state": "measurement of the own pose",
        "uncertainty": "what a Monte Carlo campaign draws",
        "paper": "numbers of the paper for this scenario",
    },
    "_Site": {
        "length_m": "along x",
        "width_m": "along y",
        "depth_m": "depth of the water",
        "walls": "reflector of all walls, or of each; default: as the echo model",
        "surface": "reflector of the water surface; default: as the echo model",
        "floor": "reflector of the floor; default: as the echo model",
    },
    "WallTable": {
        "x0": "reflector of the wall x = 0",
        "x1": "reflector of the wall x = length",
        "y0": "reflector of the wall y = 0",
        "y1": "reflector of the wall y = width",
    },
    "ReflectorTable": {
        "incidence_limit_deg": "largest angle to the normal at which a face answers; default: at every angle",
        "edge_range_m": "range at which an edge on the beam's axis is detected in half of the firings; 0: silent",
        "cylinder_range_m": "likewise for a cylinder of radius 0.1 m; default: it answers as a face does",
        "corners": "whether a corner between two such walls answers from any direction",
    },
    "Leg": _TRAIL | {
        "to_m": "end [x, y]",
        "radius_m": "radius of an arc; without it the leg is straight",
        "turn": "side to which an arc turns",
        "large_arc": "the arc of more than half a circle",
    },
    "Survey": _TRAIL | {
        "kind": "pattern",
        "corner_m": "start of the first line",
        "length_m": "length of each line",
        "width_m": "extent across the lines",
        "spacing_m": "distance of the lines",
        "heading_deg": "direction of the first line, from x towards y",
        "side": "side on which the further lines lie",
        "ends": "connection of the lines: straight or half circles",
    },
    "Obstacle": {
        "name": "name",
        "shape": "box, upright cylinder, or cylinder that moves in a straight line",
        "centre_m": "centre [x, y] at the start",
        "size_m": "size of a box along x and y",
        "radius_m": "radius of a cylinder",
        "drift_m": "amplitude of a sinusoidal drift",
        "drift_period_s": "period of the drift",
        "to_m": "end of the motion of a moving obstacle",
        "speed_m_per_s": "speed of a moving obstacle",
        "removed": "whether a moving obstacle disappears at its end",
        "bottom_m": "z of the lower end; default: the floor",
        "top_m": "z of the upper end; default: the surface",
        "reflector": "how its surface answers a sonar; default: as the echo model",
    },
    "Disturbance": {
        "wave_force_n": "amplitude of a sinusoidal force; its direction and phase are random",
        "wave_period_s": "its period",
        "drift_force_n": "amplitude of a slow sinusoidal force",
        "drift_period_s": "its period",
        "thrust_error": "largest gain error of an axis, drawn for each run",
        "thrust_bias": "largest bias of an axis, as a share of its limit",
        "current_m_per_s": "constant current [x, y]",
    },
    "SonarTable": {
        "azimuths_deg": "directions of the beams from forward, counter-clockwise (default 0, 90, 180, -90)",
        "mounts_m": "places of the sensors [x, y] in the body frame; default: on the hull",
        "order": "order of firing, by index",
        "beam_deg": "opening angle (default 75)",
        "pitch_deg": "angle of the beams' axes above the horizontal",
        "incidence_limit_deg": "largest angle to the normal at which a surface answers; default: every surface answers",
        "echoes": "echo model: every surface answers, or within 22.5° of the normal",
        "minimum_m": "blind range (default 0.2)",
        "blind_time_s": "time after a ping without reception; replaces `minimum_m`",
        "maximum_m": "longest range (default 4.5)",
        "firing_period_s": "time between two firings (default 0.025)",
        "cycle_limit_s": "longest time until all sensors have fired (default 0.1)",
        "bits": "bits of the conversion (default 8)",
        "step_m": "length of one conversion step; default: from `bits`",
        "samples": "samples of a firing (default 5)",
        "noise_sd_m": "standard deviation of a sample (default 0.015)",
        "bias_m": "constant error of a sample (default 0.0011)",
        "scale": "reading divided by the true range",
        "temperature_c": "temperature of the water, for the speed of sound (default 20)",
        "calibrated_for_m_per_s": "speed of sound that the sensor assumes; default: the true one",
        "faults": "faults at stated times",
        "chances": "probabilities of random faults at each firing",
    },
    "Fault": {
        "sensor": "index of the sensor",
        "kind": "kind of fault",
        "start_s": "time at which it begins",
        "duration_s": "how long it lasts; default: one firing for a spike, else for ever",
        "delay_s": "delay of a fault of kind `delay`",
    },
    "FaultChances": {
        "dropout": "no sample arrives",
        "zero": "the reading is 0",
        "maximum": "the reading is the longest range",
        "spike": "one wrong value, uniform over the range",
        "second_echo": "twice the true range",
        "crosstalk": "the reading of the sensor that fired before",
    },
    "_DeliveryTable": _DELIVERY,
    "StationTable": _DELIVERY | {
        "position_sd_m": "standard deviation of the position of an obstacle",
        "velocity_sd_m_per_s": "standard deviation of its velocity",
    },
    "OwnStateTable": _DELIVERY | {
        "truth": "the law gets the true state",
        "position_sd_m": "standard deviation of the position",
        "yaw_sd_rad": "standard deviation of the heading",
        "rate_sd_rad_per_s": "standard deviation of the yaw rate",
    },
    "PaperFigure": {
        "time_kind": "whether the time is approximate or a limit",
        "time_of": "whether the time is that of a run, of each run of a series, or their mean",
        "position_error_kind": "likewise for the error",
        "position_error_of": "likewise for the error",
    },
    "_GainFile": _KIND | {
        "provenance": "source of the gains; `tune` writes its whole request",
        "gains": "gains by name",
    },
    "GoalsFile": _KIND | {"points": "operating points of a system", "goals": "the goals"},
    "PointTable": {"name": "name of the operating point", "values": "numbers of the system by name"},
    "LoopGoalTable": {
        "type": "type of a goal about the loop, see below",
        "points": "operating points at which it holds; default: all",
        "at": "signal at which the loop is opened, or several",
        "source": "signal at which the input enters",
        "end": "signal that responds",
        "frequency_rad_per_s": "frequencies of the profile",
        "gain": "gain of the profile at these frequencies",
        "gain_db": "the same in dB",
        "attenuation": "factor by which a disturbance at the signal is reduced",
        "band_db": "width of the band around the loop shape",
        "side": "side of the loop shape on which the loop gain may lie",
        "response_s": "response time",
        "steady_error": "relative error at low frequencies",
        "peak_error": "largest relative error over all frequencies",
        "time_constant_s": "time constant of the reference response",
        "natural_frequency_rad_per_s": "natural frequency of the reference response",
        "damping": "least damping; damping of the reference response",
        "decay_per_s": "least decay rate of the poles",
        "fastest_rad_per_s": "largest natural frequency of the poles",
        "gain_margin": "least gain margin, as a factor",
        "phase_margin_deg": "least phase margin",
        "delay_margin_s": "least delay margin",
        "disk_margin": "least disk margin",
    },
    "GoalTable": {
        "name": "name in tables and pictures",
        "metric": "a metric of the tables below",
        "at_most": "upper bound, with unit",
        "at_least": "lower bound, with unit",
        "kind": "`hard`: must hold; `soft`: as far below the limit as possible",
        "over": "whether the worst run decides or the mean",
        "cases": "scenarios for which it holds; default: all",
        "plants": "`nominal`: only for the vehicle itself, not for corners of its ranges",
        "cruise_m_per_s": "speeds at each of which the linear loop must meet it",
    },
    "_ClaimTable": _KIND | {
        "statement": "the claim in words; default: left <= right",
        "equation": "number of the equation in its source",
        "errata": "errata to which it belongs",
        "expected": "verdict with which the command ends with status 0",
        "unit": "unit of both sides, for print",
        "left": "expression",
        "right": "expression",
        "constraints": "relations that limit the domain",
        "tolerance": "share of the larger side that counts as rounding",
        "constants": "names for numbers",
        "variables": "the box: bounds of each variable",
        "witnesses": "points, each with a value of every variable, at which a counterexample is looked for first",
        "motion": "differential equations with which a counterexample is simulated",
    },
    "VariableTable": {
        "lower": "lower bound",
        "upper": "upper bound",
        "unit": "unit, for print",
        "meaning": "what it is",
    },
    "_MotionTable": {
        "watched": "quantity whose rate the claim bounds",
        "name": "its name",
        "unit": "its unit",
        "duration": "longest time of integration, in s",
        "rates": "time derivative of each variable that changes",
    },
    "_ProblemTable": _KIND | {
        "source": "source of the problem",
        "time": "whether a state has `rate` or `next`",
        "function": "Lyapunov function; default: searched",
        "level": "level of the region; default: searched",
        "rate": "decay rate of V in 1/s; default: any strict decrease",
        "expected": "verdict with which the command ends with status 0",
        "constants": "names for numbers",
        "definitions": "names for expressions",
        "states": "the states",
        "parameters": "uncertain parameters, which may vary in time",
        "barrier": "barrier function B; default: searched",
        "initial": "relations that hold in the initial set",
        "unsafe": "relations that hold in the unsafe set",
        "multiplier": "expression λ of B' ≤ λ B; default: searched",
    },
    "_StateTable": {
        "rate": "time derivative, in continuous time",
        "next": "successor, in discrete time",
        "equilibrium": "value at the equilibrium",
    },
    "RegionStatement": {
        "force_n": "largest force of waves and thrust errors, which varies arbitrarily",
    },
    "_StudyFile": _KIND | {
        "vehicle": "vehicle: name or file",
        "gains": "gain set to start from; default: the vehicle's",
        "law": "law, or `FILE.py:FUNCTION`; default: the vehicle's",
        "guidance": "path guidance",
        "seed": "seed of the search",
        "runs": "missions",
        "sweep": "grid of gains; a study that is only tuned needs none",
        "cruise_m_per_s": "speeds of goals, sweep and summary",
        "claims": "claims to verify; default: those that apply to the vehicle",
        "goals": "goals, as in a goals file",
    },
    "_Run": {"scenario": "scenario: name or file", "vehicle": "vehicle of this run; default: that of the study"},
    "_Axis": {"gain": "gain or parameter", "values": "its values"},
    "_Sweep": {"axes": "parameters of the grid", "seeds": "seeds of the runs of each point"},
    "LogMap": {
        "kind": "kind of the file",
        "log": "time, frame and period",
        "position": "fields of the position",
        "attitude": "fields of the attitude",
        "velocity": "fields of the velocity",
        "rates": "fields of the angular velocity",
        "thrust": "fields of forces or commands",
    },
    "Source": _SOURCE | {"fields": "names of the fields"},
    "Position": _SOURCE | {"fields": 'x, y, z in the world frame; `""` for a coordinate that was not measured'},
    "Attitude": _SOURCE | {"fields": "heading; or roll, pitch, heading; or a quaternion x, y, z, w"},
    "Velocity": _SOURCE | {"fields": "components of the velocity over ground", "frame": "frame of the components"},
    "Rates": _SOURCE | {"fields": "yaw rate; or p, q, r"},
}  # fmt: skip
