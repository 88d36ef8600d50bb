"""A log of motion and thrust: its columns and units, frames ENU and NED, times that do not increase."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.recorded import NO_HEADER, Recorded, read_recorded
from surctl.units import in_unit

# Conversion between the frame conventions ENU/FLU, used in all computations, and NED/FRD, used by other programs.
#
# ENU is the frame {E}: x east, y north, z up, ψ counter-clockwise from x. FLU is the frame {B}: x forward, y left, z
# up. NED has x north, y east, z down, and ψ clockwise from north. FRD has x forward, y right, z down (Fossen 2021,
# section 2.1). `swap_pose` and `swap_body` convert in both directions, because the conversion is its own inverse.
#
# {B} is the heading frame: it turns with the heading alone, so its x and y axes stay horizontal when the hull rolls or
# pitches. A sensor on the hull, such as a Doppler velocity log, measures in the frame of the hull (`heading_frame`).


Frame = Literal["enu", "ned"]
FRAMES: tuple[Frame, ...] = get_args(Frame)

FRAME_TEXT: dict[Frame, str] = {
    "enu": "ENU/FLU: x east, y north, z up, psi counter-clockwise from x; body x forward, y left, z up",
    "ned": "NED/FRD: x north, y east, z down, psi clockwise from x; body x forward, y right, z down",
}
"""The text with which a file states its frame."""


def swap_pose(eta: ArrayLike) -> NDArray[np.float64]:
    """Convert poses (…, 4) of x, y, z [m] and ψ [rad] from ENU to NED or back: (y, x, −z, π/2 − ψ).

    The conversion does not wrap headings to one turn. A NaN is converted to NaN.
    """
    pose = _four("pose", eta)
    x, y, z, psi = np.moveaxis(pose, -1, 0)
    return np.stack([y, x, 0.0 - z, np.pi / 2 - psi], axis=-1)


def swap_body(vector: ArrayLike) -> NDArray[np.float64]:
    """Convert body vectors (…, 4) from FLU to FRD or back: (u, −v, −w, −r).

    A body vector is a velocity u, v, w [m/s], r [rad/s], or a thrust [N, N m].
    """
    return _four("vector", vector) * [1.0, -1.0, -1.0, -1.0] + 0.0  # no −0


def heading_frame(vector: ArrayLike, *, roll: ArrayLike, pitch: ArrayLike) -> NDArray[np.float64]:
    """Return vectors (…, 3) in the heading frame from those in the frame of the hull, by roll and pitch (…) [rad]."""
    u, v, w = np.moveaxis(np.asarray(vector, dtype=float), -1, 0)
    across, up = v * np.cos(roll) - w * np.sin(roll), v * np.sin(roll) + w * np.cos(roll)
    ahead, up = u * np.cos(pitch) + up * np.sin(pitch), up * np.cos(pitch) - u * np.sin(pitch)
    return np.stack(np.broadcast_arrays(ahead, across, up), axis=-1)


def quaternion(roll: float, pitch: float, yaw: float) -> NDArray[np.float64]:
    """Return the quaternion (4,), real part first, of R_z(yaw) R_y(pitch) R_x(roll), for angles in rad."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a / 2), np.sin(a / 2)) for a in (roll, pitch, yaw))
    real = cr * cp * cy + sr * sp * sy
    return np.array([real, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy])


