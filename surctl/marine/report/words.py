"""The commands that repeat what the HTML report shows."""

from __future__ import annotations

import shlex
from pathlib import Path

from surctl.errors import InputError
from surctl.marine.control import LIBRARY as GAIN_LIBRARY
from surctl.marine.control import Gains, load_gains
from surctl.marine.simulation import LIBRARY as SCENARIO_LIBRARY
from surctl.marine.simulation import Run
from surctl.marine.vehicle import LIBRARY as VEHICLE_LIBRARY
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.own_code import own_file

__all__ = ["gains_argument", "simulate_command", "verify_command"]


def gains_argument(gains: Gains, gains_file: str) -> str | None:
    """Return the value of `--gains`: `gains_file`, or the file of unchanged gains; None if neither has these gains."""
    try:
        for source in filter(None, (gains_file, gains.source)):
            if load_gains(source).values == gains.values:
                return _short(source, GAIN_LIBRARY)
    except InputError:
        return None
    return None


def simulate_command(run: Run, gains: str | None) -> str | None:
    """Return the command that repeats and plots the run; None if no command line reproduces it completely."""
    vehicle = _vehicle_argument(run.vehicle)
    law = own_file(run.law.ref)
    if gains is None or vehicle is None:
        return None
    words = ["surctl", "simulate", _short(run.scenario.source, SCENARIO_LIBRARY) or run.scenario.name]
    words += ["--vehicle", vehicle, "--gains", gains, "--law", law, "--avoidance", run.law.avoidance]
    words += [] if run.law.guidance == "los" else ["--guidance", run.law.guidance]
    words += ["--priority-mode", run.law.mode]
    words += [] if run.law.fallback == "exact" else ["--fallback", run.law.fallback]
    if (run.law.barrier, run.law.movers) != ("simple", "predict"):
        words += ["--barrier", run.law.barrier, "--movers", run.law.movers]
    words += ["--sensing", run.sensing, "--seed", str(run.seed), "--out", "plots"]
    return shlex.join(words)


def verify_command(
    claim: str, gains: str | None, vehicle: Vehicle, speeds: tuple[float, float] | None = None
) -> str | None:
    """Return the command that repeats the proof of the claim for the vehicle and (cruise speed, speed limit) [m/s]."""
    robot = _vehicle_argument(vehicle)
    if gains is None or robot is None:
        return None
    words = ["surctl", "verify", claim, "--vehicle", robot, "--gains", gains]
    if speeds is not None:
        words += ["--cruise", f"{speeds[0]:g}", "--cap", f"{speeds[1]:g}"]
    return shlex.join(words)


def _vehicle_argument(vehicle: Vehicle) -> str | None:
    try:
        same = bool(vehicle.source) and load_vehicle(vehicle.source).parameters == vehicle.parameters
    except InputError:
        return None
    return _short(vehicle.source, VEHICLE_LIBRARY) if same else None


def _short(source: str, library: Path) -> str:
    # bare name of a built-in file
    path = Path(source)
    return path.stem if path.parent == library else source
