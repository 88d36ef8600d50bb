"""A session over UDP in real time: address of `--mavlink`, sockets, clock, and the end by arrival or signals."""

from __future__ import annotations

import select
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from types import FrameType
from typing import Protocol

from surctl.errors import InputError, nearest
from surctl.marine.bridge.bridge import Bridge
from surctl.marine.bridge.guardian import Guardian

_FORMS = ("udp", "udpin", "udpout")
_NEUTRAL = 5  # periods with neutral commands at the end of a session
_GRACE = 0.01  # [s] after the begin of a period, for frames that have already arrived
_LARGEST = 2048  # bytes of a datagram


@dataclass(frozen=True)
class Address:
    """Address of the link: listen at it (`udp:`, `udpin:`), or send to it first (`udpout:`)."""

    host: str
    port: int
    listen: bool


class Ended(Exception):
    """A signal asks the session to end."""


class SessionLog(Protocol):
    """What records a session."""

    def frame(self, now: float, data: bytes, *, sent: bool) -> None:
        """Record a datagram."""

    def period(self, bridge: Bridge) -> None:
        """Record the newest control period of the bridge."""


def parse_address(text: str) -> Address:
    """Return the address of a text "udp:HOST:PORT" (listen, as `udpin:` does) or "udpout:HOST:PORT"."""
    kind, _, rest = text.partition(":")
    host, _, number = rest.rpartition(":")
    if kind not in _FORMS:
        raise InputError("is not known", key="--mavlink", value=text, remedy=nearest(kind, _FORMS))
    port = int(number) if number.isdecimal() and len(number) < 6 else 0
    if not host or not 0 < port < 65536:
        raise InputError(
            "is not an address",
            key="--mavlink",
            value=text,
            remedy=f"write {kind}:HOST:PORT, such as {kind}:127.0.0.1:14550",
        )
    host = host.removeprefix("[").removesuffix("]")  # as IPv6 addresses are often written
    try:
        host.encode("idna")
    except UnicodeError:
        raise InputError(
            "is not a name or number of a computer", key="--mavlink", value=host, remedy="such as 127.0.0.1"
        ) from None
    return Address(host, port, kind != "udpout")


def run_session(
    bridge: Bridge,
    address: Address,
    *,
    log: SessionLog | None = None,
    said: Callable[[str], None] = lambda _: None,
    limit: float | None = None,
) -> bool:
    """Run a session in real time until arrival and the operator's disarming; return whether the vehicle arrived.

    However the session ends, neutral commands are sent if the bridge was sending commands: here after Ctrl-C or a
    signal to end, and by `guardian` after a kill signal.

    Args:
        bridge: the bridge, before its first period.
        address: where the autopilot, or its router, is.
        said: is called with each line for the operator.
        limit: longest time [s]; None: no limit.

    Raises:
        InputError: the address cannot be used.
        Ended: a signal ended the session.
    """
    with _opened(address) as wire, _endings():
        guardian = Guardian(wire)
        loop = _Loop(bridge, wire, guardian, log, said, bridge.neutral())
        try:
            loop.run(None if address.listen else (address.host, address.port), limit)
        finally:
            guardian.end(farewell=loop.ended)
    return bridge.session.phase == "arrived" or bridge.arrived


@dataclass
class _Loop:
    bridge: Bridge
    wire: socket.socket
    guardian: Guardian
    log: SessionLog | None
    said: Callable[[str], None]
    neutral: list[bytes]
    lines: int = 0
    ended: bool = False

    def run(self, peer: tuple[str, int] | None, limit: float | None) -> None:
        bridge, dt = self.bridge, self.bridge.plan.law.dt
        begin, due = time.monotonic(), 0.0
        try:
            while limit is None or due <= limit:
                peer = self._listen(peer, begin, due)
                now = time.monotonic() - begin
                self._send(bridge.period(now), peer, now)
                self.guardian.tell(peer, self.neutral if bridge.active else [])
                self._report()
                if bridge.arrived and bridge.session.phase in ("released", "ready") and not bridge.active:
                    break
                due = max(due + dt, now)  # a late period is not made up for
        finally:
            for _ in range(_NEUTRAL if bridge.active else 0):
                with suppress(OSError):  # a record that cannot be written must not keep the commands away
                    self._send(bridge.neutral(), peer, time.monotonic() - begin)
                time.sleep(dt)
            self.ended = True  # else, after a second Ctrl-C for instance, the guardian sends the neutral commands

    def _listen(self, peer: tuple[str, int] | None, begin: float, due: float) -> tuple[str, int] | None:
        while True:
            now = time.monotonic() - begin
            ready, _, _ = select.select([self.wire], [], [], max(0.0, due - now))
            if not ready:
                return peer
            try:
                data, sender = self.wire.recvfrom(_LARGEST)
            except OSError:  # an earlier frame came back: nobody listens there yet
                continue
            now = time.monotonic() - begin
            if self.log is not None:
                self.log.frame(now, data, sent=False)
            events = self.bridge.hear(data, now)
            if any(type(event).__name__ == "Beat" for event in events):
                peer = sender[:2]
            if now > due + _GRACE:  # a flood of frames must not keep the period away
                return peer

    def _send(self, frames: list[bytes], peer: tuple[str, int] | None, now: float) -> None:
        if peer is None:
            return
        for frame in frames:
            with suppress(OSError):
                self.wire.sendto(frame, peer)
        if self.log is not None:
            for frame in frames:
                self.log.frame(now, frame, sent=True)

    def _report(self) -> None:
        if self.log is not None:
            self.log.period(self.bridge)
        for at, text in self.bridge.texts[self.lines :]:
            self.said(f"{at:8.2f} s  {text}")
        self.lines = len(self.bridge.texts)


@contextmanager
def _opened(address: Address) -> Iterator[socket.socket]:
    try:
        kind = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)[0]
        wire = socket.socket(kind[0], socket.SOCK_DGRAM)
    except OSError as error:
        raise _unusable(address, error) from None
    with wire:
        if address.listen:
            try:
                wire.bind((address.host, address.port))
            except OSError as error:
                raise _unusable(address, error) from None
        wire.setblocking(False)
        yield wire


def _unusable(address: Address, error: OSError) -> InputError:
    return InputError(
        f"cannot be used ({error.strerror})",
        key="--mavlink",
        value=f"{address.host}:{address.port}",
        remedy="use an address of this machine and a port that no other program uses"
        if address.listen
        else "give the address of the vehicle's computer",
    )


@contextmanager
def _endings() -> Iterator[None]:
    # signals that end a program become an exception, so that the last commands are neutral
    def end(number: int, _: FrameType | None) -> None:
        raise Ended(signal.Signals(number).name)

    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {}
    with suppress(ValueError):  # not in the main thread
        before = {number: signal.signal(number, end) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