def roll_pitch_heading(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return roll, pitch and heading (n, 3) [rad] of quaternions (n, 4) x, y, z, w from the body to the world frame.

    The angles are those of the order z, y, x (Fossen 2021, section 2.2). The quaternions need not have length 1.
    """
    size = np.linalg.norm(quaternion, axis=1, keepdims=True)
    x, y, z, w = (quaternion / np.where(size > 0, size, np.nan)).T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.column_stack([roll, pitch, heading])


def check_frame(frame: object, *, key: str = "frame", file: object = None) -> Frame:
    """Return the frame name if it is in `FRAMES`; otherwise raise InputError."""
    if frame not in FRAMES:
        raise InputError("is not known", key=key, value=frame, file=file, remedy="give enu (ENU/FLU) or ned (NED/FRD)")
    return frame


def _four(key: str, value: ArrayLike) -> NDArray[np.float64]:
    values = np.asarray(value, dtype=float)
    if values.shape[-1:] != (4,):
        raise InputError(f"has shape {values.shape}", key=key, remedy="give (4,), or (n, 4)")
    return values


LOG_MOTION = ("x_m", "y_m", "z_m", "psi_rad", "u_m_per_s", "v_m_per_s", "w_m_per_s", "r_rad_per_s")
"""Columns of η and ν; a log may have only some of them, and cells may be empty."""
LOG_TILT = ("roll_rad", "pitch_rad", "p_rad_per_s", "q_rad_per_s")
"""Columns of roll and pitch, and of the angular velocities p, q of the hull; a log may have none of them."""
LOG_THRUST = ("Fu_N", "Fv_N", "Fw_N", "Fr_N_m")
"""Columns of the commanded thrust, which is constant from one row to the next."""

_LEAST = 50  # rows
_PAUSE = 10.0  # periods between two logs, twice the gap at which a fit splits a log
_UNITS = dict(
    zip(
        ("t_s", *LOG_MOTION, *LOG_TILT, *LOG_THRUST),
        ("s", "m", "m", "m", "rad", "m/s", "m/s", "m/s", "rad/s", *2 * ("rad",), *2 * ("rad/s",), *3 * ("N",), "N m"),
        strict=True,
    )
)
_ALSO = {  # endings that a column may have instead of the one of its SI unit
    "s": {"_ms": "ms", "_us": "us", "_ns": "ns"},
    "m": {"_cm": "cm", "_mm": "mm"},
    "rad": {"_deg": "deg"},
    "m/s": {"_cm_per_s": "cm/s", "_mm_per_s": "mm/s"},
    "rad/s": {"_deg_per_s": "deg/s"},
    "N": {"_kgf": "kgf", "_lbf": "lbf"},
    "N m": {"_kgf_m": "kgf m"},
}
_OTHER_UNITS = {
    name: {name.partition("_")[0] + ending: other for ending, other in _ALSO[unit].items()}
    for name, unit in _UNITS.items()
}


@dataclass(frozen=True, eq=False)
class MotionLog:
    """A log of motion and thrust over time.

    Attributes:
        time: (n,) [s], increasing.
        motion: (n, 8) pose η in the world frame {E}, then velocity over ground ν in the body frame {B}; NaN where there
            is no measurement. The heading ψ is continuous, without jumps by a full turn. With roll and pitch, (n, 12):
            then roll, pitch [rad], and the angular velocities p, q of the hull [rad/s].
        thrust: (n, 4) commanded thrust in {B} [N, N m]; each command is constant until the next sample.
        source: name of the file.
        notes: what of the file is not used.
    """

    time: NDArray[np.float64]
    motion: NDArray[np.float64]
    thrust: NDArray[np.float64]
    source: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if len(self.time) < _LEAST:
            raise InputError(f"has {len(self.time)} rows", file=self.source, remedy=f"give at least {_LEAST}")
        _check_increasing(self.time, "t_s", lambda row: self.source and f"{self.source}, row {row + 1}")
        if not np.isfinite(self.thrust).all():
            row, column = np.argwhere(~np.isfinite(self.thrust))[0]
            problem = f"has no number at {self.time[row]:g} s"
            remedy = "fill it in or shorten the log, because the thrust must be known at all times"
            raise InputError(problem, file=self.source, key=LOG_THRUST[column], remedy=remedy)
        if not np.isfinite(self.motion).any():
            remedy = f"add at least one of the columns {', '.join(LOG_MOTION)}"
            raise InputError("contains no motion", file=self.source, remedy=remedy)

    def halves(self, cut: int) -> list[MotionLog]:
        """Return the rows before the row `cut`, and those from it on, as two logs."""
        rows = slice(cut), slice(cut, None)
        return [MotionLog(self.time[part], self.motion[part], self.thrust[part], self.source) for part in rows]


def read_motion_log(path: Path, *, frame: Frame | str | None = None) -> MotionLog:
    """Read time `t_s`, thrust, and any motion columns of a log file (CSV, .mat, netCDF); ignore other columns.

    With any of the columns roll_rad, pitch_rad, p_rad_per_s and q_rad_per_s, the log has roll and pitch.

    A column may have the ending of another unit: t_ns, t_us or t_ms, x_cm or x_mm, psi_deg, u_cm_per_s, r_deg_per_s,
    Fu_kgf. Times in such a unit count from the first row.

    Args:
        frame: frame of the file; default: the frame in its comments (`# frame=ned`), otherwise enu. The returned log is
            in the frame enu.
    """
    try:
        table = read_recorded(path)
    except InputError as error:
        if error.problem != NO_HEADER:
            raise
        remedy = "name the columns in the first line, or in a map: --map with columns in [log]"
        raise InputError(NO_HEADER, file=error.file, remedy=remedy) from None
    written = _frame(table, frame)
    columns = {name: _written_as(table, name) for name in _UNITS}
    table.need(name for name in ("t_s", *LOG_THRUST) if columns[name] is None)
    time = _numbers(table, "t_s", columns)
    if not np.isfinite(time).all():
        row = int(np.flatnonzero(~np.isfinite(time))[0])
        key = (columns["t_s"] or ("t_s", ""))[0]
        raise InputError("is not a time", file=table.at(row), key=key, remedy="fill it in or remove the row")
    _check_increasing(time, (columns["t_s"] or ("t_s", ""))[0], table.at)
    tilts = any(columns[c] is not None for c in LOG_TILT)
    motion = np.column_stack([_numbers(table, c, columns) for c in (*LOG_MOTION, *(LOG_TILT if tilts else ()))])
    heading = motion[:, 3]
    known = np.isfinite(heading)
    heading[known] = np.unwrap(heading[known])
    thrust = np.column_stack([_numbers(table, c, columns) for c in LOG_THRUST])
    if written == "ned":
        motion, thrust = swapped(motion), swap_body(thrust)
    return MotionLog(time, motion, thrust, table.name)


def in_sequence(logs: Sequence[MotionLog]) -> MotionLog:
    """Return several logs of one vehicle as one log: one after the other, with a gap in between.

    A fit gives each part between two gaps its own initial motion, so the runs need not have the same origin.
    """
    if len(logs) == 1:
        return logs[0]
    pause = 2.0 * max(1.0, *(_PAUSE * float(np.median(np.diff(log.time))) for log in logs))
    times: list[NDArray[np.float64]] = []
    for log in logs:
        begin = times[-1][-1] + pause if times else log.time[0]
        times.append(log.time - log.time[0] + begin)
    return MotionLog(
        np.concatenate(times),
        np.vstack([log.motion for log in logs]),
        np.vstack([log.thrust for log in logs]),
        ", ".join(log.source for log in logs),
        tuple(f"{log.source}: {note}" for log in logs for note in log.notes),
    )


def _check_increasing(time: NDArray[np.float64], key: str, at: Callable[[int], str]) -> None:
    """Check that times (n,) [s] increase from row to row; `at` names the place of a row, from 0."""
    wrong = np.flatnonzero(~(np.diff(time) > 0))
    if not len(wrong):
        return
    row, same = int(wrong[0]) + 1, time[wrong] == time[wrong + 1]
    value = float(time[row])
    if not same[0]:
        remedy = "sort the rows by time, or split the log there and give both parts"
        raise InputError("is before the time of the previous row", file=at(row), key=key, value=value, remedy=remedy)
    more = f", as in {np.count_nonzero(same) - 1} more rows" if np.count_nonzero(same) > 1 else ""
    remedy = "write the time with more digits, or remove one of the two rows"
    raise InputError(f"is the time of the previous row too{more}", file=at(row), key=key, value=value, remedy=remedy)


def swapped(motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return motion (n, 8) or (n, 12) of a log in ENU/FLU from NED/FRD, or back; pitch and q change their signs."""
    tilt = motion[:, 8:] * np.array([1.0, -1.0, 1.0, -1.0])[: motion.shape[1] - 8]
    return np.hstack([swap_pose(motion[:, :4]), swap_body(motion[:, 4:8]), tilt])


def _written_as(table: Recorded, name: str) -> tuple[str, str] | None:
    """Return the column that holds a quantity and its unit: `t_s` itself, or one in another unit such as `t_ns`."""
    if name in table.columns:
        return name, ""
    return next(((c, unit) for c, unit in _OTHER_UNITS[name].items() if c in table.columns), None)


def _numbers(table: Recorded, name: str, columns: Mapping[str, tuple[str, str] | None]) -> NDArray[np.float64]:
    column = columns[name]
    if column is None:
        return np.full(len(table.lines), np.nan)
    values = table.numbers(column[0])
    if name == "t_s" and column[1]:
        values = values - values[0]  # nanoseconds since 1970 would lose digits as seconds
    return values * in_unit(1.0, column[1], _UNITS[name]) if column[1] else values


def _frame(table: Recorded, frame: Frame | str | None) -> Frame:
    requested = None if frame is None else check_frame(frame, key="--frame", file=table.name)
    said = next((m[1] for line in table.about if (m := re.search(r"\bframe=(\w+)", line))), None)
    said = said or next((key for key, text in FRAME_TEXT.items() if text in table.about), None)
    if said is None:
        return requested or "enu"
    recorded = check_frame(said, file=table.name)
    if requested not in (None, recorded):
        problem = f"is not the frame that the file states ({recorded})"
        raise InputError(problem, file=table.name, key="frame", value=frame, remedy="omit --frame")
    return recorded
