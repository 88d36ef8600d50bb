"""Write a run as a file for other programs: CSV, MATLAB's .mat or netCDF, with one line per control step."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.files import file_name, write_file
from surctl.marine.simulation.run import Run
from surctl.marine.simulation.scene_file import save_scene
from surctl.marine.vehicle import FRAME_TEXT, LOG_MOTION, LOG_THRUST, Frame, check_frame, swap_body, swap_pose
from surctl.recorded import shown
from surctl.recorded_write import RECORD_FORMATS, Column, RecordFormat, write_mat, write_netcdf

RUN_FORMATS = (*RECORD_FORMATS, "mcap")
"""File formats of a run: tables, and mcap, messages for Foxglove."""

__all__ = ["RECORD_FORMATS", "RUN_FORMATS", "RecordFormat", "record_columns", "save_record"]

_UNITS = {
    "t_s": "s",
    **dict(zip(LOG_MOTION, ("m", "m", "m", "rad", "m/s", "m/s", "m/s", "rad/s"), strict=True)),
    **dict(zip(LOG_THRUST, ("N", "N", "N", "N m"), strict=True)),
    "clearance_m": "m",
    "status": "1",
}
_MEANING = {
    "t_s": "time",
    **dict(zip(LOG_MOTION[:4], ("x in {E}", "y in {E}", "z in {E}", "heading, from x to y"), strict=True)),
    **dict(zip(LOG_MOTION[4:], ("surge in {B}", "sway in {B}", "heave in {B}", "yaw rate"), strict=True)),
    **dict(zip(LOG_THRUST, (f"commanded {axis}" for axis in ("surge", "sway", "heave", "yaw")), strict=True)),
    "clearance_m": "distance from the hull to the nearest obstacle or wall",
    "status": "status bits of the law",
}


def record_columns(run: Run, *, frame: Frame | str = "enu") -> dict[str, NDArray[np.float64]]:
    """Return arrays (n,) by name in SI units: time, η, ν, commanded thrust, clearance, status.

    The command `from-log` reads these columns.

    Raises:
        InputError: the coordinate frame is unknown.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.simulation import load_scenario, record_columns, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> law, gains = build_law("closed_form"), load_gains("default")
        >>> run = simulate(load_scenario("pool-behind"), load_vehicle("sur400"), gains=gains, law=law)
        >>> list(record_columns(run))[:5]
        ['t_s', 'x_m', 'y_m', 'z_m', 'psi_rad']
        >>> [round(float(record_columns(run, frame=frame)["z_m"][-1]), 2) for frame in ("enu", "ned")]
        [-0.15, 0.15]
    """
    r = run.record
    eta, nu, tau = r.eta, r.nu, r.tau
    if check_frame(frame, key="--frame") == "ned":
        eta, nu, tau = swap_pose(eta), swap_body(nu), swap_body(tau)
    columns = {"t_s": r.time}
    columns |= dict(zip(LOG_MOTION, np.column_stack([eta, nu]).T, strict=True))
    columns |= dict(zip(LOG_THRUST, tau.T, strict=True))
    return {
        k: np.asarray(v, dtype=float) for k, v in (columns | {"clearance_m": r.clearance, "status": r.status}).items()
    }


def save_record(run: Run, folder: Path, *, kind: RecordFormat | str, frame: Frame | str = "enu") -> Path:
    """Write the run to `SCENARIO-SEED.KIND` in the folder and return the path of the file.

    The formats csv, mat and nc hold the same numbers, to the last bit. CSV: all digits that are needed to restore each
    number, below a comment line with the frame and the run. .mat: one column vector per name, the texts `frame` and
    `about`, and the structs `units` and `meaning` with one field per name. netCDF-4: variables along the dimension
    `time` with the attributes `units` and `long_name`, and the attribute `frame` of the file. The format mcap holds
    messages for Foxglove, see `save_scene`.

    Args:
        run: the run.
        folder: an existing folder.
        kind: file format: csv, mat, nc or mcap.
        frame: coordinate frame: enu (ENU/FLU) or ned (NED/FRD).

    Raises:
        InputError: the format or the frame is unknown, or the folder cannot be written.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.simulation import load_scenario, save_record, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> law, gains = build_law("closed_form"), load_gains("default")
        >>> run = simulate(load_scenario("pool-behind"), load_vehicle("sur400"), gains=gains, law=law)
        >>> saved = save_record(run, Path(), kind="csv", frame="ned")
        >>> print(saved, saved.read_text().splitlines()[1][:23])
        pool-behind-0.csv t_s,x_m,y_m,z_m,psi_rad
    """
    if kind not in RUN_FORMATS:
        raise InputError("is not known", key="--save", value=kind, remedy=nearest(str(kind), RUN_FORMATS))
    if kind == "mcap":
        if frame != "enu":
            raise InputError("is not a frame of Foxglove", key="--frame", value=frame, remedy="use enu for mcap")
        return save_scene(run, folder)
    path = folder / f"{file_name(run.scenario.name)}-{run.seed}.{kind}"
    columns = record_columns(run, frame=frame)
    frame_text = FRAME_TEXT[check_frame(frame)]
    about = " ".join(f"{k}={v}" for k, v in run.to_dict().items() if isinstance(v, str | int | float))
    if kind == "csv":
        above = f"# frame={frame} ({frame_text}); SI units, radians; {shown(about)}"
        rows = [above, ",".join(columns), *(",".join(map(_plain, row)) for row in zip(*columns.values(), strict=True))]
        return write_file(path, "\n".join(rows) + "\n")
    described = {name: Column(values, _UNITS[name], _MEANING[name]) for name, values in columns.items()}
    if kind == "mat":
        return write_mat(path, described, texts={"frame": frame_text, "about": about})
    attributes = {"title": about, "frame": frame_text}
    return write_netcdf(path, described, sizes={"time": len(run.record.time)}, attributes=attributes)


def _plain(value: float) -> str:
    # the clearance is inf if there is no obstacle or wall
    return repr(int(value)) if abs(value) < 1e15 and value == int(value) else repr(float(value))
