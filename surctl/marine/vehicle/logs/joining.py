"""Keys of a map (`--map`), and how it joins topics to a log: common times, gaps, attitude, thruster commands."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from surctl.errors import InputError, mistakes_in
from surctl.files import Strict, read_toml, validate
from surctl.marine.vehicle.logs.recording import LogRecording, Topic, step_back
from surctl.marine.vehicle.motion_log import Frame, MotionLog, heading_frame, roll_pitch_heading, swap_body, swapped
from surctl.units import in_unit

Positive = Annotated[float, Field(gt=0)]


class Source(Strict):
    """Fields of one topic; the topic of a table has an empty name."""

    topic: str = ""
    fields: list[str] = Field(min_length=1)


class LogPosition(Source):
    """Position x, y, z in the world frame; without z, x and y; "" for a coordinate that was not measured."""

    fields: list[str] = Field(min_length=2, max_length=3)
    unit: str = "m"


class LogAttitude(Source):
    """Heading alone, or roll, pitch and heading, or a quaternion x, y, z, w (body to world)."""

    unit: str = "rad"

    @model_validator(mode="after")
    def _known(self) -> LogAttitude:
        if len(self.fields) not in (1, 3, 4):
            raise ValueError(
                "needs 1 field (heading), 3 (roll, pitch, heading) or 4 (quaternion x, y, z, w); correct it"
            )
        return self


class Velocity(Source):
    """Velocity over ground: in the body frame, in the heading frame (turned by the heading alone), or in the world.

    A component that was not measured has the name "".
    """

    fields: list[str] = Field(min_length=2, max_length=3)
    unit: str = "m/s"
    frame: Literal["body", "heading", "world"]


class Rates(Source):
    """Yaw rate alone, or the body rates p, q, r, from which the rate of the heading follows with the attitude."""

    unit: str = "rad/s"

    @model_validator(mode="after")
    def _known(self) -> Rates:
        if len(self.fields) not in (1, 3):
            raise ValueError("needs 1 field (yaw rate) or 3 (p, q, r); correct it")
        return self


class LogThrust(Source):
    """Forces along the body axes and yaw moment; or commands of thrusters, with their curve and the frame matrix.

    Attributes:
        fields: Fu, Fv, Fw, Fr, "" for an axis without thrust; or with `matrix`, the command of each thruster.
        unit: unit of the forces; of commands, the texts pwm or 1 for plain numbers, or N for forces of thrusters. Plain
            numbers need a curve, or a matrix in N and N m per command.
        moment_unit: unit of Fr.
        command: commands of the curve, increasing; at a command outside them the thrust is not known.
        force_N: force of a thruster for each command [N].
        matrix: rows surge, sway, heave [1] and yaw [m], one column per thruster.
        hold_s: longest time for which a command counts [s]; default: one second or ten periods.
    """

    unit: str = "N"
    moment_unit: str = "N m"
    command: list[float] | None = Field(default=None, min_length=2)
    force_N: list[float] | None = Field(default=None, min_length=2)  # noqa: N815  # the key of the file, with its unit
    matrix: list[list[float]] | None = Field(default=None, min_length=4, max_length=4)
    hold_s: Positive | None = None

    @model_validator(mode="after")
    def _consistent(self) -> LogThrust:
        if self.matrix is None:
            if self.command is not None or self.force_N is not None:
                raise ValueError("has a curve, but no matrix; add matrix with the rows surge, sway, heave, yaw")
            if len(self.fields) != 4:
                raise ValueError(
                    'needs 4 fields Fu, Fv, Fw, Fr ("" for an axis without thrust), or a matrix; correct it'
                )
            return self
        if any(len(row) != len(self.fields) for row in self.matrix):
            raise ValueError(f"each row of matrix needs {len(self.fields)} numbers, one per field; correct it")
        if (self.command is None) != (self.force_N is None):
            raise ValueError("command and force_N belong together; give both")
        if self.command is not None and self.force_N is not None:
            if len(self.command) != len(self.force_N):
                raise ValueError("command and force_N need the same number of entries; correct them")
            if not (np.diff(self.command) > 0).all():
                raise ValueError("command must increase; sort the curve")
        return self

    def body_force(self, commands: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the thrust (n, 4) [N, N m] of thruster commands (n, thrusters); NaN where one is outside the curve.

        Commands such as 0 and 65535 mean that there is no pulse, not full thrust.
        """
        force = commands
        if self.command is not None:
            force = np.interp(commands, self.command, self.force_N or [], left=np.nan, right=np.nan)
        return np.asarray(force @ np.array(self.matrix).T)


