"""A recording of any format: names of topics, ambiguous ones, times out of order; the interface of all readers."""

from __future__ import annotations

import importlib
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, check_known, nearest
from surctl.recorded import shown

_LONGEST = 64  # numbers of an array that become fields
_JITTER = 1.0  # [s] messages that are late by at most this are sorted


class Stream(NamedTuple):
    """What the messages of one source are of.

    Attributes:
        topic: name of the topic or type of message.
        instance: number or name of one of several equal sensors or outputs, such as the port of SERVO_OUTPUT_RAW.
        source: who sent the messages, such as `1.1`, system and component of MAVLink; empty if the file does not say.
    """

    topic: str
    instance: float | str | None = None
    source: str = ""

    @property
    def names(self) -> tuple[str, str]:
        """The topic with the instance, and with instance and source."""
        named = self.topic if self.instance is None else f"{self.topic}[{self.instance}]"
        return named, f"{named}@{self.source}" if self.source else named


@dataclass(frozen=True, eq=False)
class Topic:
    """The messages of one topic.

    Attributes:
        time: (n,) [s] by the clock of the recording.
        fields: (n,) numbers by field; NaN where a message does not have the field. A field of a nested message is
            `pose.position.x`, an entry of an array `data[3]`.
        back: times [s] before and after the first place where the clock runs back by more than a second, if it does.
        repeated: number of messages that are not used, because a later one has the same time.
    """

    time: NDArray[np.float64]
    fields: Mapping[str, NDArray[np.float64]]
    back: tuple[float, float] | None = None
    repeated: int = 0


