"""Write a run as a file: CSV, MATLAB's .mat or netCDF with one line per step, or an MCAP scene for Foxglove.

Topics: `/tf` (frames `world` and `hull`), `/pose`, `/path`, `/scene` (hull, obstacles, walls), `/sonar/N` (one echo as
an arc over the beam), `/state`, `/thrust`, `/status`, `/log`. The frame `world` is {E}: x along the site, z up; `hull`
is {B}: x forward, y left. Numbers are rounded to 0.1 mm, 0.1 mN and 1e-5 rad, below any sensor.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from math import degrees, isfinite, isinf
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, check_known, writing
from surctl.files import file_name, write_file
from surctl.marine.simulation.run import Run
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.simulation.world import Body
from surctl.marine.vehicle import FRAME_TEXT, LOG_MOTION, LOG_THRUST, Frame, Vehicle
from surctl.marine.vehicle.motion_log import check_frame, quaternion, swap_body, swap_pose
from surctl.marine.world import Box, Disc
from surctl.recorded import shown
from surctl.recorded_write import RECORD_FORMATS, Column, McapFile, RecordFormat, stamp, write_mat, write_netcdf

Vector = NDArray[np.float64]

LAYOUT = "foxglove-layout.json"
"""Name of the layout file for Foxglove, which is written beside each MCAP file."""

_SCENE = 0.2  # [s] between two messages with moving obstacles
_STILL = 10.0  # [s] between two messages with path and standing obstacles, so that a viewer may begin anywhere
_ARC = 9  # points of a sonar's arc
_FLOAT = {"hull": (0.95, 0.75, 0.1, 0.9), "still": (0.45, 0.45, 0.5, 0.9), "moving": (0.85, 0.25, 0.2, 0.9)}
_WALL = (0.3, 0.5, 0.7, 0.6)
_PATH = (0.1, 0.6, 0.3, 0.9)
_UNTURNED = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
_INFO, _WARNING = 2, 3


class SceneFile:
    """Writes moments of a run or session to an MCAP file, with the mission and its vehicle."""

    def __init__(self, file: McapFile, scenario: Scenario, vehicle: Vehicle) -> None:
        self.file, self.scenario, self.vehicle = file, scenario, vehicle
        self.array = scenario.sensors.array_on(vehicle["radius"])
        self._scene, self._still = -float("inf"), -float("inf")
        self._shown: set[str] = set()
        z = scenario.depth
        rises = scenario.path.rises if scenario.path.rises is not None else np.zeros(len(scenario.path.waypoints))
        self._path = [
            _point(x, y, z + rise) for (x, y), rise in zip(scenario.path.waypoints.tolist(), rises, strict=True)
        ]

    def text(self, time: float, text: str, *, warning: bool = False, name: str = "surctl") -> None:
        """Write a line of text to the log."""
        level = _WARNING if warning else _INFO
        message = {"timestamp": self._at(time), "level": level, "message": text, "name": name, "file": "", "line": 0}
        self.file.write("/log", "foxglove.Log", time, message)

    def moment(
        self,
        time: float,
        *,
        eta: Vector,
        nu: Vector,
        tau: Vector | None,
        status: int | None,
        tilt: tuple[float, float] = (0.0, 0.0),
        clearance: float = float("nan"),
        bodies: Sequence[Body] = (),
        ranges: Vector | None = None,
        values: Mapping[str, Any] | None = None,
    ) -> None:
        """Write one control step.

        Args:
            eta: pose (4,) in {E}.
            nu: velocity (4,) in {B}.
            tau: thrust (4,) [N, N m] in {B}; None: the law made no step, and `/thrust` gets no message.
            status: status of the law; None: the law made no step.
            tilt: roll and pitch [rad].
            clearance: distance to the nearest obstacle [m]; NaN: unknown.
            ranges: (n,) measured distance of each sonar [m]; None: no sonars.
        """
        at, write = self._at(time), self.file.write
        pose = {"position": _point(*eta[:3]), "orientation": _turned(float(eta[3]), *tilt)}
        frames = {"parent_frame_id": "world", "child_frame_id": "hull"}
        transform = {"translation": pose["position"], "rotation": pose["orientation"]}
        write("/tf", "foxglove.FrameTransform", time, {"timestamp": at, **frames, **transform})
        write("/pose", "foxglove.PoseInFrame", time, {"timestamp": at, "frame_id": "world", "pose": pose})
        x, y, z, psi = (float(v) for v in eta)
        state = dict(zip(("x_m", "y_m", "z_m"), _rounded(x, y, z), strict=True))
        state |= {"heading_deg": round(degrees(psi), 3)}
        names = ("surge_m_per_s", "sway_m_per_s", "heave_m_per_s")
        state |= dict(zip(names, _rounded(*nu[:3], digits=5), strict=True))
        state |= {"yaw_rate_deg_per_s": round(degrees(float(nu[3])), 3)}
        write("/state", "surctl.State", time, {"timestamp": at, **state})
        if tau is not None:
            thrust = dict(zip(("surge_n", "sway_n", "heave_n", "yaw_n_m"), _rounded(*tau), strict=True))
            write("/thrust", "surctl.Thrust", time, {"timestamp": at, **thrust})
        near = round(clearance, 4) if isfinite(clearance) else None
        status_values = {
            "status": None if status is None else int(status),
            "clearance_m": near,
            "values": dict(values or {}),
        }
        write("/status", "surctl.Status", time, {"timestamp": at, **status_values})
        self._obstacles(time, bodies)
        if ranges is not None:
            self._sonars(time, ranges)

    def _at(self, time: float) -> dict[str, int]:
        return stamp(self.file.epoch + time)

    def _sonars(self, time: float, ranges: Vector) -> None:
        for k, (axis, distance) in enumerate(zip(self.array.azimuths, ranges.tolist(), strict=True)):
            x, y, _ = self.array.apex(k, position=(0.0, 0.0), heading=0.0)
            half = self.array.half_angle
            echo = round(distance, 3) if distance < self.array.maximum else None
            scan = {
                "timestamp": self._at(time),
                "frame_id": "hull",
                "pose": {"position": _point(x, y, 0.0), "orientation": _UNTURNED},
                "start_angle": round(axis - half, 4),
                "end_angle": round(axis + half, 4),
                "ranges": [] if echo is None else [echo] * _ARC,
                "intensities": [],
            }
            self.file.write(f"/sonar/{k}", "foxglove.LaserScan", time, scan)

    def _obstacles(self, time: float, bodies: Sequence[Body]) -> None:
        entities: list[dict[str, Any]] = []
        if time >= self._still + _STILL:
            self._still = time
            entities += [self._hull(time), self._walls(time)]
            poses = [{"position": point, "orientation": _UNTURNED} for point in self._path]
            line = {"timestamp": self._at(time), "frame_id": "world", "poses": poses}
            self.file.write("/path", "foxglove.PosesInFrame", time, line)
        if time >= self._scene + _SCENE or entities:
            self._scene = time
            entities += [self._body(time, body) for body in bodies if body.velocity.any() or entities]
            names = {_id(body.name) for body in bodies}
            gone = [{"timestamp": self._at(time), "type": 0, "id": name} for name in sorted(self._shown - names)]
            self._shown = names
            if entities or gone:
                self.file.write("/scene", "foxglove.SceneUpdate", time, {"deletions": gone, "entities": entities})

    def _hull(self, time: float) -> dict[str, Any]:
        r = float(self.vehicle["radius"])
        pose = {"position": _point(0.0, 0.0, 0.0), "orientation": _UNTURNED}
        sphere = {"pose": pose, "size": _point(2 * r, 2 * r, 2 * r), "color": _color(_FLOAT["hull"])}
        nose = _line([_point(0.0, 0.0, 0.0), _point(1.5 * r, 0.0, 0.0)], _FLOAT["moving"])
        return self._entity(time, "hull", frame="hull", spheres=[sphere], lines=[nose])

    def _walls(self, time: float) -> dict[str, Any]:
        length, width, deep = self.scenario.site
        corners = [(0.0, 0.0), (length, 0.0), (length, width), (0.0, width), (0.0, 0.0)]
        rings = [_line([_point(x, y, z) for x, y in corners], _WALL) for z in (0.0, -deep)]
        return self._entity(time, "site", lines=[*rings, _line(self._path, _PATH)])

    def _body(self, time: float, body: Body) -> dict[str, Any]:
        deep = self.scenario.site[2]
        bottom = -deep if isinf(body.heights.bottom) else body.heights.bottom
        top = 0.0 if isinf(body.heights.top) else body.heights.top
        assert isinstance(body.shape, Box | Disc)
        height, z = top - bottom, 0.5 * (top + bottom)
        x, y = (float(v) for v in body.shape.center)
        kind = {"color": _color(_FLOAT["moving" if body.moving else "still"])}
        if isinstance(body.shape, Disc):
            pose, wide = {"position": _point(x, y, z), "orientation": _UNTURNED}, 2 * body.shape.radius
            solid = {"pose": pose, "size": _point(wide, wide, height), "bottom_scale": 1.0, "top_scale": 1.0, **kind}
            return self._entity(time, _id(body.name), cylinders=[solid])
        pose = {"position": _point(x, y, z), "orientation": _turned(body.shape.angle, 0.0, 0.0)}
        long, wide = (float(v) for v in body.shape.size)
        return self._entity(time, _id(body.name), cubes=[{"pose": pose, "size": _point(long, wide, height), **kind}])

    def _entity(self, time: float, name: str, *, frame: str = "world", **parts: list[dict[str, Any]]) -> dict[str, Any]:
        kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
        return {
            "timestamp": self._at(time),
            "frame_id": frame,
            "id": name,
            "lifetime": stamp(0.0),
            "frame_locked": True,
            "metadata": [],
            **{kind: parts.get(kind, []) for kind in kinds},
        }


def save_scene(run: Run, folder: Path) -> Path:
    """Write the run to `SCENARIO-SEED.mcap` in the folder, and a layout for Foxglove beside it; return the path.

    Raises:
        ToolMissing: the package mcap is not installed.
        InputError: the folder cannot be written.
    """
    record, path = run.record, folder / f"{file_name(run.scenario.name)}-{run.seed}.mcap"
    part = path.with_suffix(".part.mcap")
    sonar = run.telemetry("ranges") if run.law.perception is not None else None
    shown = [port.name for port in run.law.outputs if port.size == 1 and port.name != "tau"]
    with writing(path):
        with McapFile(part) as file:
            scene = SceneFile(file, run.scenario, run.vehicle)
            for k, time in enumerate(record.time.tolist()):
                telemetry = record.telemetry[k]
                values = {name: float(telemetry[run.law.telemetry_slice(name)][0]) for name in shown}
                scene.moment(
                    time,
                    eta=record.eta[k],
                    nu=record.nu[k],
                    tau=record.tau[k],
                    status=int(record.status[k]),
                    tilt=(0.0, 0.0) if record.tilt is None else (float(record.tilt[k, 0]), float(record.tilt[k, 1])),
                    clearance=float(record.clearance[k]),
                    bodies=record.obstacles[k],
                    ranges=None if sonar is None else sonar[k],
                    values=values,
                )
            end = f"{run.scenario.name} by {run.vehicle.name}, seed {run.seed}: {run.metrics.stopped_because}"
            scene.text(float(record.time[-1]), end, warning=not run.metrics.reached)
        part.replace(path)
    write_layout(folder, sonars=0 if sonar is None else sonar.shape[1])
    return path


def write_layout(folder: Path, *, sonars: int = 0) -> Path:
    """Write the layout file for Foxglove (Layouts, Import from file) to an existing folder and return its path.

    The layout shows the echoes of `sonars` sonars.
    """
    layout = json.loads(files("surctl.marine.simulation").joinpath(LAYOUT).read_text(encoding="utf-8"))
    layout["configById"]["3D!scene"]["topics"] |= {f"/sonar/{k}": {"visible": True} for k in range(sonars)}
    return write_file(folder / LAYOUT, json.dumps(layout, indent=2) + "\n")


def _id(name: str) -> str:
    # of an obstacle; a viewer would replace the hull by an obstacle of this name
    return f"obstacle {name}" if name in ("hull", "site") else name


def _rounded(*numbers: float, digits: int = 4) -> list[float]:
    return [round(float(v), digits) for v in numbers]


def _point(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": round(float(x), 4), "y": round(float(y), 4), "z": round(float(z), 4)}


def _turned(psi: float, roll: float, pitch: float) -> dict[str, float]:
    w, x, y, z = quaternion(roll, pitch, psi).round(6).tolist()
    return {"x": x, "y": y, "z": z, "w": w}


def _color(rgba: tuple[float, float, float, float]) -> dict[str, float]:
    return dict(zip("rgba", rgba, strict=True))


def _line(points: Sequence[Mapping[str, float]], rgba: tuple[float, float, float, float]) -> dict[str, Any]:
    pose = {"position": _point(0.0, 0.0, 0.0), "orientation": _UNTURNED}
    return {
        "type": 0, "pose": pose, "thickness": 2.0, "scale_invariant": True, "points": list(points),
        "color": _color(rgba), "colors": [], "indices": [],
    }  # fmt: skip


RUN_FORMATS = (*RECORD_FORMATS, "mcap")
"""File formats of a run: tables, and mcap, messages for Foxglove."""


_ABOUT = (
    ("s", "time"), ("m", "x in {E}"), ("m", "y in {E}"), ("m", "z in {E}"), ("rad", "heading, from x to y"),
    ("m/s", "surge in {B}"), ("m/s", "sway in {B}"), ("m/s", "heave in {B}"), ("rad/s", "yaw rate"),
    ("N", "commanded surge"), ("N", "commanded sway"), ("N", "commanded heave"), ("N m", "commanded yaw"),
    ("m", "distance from the hull to the nearest obstacle or wall"), ("1", "status bits of the law"),
)  # fmt: skip
_COLUMNS = dict(zip(("t_s", *LOG_MOTION, *LOG_THRUST, "clearance_m", "status"), _ABOUT, strict=True))
"""Unit and meaning of each column of a file."""


def record_columns(run: Run, *, frame: Frame | str = "enu") -> dict[str, Column]:
    """Return columns (n,) by name in SI units: time, η, ν, commanded thrust, clearance, status.

    The command `from-log` reads these columns.
    """
    r = run.record
    eta, nu, tau = r.eta, r.nu, r.tau
    if check_frame(frame, key="--frame") == "ned":
        eta, nu, tau = swap_pose(eta), swap_body(nu), swap_body(tau)
    values = np.column_stack([r.time, eta, nu, tau, r.clearance, r.status]).T
    return {name: Column(v, *about) for (name, about), v in zip(_COLUMNS.items(), values, strict=True)}


def save_record(run: Run, folder: Path, *, kind: RecordFormat | str, frame: Frame | str = "enu") -> Path:
    """Write the run to `SCENARIO-SEED.KIND` in the folder and return the path of the file.

    The formats csv, mat and nc hold the same numbers, to the last bit. CSV: all digits that are needed to restore each
    number, below a comment line with the frame and the run. .mat: one column vector per name, the texts `frame` and
    `about`, and the structs `units` and `meaning` with one field per name. netCDF-4: variables along the dimension
    `time` with the attributes `units` and `long_name`, and the attribute `frame` of the file. The format mcap holds
    messages for Foxglove, see `save_scene`.

    Args:
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
    check_known(kind, RUN_FORMATS, key="--save")
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
        lines = zip(*(column.values.tolist() for column in columns.values()), strict=True)
        rows = [above, ",".join(columns), *(",".join(map(_plain, row)) for row in lines)]
        return write_file(path, "\n".join(rows) + "\n")
    if kind == "mat":
        return write_mat(path, columns, texts={"frame": frame_text, "about": about})
    attributes = {"title": about, "frame": frame_text}
    return write_netcdf(path, columns, sizes={"time": len(run.record.time)}, attributes=attributes)


def _plain(value: float) -> str:
    # the clearance is inf if there is no obstacle or wall
    return repr(int(value)) if abs(value) < 1e15 and value == int(value) else repr(float(value))