class ClockTable(Strict):
    """Time, frame and common period of a log.

    Attributes:
        frame: world and body axes of all sources: enu (ENU/FLU) or ned (NED/FRD).
        time, time_unit: column of the time, in a table, and its unit.
        columns: names of the columns of a table without a header, from the left.
        skip_lines: lines above the numbers of such a table.
        stamp: topics whose time is the field of this name instead of the recorder's (`header.stamp`).
        shift_s: seconds to add to the time of a topic, for a clock of its own.
        period_s: common period; default: the times of the velocity, else of the position, else of the attitude.
    """

    frame: Frame
    time: str = "t_s"
    time_unit: str = "s"
    columns: list[str] | None = Field(default=None, min_length=2)
    skip_lines: int = Field(default=0, ge=0)
    stamp: dict[str, str] = Field(default_factory=dict)
    shift_s: dict[str, float] = Field(default_factory=dict)
    period_s: Positive | None = None

    @model_validator(mode="after")
    def _named(self) -> ClockTable:
        twice = sorted({name for name in self.columns or () if (self.columns or []).count(name) > 1})
        if twice:
            raise ValueError(f"columns names {twice[0]} twice; rename one of them")
        if self.skip_lines and self.columns is None:
            raise ValueError("skip_lines needs columns, the names of the columns; add them")
        return self


class LogMap(Strict):
    """The content of a map file."""

    kind: Literal["log-map"]
    log: ClockTable
    position: LogPosition | None = None
    attitude: LogAttitude | None = None
    velocity: Velocity | None = None
    rates: Rates | None = None
    thrust: LogThrust

    @model_validator(mode="after")
    def _complete(self) -> LogMap:
        if all(part is None for part in (self.position, self.attitude, self.velocity, self.rates)):
            raise ValueError("has no motion; add [position], [attitude], [velocity] or [rates]")
        if self.velocity is not None and self.velocity.frame == "world" and self.attitude is None:
            raise ValueError("velocity in the world frame needs [attitude]; add it")
        if self.rates is not None and len(self.rates.fields) == 3 and len(getattr(self.attitude, "fields", ())) < 3:
            raise ValueError("rates p, q, r need [attitude] with roll and pitch; add it, or give the yaw rate alone")
        return self

    def sources(self) -> list[tuple[str, Source]]:
        """Return the parts of the map with their names."""
        named = [(name, getattr(self, name)) for name in ("position", "attitude", "velocity", "rates", "thrust")]
        return [(name, part) for name, part in named if part is not None]


def load_log_map(path: Path) -> LogMap:
    """Read the map of a log."""
    return validate(read_toml(path), LogMap, file=path)


_BRIDGED, _BRIDGED_PERIODS = 0.5, 5.0  # motion is interpolated over at most this [s], or these periods
_NORM, _SHARE = 0.05, 0.01  # a quaternion is not of length 1 if more than this share of its norms are off by this
_HELD, _HELD_PERIODS = 1.0, 10.0  # a command counts for at most this [s], or these periods

Array = NDArray[np.float64]


def joined(recording: LogRecording, log_map: LogMap, *, map_name: str) -> MotionLog:
    """Return the log of motion and thrust of a recording, in the frame enu.

    The common times are those of the velocity, else of the position, else of the attitude, else of the rates; or a
    constant period. Motion is interpolated between its messages, but not across a gap. A command counts until the next
    one. An attitude of 3 or 4 fields gives roll and pitch too, and rates of 3 fields p and q.
    """
    sources = _Sources(recording, log_map, map_name)
    time = sources.times()
    tilts = len(getattr(log_map.attitude, "fields", ())) > 1
    motion = np.full((len(time), 12 if tilts else 8), np.nan)
    if log_map.position is not None:
        position = sources.motion("position", log_map.position, time, log_map.position.unit, "m")
        motion[:, : position.shape[1]] = position
    angles = _angles(sources, log_map, time)
    if angles is not None:
        motion[:, 3] = angles[:, 2]
        if tilts:
            motion[:, 8:10] = angles[:, :2]
    roll, pitch = (np.zeros(len(time)),) * 2 if angles is None else (angles[:, 0], angles[:, 1])
    if log_map.velocity is not None:
        velocity = sources.motion("velocity", log_map.velocity, time, log_map.velocity.unit, "m/s")
        absent = np.array([not name for name in [*log_map.velocity.fields, ""][:3]])
        velocity = np.where(absent, 0.0, np.column_stack([velocity, np.zeros(len(time))])[:, :3])
        if log_map.velocity.frame == "body":
            velocity = heading_frame(velocity, roll=roll, pitch=pitch)
        elif log_map.velocity.frame == "world":
            c, s = np.cos(motion[:, 3]), np.sin(motion[:, 3])
            x, y, z = velocity.T
            velocity = np.column_stack([c * x + s * y, c * y - s * x, z])
            absent[:2] = absent[:2].any()
        motion[:, 4:7] = np.where(absent, np.nan, velocity)
    if log_map.rates is not None:
        rates = sources.motion("rates", log_map.rates, time, log_map.rates.unit, "rad/s")
        motion[:, 7] = rates[:, 0]
        if rates.shape[1] == 3:
            motion[:, 7] = (rates[:, 1] * np.sin(roll) + rates[:, 2] * np.cos(roll)) / np.cos(pitch)
            motion[:, 10:] = rates[:, :2]
    thrust = sources.thrust(time)
    known = np.isfinite(thrust).all(axis=1)
    if len(time) and not known.any():
        raise InputError(
            "; ".join([f"has no command at any of the {len(time)} common times", *sources.notes]),
            file=recording.source,
            key=f"thrust ({log_map.thrust.topic or 'table'})",
            remedy="correct thrust.fields, or give the longest time for which a command counts in thrust.hold_s",
        )
    time, motion, thrust = time[known], motion[known], thrust[known]
    if log_map.log.frame == "ned":
        motion, thrust = swapped(motion), swap_body(thrust)
    topics = [part.topic for _, part in log_map.sources()]
    return MotionLog(time, motion, thrust, recording.source, (*recording.remarks(topics), *sources.notes))


