"""A simulated link: frames that are lost, late, out of order, repeated or damaged."""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field

import numpy as np

from surctl.errors import InputError

__all__ = ["Channel", "LinkQuality"]


@dataclass(frozen=True, kw_only=True)
class LinkQuality:
    """Quality of a simulated link, for each direction.

    Attributes:
        loss: probability in [0, 1] that a frame is lost.
        delay: delay of a frame [s].
        jitter: largest further delay [s], random for each frame, so that frames overtake each other.
        damaged: probability that a byte of a frame is changed, or that the frame is cut.
        repeated: probability that a frame arrives twice.
    """

    loss: float = 0.0
    delay: float = 0.0
    jitter: float = 0.0
    damaged: float = 0.0
    repeated: float = 0.0

    def __post_init__(self) -> None:
        """Raise InputError for a probability outside [0, 1], or a time outside [0, 60] s."""
        for key in ("loss", "damaged", "repeated"):
            value = getattr(self, key)
            if not 0.0 <= value <= 1.0:
                raise InputError("is not a probability", key=key, value=value, remedy="use 0 to 1")
        for key in ("delay", "jitter"):
            value = getattr(self, key)
            if not 0.0 <= value <= 60.0:
                raise InputError("is not a valid time", key=key, value=value, remedy="give 0 to 60 s")


@dataclass
class Channel:
    """One direction of a simulated link.

    Attributes:
        quality: loss, delay and damage.
        seed: seed of the random choices.
        cut: while True, nothing arrives that is sent.

    Example:
        >>> from surctl.marine.bridge import Channel, LinkQuality
        >>> channel = Channel(LinkQuality(delay=0.3))
        >>> channel.send(b"frame", 0.0)
        >>> channel.arrived(0.2), channel.arrived(0.3)
        ([], [b'frame'])
    """

    quality: LinkQuality = field(default_factory=LinkQuality)
    seed: int = 0
    cut: bool = False
    _queue: list[tuple[float, int, bytes]] = field(default_factory=list, init=False)
    _count: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng([self.seed, 36])

    def send(self, frame: bytes, now: float) -> None:
        """Send a frame at `now` [s]."""
        q, rng = self.quality, self._rng
        numbers = rng.random(5).tolist()
        if self.cut or numbers[0] < q.loss:
            return
        if numbers[1] < q.damaged:
            frame = self._damaged(frame)
        for _ in range(2 if numbers[2] < q.repeated else 1):
            self._count += 1
            late = q.delay + q.jitter * float(rng.random()) if q.jitter else q.delay
            heapq.heappush(self._queue, (now + late, self._count, frame))

    def _damaged(self, frame: bytes) -> bytes:
        at = int(self._rng.integers(len(frame)))
        if self._rng.random() < 0.3:
            return frame[:at] or b"\xfd"
        changed = bytearray(frame)
        changed[at] ^= int(self._rng.integers(1, 256))
        return bytes(changed)

    def arrived(self, now: float) -> list[bytes]:
        """Return the frames that have arrived by `now` [s], in the order of their arrival."""
        frames = []
        while self._queue and self._queue[0][0] <= now + 1e-9:
            frames.append(heapq.heappop(self._queue)[2])
        return frames
