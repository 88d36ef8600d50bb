"""Sessions in real time over loopback, which end in every way."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from pathlib import Path

import pytest

from surctl.errors import InputError
from surctl.marine.bridge import Bridge, Ended, SimulatedSub, Wire
from surctl.marine.bridge.guardian import Guardian
from surctl.marine.bridge.live import parse_address, run_session
from surctl.marine.bridge.log import FrameLog
from surctl.marine.bridge.wire import Parser
from tests.bridge.test_rehearsal import plan

_STEP = 0.025


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.bind(("127.0.0.1", 0))
        return int(wire.getsockname()[1])


def _session_in_child(port: int, path: Path) -> int:
    bridge = Bridge(plan(), Wire())
    child = os.fork()
    if child:
        return child
    status = 1
    try:
        with FrameLog(path) as log:
            run_session(bridge, parse_address(f"udp:127.0.0.1:{port}"), log=log, limit=30.0)
    except Ended:
        status = 3
    finally:
        os._exit(status)


def _sail(
    sub: SimulatedSub, port: int, seconds: float, *, wire: socket.socket, begin: float
) -> list[tuple[float, bytes]]:
    """Run the vehicle in real time; return what reached it, with the time."""
    heard: list[tuple[float, bytes]] = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        now = time.monotonic() - begin
        while True:
            try:
                data = wire.recv(2048)
            except BlockingIOError:
                break
            except ConnectionError:
                continue
            heard.append((now, data))
            for reply in sub.hear(data, now):
                wire.sendto(reply, ("127.0.0.1", port))
        for frame in sub.advance(now):
            wire.sendto(frame, ("127.0.0.1", port))
        time.sleep(_STEP)
    return heard


def _sticks(heard: list[tuple[float, bytes]]) -> list[tuple[float, tuple[int, ...]]]:
    parser = Parser()
    found = [(t, m) for t, data in heard for m in parser.parse(data)[0] if m.get_type() == "RC_CHANNELS_OVERRIDE"]
    return [(t, (m.chan3_raw, m.chan4_raw, m.chan5_raw, m.chan6_raw)) for t, m in found]


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_a_session_that_is_ended_leaves_neutral_thrust(end: signal.Signals, tmp_path: Path) -> None:
    port, path = _free_port(), tmp_path / "session.tlog"
    sub = SimulatedSub(plan().scenario, plan().vehicle, pilot_timeout=5.0)
    child = _session_in_child(port, path)
    begin = time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.setblocking(False)
        for _ in range(100):  # until the bridge has heard that the vehicle is not armed, and its clock
            heard = _sail(sub, port, 0.1, wire=wire, begin=begin)
            if len(heard) > 2 and time.monotonic() - begin > 1.5:
                break
        sub.arm(time.monotonic() - begin)
        for _ in range(100):
            heard = _sail(sub, port, 0.2, wire=wire, begin=begin)
            before = _sticks(heard)
            if before and before[-1][1][2] > 1600:
                break
        assert before[-1][1][2] > 1600, "it never steered"
        os.kill(child, end)
        last: list[tuple[float, bytes]] = []
        for _ in range(50):  # how soon, the rehearsals measure on simulated time
            last += _sail(sub, port, 0.2, wire=wire, begin=begin)
            neutral = [t for t, sticks in _sticks(last) if sticks == (1500,) * 4]
            if len(neutral) >= 5:
                break
        after, after_end = _sticks(last), [data for _, data in last]
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == (3 if end == signal.SIGTERM else -end)
    assert len(neutral) >= 5 and all(s == (1500,) * 4 for t, s in after if t > neutral[0])
    log = path.read_bytes()
    assert all(data in log for _, data in heard), "what the vehicle received is in the record"
    if end == signal.SIGTERM:
        assert b"".join(after_end[-1:]) in log, "with the last commands"


def test_a_session_never_overwrites_another(tmp_path: Path) -> None:
    with FrameLog(tmp_path / "a.tlog") as log:
        frames = [Wire().heartbeat() for _ in range(2)]
        log.frame(1.0, b"noise".join([b"", *frames, b""]) + frames[0][:9], sent=False)
    stamp = (int((log.epoch + 1.0) * 1e6)).to_bytes(8, "big")
    assert log.path.read_bytes() == b"".join(stamp + frame for frame in frames), "a time before each frame"
    with pytest.raises(InputError, match="never overwrites"):
        FrameLog(tmp_path / "a.tlog")


def test_an_address_in_use_is_one_line() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.bind(("127.0.0.1", 0))
        port = wire.getsockname()[1]
        with pytest.raises(InputError, match="cannot be used"):
            run_session(Bridge(plan(), Wire()), parse_address(f"udp:127.0.0.1:{port}"), limit=0.1)


def test_the_guardian_sends_after_an_end_without_a_farewell() -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire,
    ):
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(30.0)
        guardian = Guardian(wire)
        guardian.tell(ear.getsockname()[:2], [b"neutral"])
        guardian.end(farewell=False)
        assert ear.recv(100) == b"neutral"


def test_a_flood_of_frames_does_not_keep_the_period_away(monkeypatch: pytest.MonkeyPatch) -> None:
    port, periods = _free_port(), []
    bridge = Bridge(plan(), Wire())
    monkeypatch.setattr(bridge, "period", lambda now: periods.append(now) or [])
    monkeypatch.setattr(bridge, "hear", lambda data, now: ())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        stop = threading.Event()

        def flood() -> None:
            while not stop.is_set():
                wire.sendto(b"x" * 100, ("127.0.0.1", port))

        sender = threading.Thread(target=flood)
        sender.start()
        try:
            run_session(bridge, parse_address(f"udp:127.0.0.1:{port}"), limit=0.5)
        finally:
            stop.set()
            sender.join()
    assert len(periods) >= 4
