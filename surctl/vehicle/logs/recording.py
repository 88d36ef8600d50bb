"""A recording of any format: topics, each with a time and numeric fields; the interface of all readers."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.recorded import shown

__all__ = ["Reader", "Recording", "Rows", "Topic", "flattened", "optional_module", "recording_of", "step_back"]

_LONGEST = 64  # numbers of an array that become fields
_JITTER = 1.0  # [s] messages that are late by at most this are sorted

Reader = Callable[[Path, Collection[str] | None], "Recording"]
"""Reads the topics with some names, or all, from a file."""


@dataclass(frozen=True, eq=False)
class Topic:
    """The messages of one topic.

    Attributes:
        time: (n,) [s] by the clock of the recording.
        fields: (n,) numbers by field; NaN where a message does not have the field. A field of a nested message is
            `pose.position.x`, an entry of an array `data[3]`.
        back: times [s] before and after the first place where the clock runs back by more than a second, if it does.
    """

    time: NDArray[np.float64]
    fields: Mapping[str, NDArray[np.float64]]
    back: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Recording:
    """Topics by name; a table of one clock has one topic with an empty name.

    Attributes:
        source: name of the file for messages.
        topics: the topics by name.
        frame: frame that the file states; empty if it states none.
    """

    source: str
    topics: Mapping[str, Topic]
    frame: str = ""

    def topic(self, name: str, *, key: str) -> Topic:
        """Return a topic by name.

        Raises:
            InputError: the recording has no such topic; the message suggests the most similar one.
        """
        if name not in self.topics:
            remedy = nearest(name, self.topics) if name else f"name one of: {', '.join(sorted(self.topics))}"
            raise InputError(f"is not a topic of {self.source}", key=key, value=name, remedy=remedy)
        return self.topics[name]

    def column(self, topic: str, name: str, *, key: str) -> NDArray[np.float64]:
        """Return a field (n,) of a topic by name.

        Raises:
            InputError: the topic has no such field; the message suggests the most similar one.
        """
        fields = self.topic(topic, key=key).fields
        if name not in fields:
            where = f"topic {topic} of {self.source}" if topic else self.source
            raise InputError(f"is not a numeric field of {where}", key=key, value=name, remedy=nearest(name, fields))
        return fields[name]


@dataclass
class Rows:
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
        time = np.array(self.time)
        order = np.argsort(time, kind="stable")
        order = order[np.append(np.diff(time[order]) > 0, True)]
        return Topic(time[order], {k: v[order] for k, v in columns.items()}, step_back(time))


def recording_of(path: Path, rows: Mapping[str, Rows]) -> Recording:
    """Return the recording of a file that was read; topics without numbers are omitted."""
    return Recording(shown(path), {name: one.topic() for name, one in rows.items() if any(one.messages)})


def step_back(time: NDArray[np.float64]) -> tuple[float, float] | None:
    """Return the latest time so far and the next time [s] where a clock (n,) first runs back by more than a second.

    Messages that are late by less are no such step, because a recorder may write the messages of its sources in turn.

    Example:
        >>> import numpy as np
        >>> from surctl.vehicle.logs.recording import step_back
        >>> step_back(np.array([0.0, 0.2, 0.1, 0.3])), step_back(np.array([7.0, 8.0, 0.5]))
        (None, (8.0, 0.5))
    """
    latest = np.maximum.accumulate(time) if len(time) else time
    back = np.flatnonzero(time < latest - _JITTER)
    return (float(latest[back[0]]), float(time[back[0]])) if len(back) else None


def flattened(value: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of a nested message with their names: `pose.position.x`, `data[3]`; other values are skipped.

    Example:
        >>> from surctl.vehicle.logs.recording import flattened
        >>> dict(flattened({"header": {"frame": "map"}, "pose": {"x": 1.5}, "data": [2, 3]}))
        {'pose.x': 1.5, 'data[0]': 2.0, 'data[1]': 3.0}
    """
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
    """Return a module of an optional package.

    Raises:
        InputError: the package is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        package = name.partition(".")[0]
        raise InputError(
            f"needs the package {package}, which is not installed",
            file=shown(path),
            remedy=f"install it: pip install 'surctl[{extra}]'",
        ) from None