def _angles(sources: _Sources, log_map: LogMap, time: Array) -> Array | None:
    # roll, pitch, heading (n, 3) [rad]; the heading is continuous
    part = log_map.attitude
    if part is None:
        return None
    values = sources.fields("attitude", part)
    if len(part.fields) == 4:
        _check_norm(values, sources, part)
        angles = roll_pitch_heading(values)
    else:
        angles = values * sources.factor("attitude", part.unit, "rad")
        if angles.shape[1] == 1:
            angles = np.column_stack([np.zeros((len(angles), 2)), angles])
    for k in (0, 2):
        known = np.isfinite(angles[:, k])
        angles[known, k] = np.unwrap(angles[known, k])
    return _interpolated(sources.time("attitude", part), angles, time) if len(values) else None


def _check_norm(quaternion: Array, sources: _Sources, part: Source) -> None:
    # a quaternion of zeros is one that was not set
    norms = np.linalg.norm(quaternion, axis=1)
    norms = norms[np.isfinite(norms) & (norms > 0)]
    if len(norms) and np.mean(np.abs(norms - 1) > _NORM) > _SHARE:
        problem = f"is not a unit quaternion: norm {norms.min():.3g} to {norms.max():.3g} in {sources.recording.source}"
        remedy = "name the fields x, y, z, w of a quaternion"
        raise InputError(problem, file=sources.map_name, key="attitude.fields", value=list(part.fields), remedy=remedy)


