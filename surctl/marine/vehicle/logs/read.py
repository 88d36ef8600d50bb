"""Read a recording of any format, by its suffix, and with a map as a log of motion and thrust."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import replace
from io import StringIO
from pathlib import Path

from surctl.errors import InputError
from surctl.marine.vehicle.logs.ardupilot import read_ardupilot
from surctl.marine.vehicle.logs.joining import joined
from surctl.marine.vehicle.logs.log_map import LogMap, load_log_map
from surctl.marine.vehicle.logs.recording import Reader, Recording
from surctl.marine.vehicle.logs.ros import read_bag, read_mcap
from surctl.marine.vehicle.logs.tables import read_table
from surctl.marine.vehicle.logs.ulog import read_ulog
from surctl.marine.vehicle.motion_log import MotionLog
from surctl.recorded import shown

__all__ = ["READERS", "read_mapped_log", "read_recording", "topic_lines"]

READERS: dict[str, Reader] = {
    ".bin": read_ardupilot,
    ".tlog": read_ardupilot,
    ".bag": read_bag,
    ".db3": read_bag,
    ".mcap": read_mcap,
    ".ulg": read_ulog,
}
"""Readers by the suffix of the file; a folder is a bag of ROS 2, any other file a table."""


@contextmanager
def _quiet() -> Iterator[StringIO]:
    """Catch what a reader prints; its C code, which prints past `sys.stderr`, prints nothing."""
    printed = StringIO()
    with ExitStack() as stack:
        stack.enter_context(redirect_stdout(printed))
        stack.enter_context(redirect_stderr(printed))
        sink = stack.enter_context(Path(os.devnull).open("w"))
        for number in (1, 2):
            with suppress(OSError):  # the process has no such stream
                saved = os.dup(number)
                stack.callback(os.close, saved)
                stack.callback(os.dup2, saved, number)
                os.dup2(sink.fileno(), number)
        yield printed


def read_recording(
    path: Path, topics: Collection[str] | None = None, *, log_map: LogMap | None = None, map_name: str = ""
) -> Recording:
    """Read a recording; the format follows from the suffix.

    Args:
        path: a file or, for ROS 2, a folder.
        topics: names of the topics to read; default: all.
        log_map: names the time of a table; default: column t_s.
        map_name: its file, for errors.

    Raises:
        InputError: the file does not exist or cannot be read, or a package for its format is not installed.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.vehicle import read_recording
        >>> _ = Path("log.csv").write_text("t_s,speed,mode\\n0,0.1,AUTO\\n0.5,0.2,AUTO\\n")
        >>> read_recording(Path("log.csv")).topics[""].fields["speed"].tolist()
        [0.1, 0.2]
    """
    if not path.exists():
        raise InputError("no such file", file=shown(path), remedy="check the path")
    reader = read_bag if path.is_dir() else READERS.get(path.suffix.lower())
    if reader is not None:
        with _quiet() as printed:
            recording = reader(path, topics)
        if remarks := [line.strip() for line in printed.getvalue().splitlines() if line.strip()]:
            note = f"the reader of {path.name} gave {len(remarks)} warnings; the first: {shown(remarks[0])[:200]}"
            recording = replace(recording, notes=(*recording.notes, note))
        if topics is None and not recording.topics:
            raise InputError("has no messages with numbers", file=shown(path), remedy="check the file")
        return recording
    if log_map is None:
        return read_table(path, time="t_s", unit="s")
    clock = log_map.log
    return read_table(
        path,
        time=clock.time,
        unit=clock.time_unit,
        columns=clock.columns,
        skip_lines=clock.skip_lines,
        map_name=map_name,
    )


def read_mapped_log(path: Path, map_path: Path) -> MotionLog:
    """Read a log of motion and thrust from a recording of any format with a map.

    Topics with other times are interpolated to common times; headings follow from quaternions, velocities in the
    heading frame from velocities in the body or world frame, and thrust from the commands of thrusters.

    Raises:
        InputError: the recording or the map cannot be read, a topic or field is missing, or two topics have no common
            time.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.vehicle import read_mapped_log
        >>> rows = "".join(f"{20_000_000 * k},{0.5 * k},{k % 7},1500\\n" for k in range(60))
        >>> _ = Path("dive.csv").write_text("stamp,yaw,speed,pwm\\n" + rows)
        >>> _ = Path("map.toml").write_text('''
        ... kind = "log-map"
        ... log = { frame = "ned", time = "stamp", time_unit = "ns" }
        ... attitude = { fields = ["yaw"], unit = "deg" }
        ... velocity = { fields = ["speed", "speed"], unit = "cm/s", frame = "heading" }
        ... [thrust]
        ... fields = ["pwm"]
        ... command = [1100, 1500, 1900]
        ... force_N = [-40, 0, 50]
        ... matrix = [[1], [0], [0], [0.1]]
        ... ''')
        >>> log = read_mapped_log(Path("dive.csv"), Path("map.toml"))
        >>> round(float(log.time[-1] - log.time[0]), 2), log.motion[1, 4:6].tolist()
        (1.18, [0.01, -0.01])
    """
    log_map = load_log_map(map_path)
    topics = {part.topic for _, part in log_map.sources()}
    recording = read_recording(path, topics, log_map=log_map, map_name=shown(map_path))
    if not topics <= recording.topics.keys() | recording.also.keys():
        recording = read_recording(path, log_map=log_map)  # for a message that names all topics
    return joined(recording, log_map, map_name=shown(map_path))


def topic_lines(recording: Recording) -> list[str]:
    """Return one line per topic: name, number of messages, rate, and the names of its fields.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.vehicle import read_recording, topic_lines
        >>> _ = Path("log.csv").write_text("t_s,speed,depth\\n0,0.1,2\\n0.5,0.2,2\\n")
        >>> topic_lines(read_recording(Path("log.csv")))
        ['(table): 2 messages, 2 Hz: speed, depth']
    """
    lines = []
    for name, topic in sorted(recording.topics.items()):
        span = float(topic.time[-1] - topic.time[0])
        rate = f"{(len(topic.time) - 1) / span:.3g} Hz" if span > 0 else "one time"
        lines.append(f"{name or '(table)'}: {len(topic.time)} messages, {rate}: {', '.join(topic.fields)}")
    return lines