@dataclass(frozen=True, eq=False)
class LogRecording:
    """Topics by name, and notes on what could not be read; a table of one clock has one topic with an empty name.

    `also` has other names of topics; a name that several topics share stands for none of them.
    """

    source: str
    topics: Mapping[str, Topic]
    also: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def topic(self, name: str, *, key: str) -> Topic:
        """Return a topic by name."""
        meant = (name,) if name in self.topics else self.also.get(name, ())
        if len(meant) > 1:
            problem = f"has several sources in {self.source}"
            raise InputError(problem, key=key, value=name, remedy=f"name one of: {', '.join(meant)}")
        if not meant:
            remedy = nearest(name, self.topics) if name else f"name one of: {', '.join(sorted(self.topics))}"
            raise InputError(f"is not a topic of {self.source}", key=key, value=name, remedy=remedy)
        return self.topics[meant[0]]

    def column(self, topic: str, name: str, *, key: str) -> NDArray[np.float64]:
        """Return a field (n,) of a topic by name."""
        fields = self.topic(topic, key=key).fields
        where = f"topic {topic} of {self.source}" if topic else self.source
        check_known(name, fields, f"is not a numeric field of {where}", key=key)
        return fields[name]

    def remarks(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return the notes of the recording, and what is to be said of the topics with some names."""
        lines = list(self.notes)
        for name in dict.fromkeys(names):
            topic = self.topic(name, key="topic")
            if topic.repeated:
                whole = len(topic.time) + topic.repeated
                lines.append(f"{topic.repeated} of {whole} messages of {name or 'the table'} repeat a time: not used")
            others = [other for other in self.topics if other.startswith(f"{name}[")] if name else []
            lines += [f"{name} is the first instance; not used: {', '.join(others)}"] if others else []
        return tuple(lines)


@dataclass
class TopicRows:
    """Messages of one topic while a file is read."""

    time: list[float] = field(default_factory=list)
    messages: list[dict[str, float]] = field(default_factory=list)

    def append(self, time: float, numbers: Iterable[tuple[str, float]]) -> None:
        """Append one message."""
        self.time.append(time)
        self.messages.append(dict(numbers))

    def topic(self) -> Topic:
        """Return the messages in the order of time; of messages at the same time, the last one."""
        names = dict.fromkeys(name for message in self.messages for name in message)
        nan = float("nan")
        columns = {k: np.array([message.get(k, nan) for message in self.messages]) for k in names}
        return topic_of(np.array(self.time), columns)


def topic_of(time: NDArray[np.float64], fields: Mapping[str, NDArray[np.float64]]) -> Topic:
    """Return messages at finite times (n,) in the order of time; of messages at the same time, the last one."""
    order = np.argsort(time, kind="stable")
    last = np.append(np.diff(time[order]) > 0, True)[: len(order)]
    chosen = order[last]
    repeated = len(order) - len(chosen)
    return Topic(time[chosen], {k: v[chosen] for k, v in fields.items()}, step_back(time), repeated)


def recording_of(path: Path, topics: Mapping[Stream, Topic], notes: Iterable[str] = ()) -> LogRecording:
    """Return the recording of a file that was read; topics without fields are omitted.

    The lowest instance of a topic has the name of the topic, the others have names such as `XKF1[1]`; instances with
    names of their own all have names such as `NAMED_VALUE_FLOAT[roll]`. If several sources sent a topic, its names say
    which, such as `ATTITUDE@1.1`.
    """
    full = {stream: topic for stream, topic in topics.items() if topic.fields}
    numbers: dict[str, list[float]] = {}
    for stream in full:
        if isinstance(stream.instance, int | float):
            numbers.setdefault(stream.topic, []).append(stream.instance)
    also: dict[str, list[Stream]] = {}
    for stream in full:
        named: tuple[str, ...] = stream.names
        if stream.instance is None or stream.instance == min(numbers.get(stream.topic, [np.nan])):
            named = (*stream._replace(instance=None).names, *named)
        elif not isinstance(stream.instance, int | float):
            named = (*named, stream.topic)
        for name in dict.fromkeys(named):
            also.setdefault(name, []).append(stream)
    best = {
        stream: next(name for name, meant in also.items() if meant == [stream])  # the shortest: it was added first
        for stream in full
    }
    others = {name: tuple(best[s] for s in meant) for name, meant in also.items()}
    return LogRecording(
        shown(path),
        {best[stream]: topic for stream, topic in full.items()},
        {name: meant for name, meant in others.items() if meant != (name,)},
        tuple(notes),
    )


def bare_names(names: Collection[str] | None) -> list[str] | None:
    """Return names without instance and source, each once; None is any name."""
    return None if names is None else sorted({re.split(r"[\[@]", name)[0] for name in names})


def matches(topic: str, names: Collection[str] | None) -> bool:
    """Return whether one of some names, with or without instance and source, is of a topic; None is any name."""
    return names is None or any(name == topic or name.startswith((f"{topic}[", f"{topic}@")) for name in names)


def step_back(time: NDArray[np.float64]) -> tuple[float, float] | None:
    """Return the latest time so far and the next time [s] where a clock (n,) first runs back by more than a second.

    Messages that are late by less are no such step, because a recorder may write the messages of its sources in turn.
    """
    latest = np.maximum.accumulate(time) if len(time) else time
    back = np.flatnonzero(time < latest - _JITTER)
    return (float(latest[back[0]]), float(time[back[0]])) if len(back) else None


def flattened(value: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of a nested message with their names: `pose.position.x`, `data[3]`; skip other values."""
    if isinstance(value, bool | int | float | np.number | np.bool_):
        yield name, float(value)
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield from flattened(inner, f"{name}.{key}" if name else str(key))
    elif hasattr(value, "__dataclass_fields__"):
        for key in value.__dataclass_fields__:
            if not key.startswith("__"):
                yield from flattened(getattr(value, key), f"{name}.{key}" if name else key)
    elif isinstance(value, list | tuple | np.ndarray) and len(value) <= _LONGEST:
        for k, inner in enumerate(value):
            yield from flattened(inner, f"{name}[{k}]")


def optional_module(name: str, *, path: Path, extra: str) -> Any:
    """Return a module of an optional package."""
    try:
        return importlib.import_module(name)
    except ImportError:
        package = name.partition(".")[0]
        problem = f"needs the package {package}, which is not installed"
        raise InputError(problem, file=shown(path), remedy=f"install it: pip install 'surctl[{extra}]'") from None