class _Sources:
    # the parts of the map, read from the recording
    def __init__(self, recording: LogRecording, log_map: LogMap, map_name: str) -> None:
        self.recording, self.map, self.map_name = recording, log_map, map_name
        self.notes: list[str] = []
        for key, names in (("stamp", log_map.log.stamp), ("shift_s", log_map.log.shift_s)):
            for topic in names:
                if topic not in {part.topic for _, part in log_map.sources()}:
                    problem = "is not a topic of this map"
                    raise InputError(problem, file=map_name, key=f"log.{key}", value=topic, remedy="remove the entry")

    def topic(self, name: str, part: Source) -> Topic:
        with mistakes_in(self.map_name):
            return self.recording.topic(part.topic, key=f"{name}.topic")

    def fields(self, name: str, part: Source) -> Array:
        # (n, fields); an empty name is an axis without thrust, or motion that was not measured
        topic = self.topic(name, part)
        absent = np.full(len(topic.time), 0.0 if name == "thrust" else np.nan)
        with mistakes_in(self.map_name):
            return np.column_stack(
                [self.recording.column(part.topic, k, key=f"{name}.fields") if k else absent for k in part.fields]
            )

    def factor(self, name: str, unit: str, target: str) -> float:
        with mistakes_in(self.map_name, f"{name}.unit"):
            return in_unit(1.0, unit, target)

    def time(self, name: str, part: Source) -> Array:
        topic, clock = self.topic(name, part), self.map.log
        time, back = topic.time, topic.back
        if part.topic in clock.stamp:
            stamp = clock.stamp[part.topic]
            seconds = [f"{stamp}.{k}" for k in ("sec", "secs") if f"{stamp}.{k}" in topic.fields]
            parts = [f"{stamp}.{k}" for k in ("nanosec", "nsecs", "nsec") if f"{stamp}.{k}" in topic.fields]
            if not seconds or not parts:
                key = f"log.stamp.{part.topic}"
                remedy = "name a field with sec and nanosec"
                raise InputError("is not a time", file=self.map_name, key=key, value=stamp, remedy=remedy)
            time = topic.fields[seconds[0]] + 1e-9 * topic.fields[parts[0]]
            back = step_back(time[np.isfinite(time)])
        if back is not None:
            raise InputError(
                f"has a clock that runs back: {back[1]:.3f} s comes after {back[0]:.3f} s",
                file=self.recording.source,
                key=f"{name} ({part.topic or 'table'})",
                remedy="sort the rows by time, or split the log there and give both parts",
            )
        return np.asarray(time + clock.shift_s.get(part.topic, 0.0))

    def motion(self, name: str, part: Source, time: Array, unit: str, target: str) -> Array:
        values = self.fields(name, part) * self.factor(name, unit, target)
        return _interpolated(self.time(name, part), values, time)

    def times(self) -> Array:
        """Return the common times within the span of all topics, from 0 for the first one."""
        spans = {name: self.time(name, part) for name, part in self.map.sources()}
        begins = max(spans, key=lambda k: float(spans[k][0]))
        ends = min((k for k in spans if k != "thrust"), key=lambda k: float(spans[k][-1]))
        last = max(float(spans["thrust"][-1]) + self._hold(spans["thrust"]), float(spans["thrust"][-1]))
        first, stop = float(spans[begins][0]), min(float(spans[ends][-1]), last)
        if stop <= first:
            other = ends if ends != begins else "thrust"
            topics = dict(self.map.sources())
            raise InputError(
                f"has no time in common with {other}: it begins at {first:.3f} s, and {other} ends at {stop:.3f} s",
                file=self.recording.source,
                key=f"{begins} ({topics[begins].topic or 'table'})",
                remedy="give the difference of the clocks in log.shift_s, or the topic's own time in log.stamp",
            )
        period = self.map.log.period_s
        if period is not None:
            return np.asarray(first + period * np.arange(int((stop - first) / period) + 1), dtype=float)
        base = next(spans[k] for k in ("velocity", "position", "attitude", "rates") if k in spans)
        base = np.unique(base[np.isfinite(base)])
        return base[(base >= first) & (base <= stop)]

    def _hold(self, time: Array) -> float:
        median = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
        return self.map.thrust.hold_s or max(_HELD, _HELD_PERIODS * median)

    def thrust(self, time: Array) -> Array:
        """Return the thrust (n, 4) at some times; NaN where no command counts."""
        part = self.map.thrust
        at, values = self.time("thrust", part), self.fields("thrust", part)
        stated = np.isfinite(at) & np.isfinite(values).all(axis=1)
        at, values = at[stated], values[stated]
        order = np.argsort(at, kind="stable")
        at, values = at[order], values[order]
        if part.matrix is not None:
            plain = part.command is not None or part.unit == "1"
            values = values * (1.0 if plain else self.factor("thrust", part.unit, "N"))
            self._count_outside(part, values)
            values = part.body_force(values)
        else:
            force, moment = self.factor("thrust", part.unit, "N"), self.factor("thrust", part.moment_unit, "N m")
            values = values * np.array([force, force, force, moment])
        place = np.searchsorted(at, time + 1e-9, side="right") - 1
        counts = (place >= 0) & (time - at[np.maximum(place, 0)] <= self._hold(at)) if len(at) else place >= 0
        result = np.full((len(time), 4), np.nan)
        result[counts] = values[place[counts]]
        return result

    def _count_outside(self, part: LogThrust, commands: Array) -> None:
        if part.command is None:
            return
        low, high = part.command[0], part.command[-1]
        outside = (commands < low) | (commands > high)
        if outside.any():
            values = np.unique(commands[outside])
            listed = ", ".join(f"{v:g}" for v in values[:3]) + ", …" * (len(values) > 3)
            self.notes.append(
                f"{np.count_nonzero(outside.any(axis=1))} of {len(commands)} commands lie outside the table "
                f"thrust.command, {low:g} to {high:g} ({listed}): the thrust there is not known"
            )


def _interpolated(time: Array, values: Array, at: Array) -> Array:
    # (m, columns) at the times `at`; NaN before, after, and in gaps
    order = np.argsort(time, kind="stable")
    time, values = time[order], values[order]
    result = np.full((len(at), values.shape[1]), np.nan)
    for k, column in enumerate(values.T):
        known = np.isfinite(column) & np.isfinite(time)
        own, numbers = time[known], column[known]
        if len(own) < 2:
            continue
        longest = max(_BRIDGED, _BRIDGED_PERIODS * float(np.median(np.diff(own))))
        after = np.clip(np.searchsorted(own, at), 1, len(own) - 1)
        inside = (at >= own[0]) & (at <= own[-1]) & ((own[after] - own[after - 1] <= longest) | (own[after] == at))
        result[inside, k] = np.interp(at[inside], own, numbers)
    return result
