"""Join the topics of a recording to a log of motion and thrust: common times, heading, velocity, thrust."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.vehicle.frames import swap_body
from surctl.marine.vehicle.logs.log_map import LogMap, Source, Thrust
from surctl.marine.vehicle.logs.recording import Recording, Topic, step_back
from surctl.marine.vehicle.motion_log import MotionLog, swapped
from surctl.units import in_unit

__all__ = ["heading_frame", "joined", "roll_pitch_heading"]

_BRIDGED, _BRIDGED_PERIODS = 0.5, 5.0  # motion is interpolated over at most this [s], or these periods
_NORM, _SHARE = 0.05, 0.01  # a quaternion is not of length 1 if more than this share of its norms are off by this
_HELD, _HELD_PERIODS = 1.0, 10.0  # a command counts for at most this [s], or these periods

Array = NDArray[np.float64]


def roll_pitch_heading(quaternion: Array) -> Array:
    """Return roll, pitch and heading (n, 3) [rad] of quaternions (n, 4) x, y, z, w from the body to the world frame.

    The angles are those of the order z, y, x (Fossen 2021, section 2.2). The quaternions need not have length 1.

    Example:
        >>> import numpy as np
        >>> from surctl.marine.vehicle.logs.joining import roll_pitch_heading
        >>> roll_pitch_heading(np.array([[0.0, 0.0, 2.0, 2.0]])).round(4).tolist()
        [[0.0, 0.0, 1.5708]]
    """
    size = np.linalg.norm(quaternion, axis=1, keepdims=True)
    x, y, z, w = (quaternion / np.where(size > 0, size, np.nan)).T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.column_stack([roll, pitch, heading])


def heading_frame(velocity: Array, roll: Array, pitch: Array) -> Array:
    """Return velocities (n, 3) in the heading frame from those in the body frame, by roll and pitch [rad] (n,).

    Example:
        >>> import numpy as np
        >>> from surctl.marine.vehicle.logs.joining import heading_frame
        >>> heading_frame(np.array([[1.0, 0.0, 0.0]]), np.zeros(1), np.array([np.pi / 2])).round(3).tolist()
        [[0.0, 0.0, -1.0]]
    """
    u, v, w = velocity.T
    across, down = v * np.cos(roll) - w * np.sin(roll), v * np.sin(roll) + w * np.cos(roll)
    return np.column_stack([u * np.cos(pitch) + down * np.sin(pitch), across, down * np.cos(pitch) - u * np.sin(pitch)])


def joined(recording: Recording, log_map: LogMap, *, map_name: str) -> MotionLog:
    """Return the log of motion and thrust of a recording, in the frame enu.

    The common times are those of the velocity, else of the position, else of the attitude, else of the rates; or a
    constant period. Motion is interpolated between its messages, but not across a gap. A command counts until the next
    one. An attitude of 3 or 4 fields gives roll and pitch too, and rates of 3 fields p and q.

    Raises:
        InputError: a topic or field is missing, a unit is wrong, or topics have no common time.
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
            velocity = heading_frame(velocity, roll, pitch)
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
    topic = sources.topic("attitude", part)
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
    return _interpolated(sources.time("attitude", part), angles, time) if len(topic.time) else None


def _check_norm(quaternion: Array, sources: _Sources, part: Source) -> None:
    # a quaternion of zeros is one that was not set
    norms = np.linalg.norm(quaternion, axis=1)
    norms = norms[np.isfinite(norms) & (norms > 0)]
    if len(norms) and np.mean(np.abs(norms - 1) > _NORM) > _SHARE:
        raise InputError(
            f"is not a unit quaternion: norm {norms.min():.3g} to {norms.max():.3g} in {sources.recording.source}",
            file=sources.map_name,
            key="attitude.fields",
            value=list(part.fields),
            remedy="name the fields x, y, z, w of a quaternion",
        )


class _Sources:
    # the parts of the map, read from the recording
    def __init__(self, recording: Recording, log_map: LogMap, map_name: str) -> None:
        self.recording, self.map, self.map_name = recording, log_map, map_name
        self.notes: list[str] = []
        for key, names in (("stamp", log_map.log.stamp), ("shift_s", log_map.log.shift_s)):
            for topic in names:
                if topic not in {part.topic for _, part in log_map.sources()}:
                    raise InputError(
                        "is not a topic of this map",
                        file=map_name,
                        key=f"log.{key}",
                        value=topic,
                        remedy="remove the entry",
                    )

    def topic(self, name: str, part: Source) -> Topic:
        try:
            return self.recording.topic(part.topic, key=f"{name}.topic")
        except InputError as error:
            raise error.inside(self.map_name) from None

    def fields(self, name: str, part: Source) -> Array:
        # (n, fields); an empty name is an axis without thrust, or motion that was not measured
        topic = self.topic(name, part)
        absent = np.full(len(topic.time), 0.0 if name == "thrust" else np.nan)
        try:
            return np.column_stack(
                [self.recording.column(part.topic, k, key=f"{name}.fields") if k else absent for k in part.fields]
            )
        except InputError as error:
            raise error.inside(self.map_name) from None

    def factor(self, name: str, unit: str, target: str) -> float:
        try:
            return in_unit(1.0, unit, target)
        except InputError as error:
            raise error.inside(self.map_name, f"{name}.unit") from None

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

    def _count_outside(self, part: Thrust, commands: Array) -> None:
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
