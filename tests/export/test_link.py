"""The exported controller as a process of its own: real processes, what the line does to them, and what comes of it."""

from __future__ import annotations

import contextlib
import signal
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.export import TARGETS, Bundle, SerialLine, connect, emulated, emulated_target, write_bundle
from surctl.export.emulated import VERSION, Identity, LineDown, Reply
from surctl.export.precision import Rounded
from surctl.ir import Layout, Port, Real
from surctl.ir.cache import compile_program
from surctl.marine.control import Law, build_law, load_gains
from surctl.marine.export import LinkedLaw, LinkFaults, build_bundle, closed_form
from surctl.marine.simulation import Run, law_numbers, load_scenario, simulate
from surctl.marine.simulation.metrics import GONE, LATE, LINK_LOST
from surctl.marine.vehicle import load_vehicle
from surctl.system import ControllerStep
from tests.export import test_check
from tests.export.altered import altered
from tests.export.standin import StandIn
from tests.export.test_check import Exact
from tests.tools import PATIENCE, need, need_compiler

Vector = NDArray[np.float64]
REALS: tuple[Real, ...] = ("float64", "float32")
COMMAND, PAUSED = 9, 10  # kinds of messages
HEAD = struct.Struct("<4sHHII")
GLANCED = {"latch": "progress", "report": "healthy"}


@cache
def exact() -> Exact:
    """The stand-in with names that a compact reply carries."""
    law = test_check.exact()
    state, outputs = (
        Layout(tuple(replace(port, name=GLANCED.get(port.name, port.name)) for port in layout))
        for layout in (law.state, law.outputs)
    )
    return replace(law, state=state, outputs=outputs)


def program(
    law: object, p: Vector, folder: Path, real: Real, *, change: Callable[[Bundle], Bundle] = lambda bundle: bundle
) -> Path:
    """The compiled controller, its law's C changed."""
    shipped = closed_form(law, real=real) if isinstance(law, Law) else law
    bundle = change(build_bundle(shipped, law.gains.unpack(p), real=real))  # type: ignore[attr-defined, arg-type]
    write_bundle(bundle, folder)
    sources = [folder / file for file in ("controller.c", "link.c", *bundle.sources)]
    return compile_program(sources, folder / "controller", flags=("-O0",))


@contextmanager
def serving(path: Path, *words: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The process, and where it listens."""
    process = subprocess.Popen([str(path), *(words or ("0",))], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process, process.stdout.readline().split()[-1]
    finally:
        process.kill()
        process.communicate()


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> dict[Real, Path]:
    """The stand-in as a process, in both precisions."""
    need_compiler()
    law = exact()
    return {real: program(law, law.gains.pack(), tmp_path_factory.mktemp(real), real) for real in REALS}


@pytest.fixture
def line(small: dict[Real, Path]) -> Iterator[SerialLine]:
    with serving(small["float32"]) as (_, where), connect(where) as opened:
        yield opened


def stepped(law: Exact, linked: LinkedLaw, count: int) -> None:
    rng, x = np.random.default_rng(1), law.initial_state()
    for _ in range(count):
        x = linked(x, law.inputs.pack() + rng.normal(0.0, 3.0, law.inputs.size), law.gains.pack()).x_next


@pytest.mark.parametrize("real", REALS)
def test_a_process_answers_as_python_does_to_the_last_bit(small: dict[Real, Path], real: Real) -> None:
    law = exact()
    with serving(small[real]) as (_, where), connect(where) as opened:
        for _ in range(2):  # the second run begins anew
            linked = LinkedLaw(law, law.gains.pack(), opened)
            stepped(law, linked, 100)
            report = linked.report()
            assert (report.real, report.answered, report.differing, report.failsafe) == (real, 100, 0, 0)
            assert "all as in Python" in report.line()


def test_another_answer_is_found_at_its_first_step(tmp_path: Path) -> None:
    need_compiler()
    law = exact()

    def negated(bundle: Bundle) -> Bundle:
        return altered(bundle, r"(\nvoid standin_law\(.*?)\+", r"\1-")

    with (
        serving(program(law, law.gains.pack(), tmp_path, "float32", change=negated)) as (_, where),
        connect(where) as a,
    ):
        linked = LinkedLaw(law, law.gains.pack(), a)
        stepped(law, linked, 30)
        report = linked.report()
        assert report.differing > 0 and report.first is not None and "DIFFER" in report.line()


def test_one_bit_of_thrust_state_or_telemetry_is_enough(line: SerialLine, monkeypatch: pytest.MonkeyPatch) -> None:
    law, asked = exact(), line.step
    last = 4 * (law.outputs.size + law.state.size)
    flipped = {3: 0, 5: 4 * 4, 8: last - 4}  # the lowest bit of the first thrust and state, and of the last telemetry

    def step(sequence: int, inputs: Vector, *, compact: bool) -> Reply:
        answer = asked(sequence, inputs, compact=compact)
        assert len(answer.raw) == last
        changed = bytearray(answer.raw)
        if sequence in flipped:
            changed[flipped[sequence]] ^= 1
        return answer._replace(raw=bytes(changed))

    monkeypatch.setattr(line, "step", step)
    linked = LinkedLaw(law, law.gains.pack(), line)
    stepped(law, linked, 20)
    report = linked.report()
    assert (report.differing, report.first, report.answered) == (3, 2, 20)


def test_another_controller_is_refused_by_both_ends(line: SerialLine) -> None:
    law = exact()
    with pytest.raises(InputError, match=r"runs controller \w{12} in float32, but these options give"):
        LinkedLaw(law, 2.0 * law.gains.pack(), line)
    with pytest.raises(LineDown, match="runs another controller"):
        line.start("0" * 64)
    assert line.request().id == build_bundle(law, {}, real="float32").id  # and it goes on


def raw(where: str, sent: bytes) -> bytes:
    """All that a controller sends back until it hangs up."""
    with connect(where).wire as wire:
        wire.sendall(sent)
        wire.shutdown(socket.SHUT_WR)
        return b"".join(iter(lambda: wire.recv(4096), b""))


def test_what_is_no_message_is_refused_and_the_next_robot_is_served(small: dict[Real, Path]) -> None:
    law = exact()
    width = 4 * law.inputs.size
    with serving(small["float32"]) as (process, where):
        for sent, code in (
            (b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n", 1),
            (bytes(16), 1),
            (HEAD.pack(b"SURL", 1, 1, 0, 0), 2),
            (HEAD.pack(b"SURL", VERSION, 99, 7, 0), 3),
            (HEAD.pack(b"SURL", VERSION, 5, 7, 0xFFFFFFFF) + bytes(40_000), 4),
            (HEAD.pack(b"SURL", VERSION, 5, 7, width) + bytes(width), 6),
        ):
            told = raw(where, sent)
            assert HEAD.unpack(told[:16])[:3] == (b"SURL", VERSION, 7) and struct.unpack("<I", told[16:]) == (code,)
        assert raw(where, b"SURL") == b"" and process.poll() is None  # cut short
        with connect(where) as opened:
            opened.start(opened.request().id)
            opened.step(3, law.inputs.pack())
            with pytest.raises(LineDown, match="already received this step"):
                opened.step(3, law.inputs.pack())
            opened.step(4, law.inputs.pack())


@pytest.mark.parametrize(
    ("sent", "told"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n", "is not a controller of this kind"),
        (
            HEAD.pack(b"SURL", 1, 2, 0, 88) + bytes(88),
            "speaks version 1 of the link protocol, this program version 2",
        ),
        (HEAD.pack(b"SURL", VERSION, 4, 0, 0), "a reply that does not fit the request"),
        (HEAD.pack(b"SURL", VERSION, 7, 0, 4) + struct.pack("<I", 77), "refuses, with code 77"),
        (HEAD.pack(b"SURL", VERSION, 2, 0, 88) + bytes(88), "that is not possible"),
        (HEAD.pack(b"SURL", VERSION, 2, 0, 88) + bytes(3), "was silent"),
        (None, "closed the connection"),
    ],
)
def test_whatever_is_at_the_other_end_is_told_in_one_line(sent: bytes | None, told: str) -> None:
    mine, other = socket.socketpair()
    with other, SerialLine(mine, "tcp://there", 0.2) as opened:
        if sent is None:
            other.close()
        else:
            other.sendall(sent)
        law = exact()
        with pytest.raises(InputError, match=told) as caught:
            LinkedLaw(law, law.gains.pack(), opened)
        assert caught.value.exit_status == 2 and "\n" not in str(caught.value)


def test_ctrl_c_is_seen_even_where_it_wakes_no_system_call() -> None:
    """As one does that comes after Python's last look and before the call."""

    def interrupt() -> None:
        time.sleep(0.2)
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)  # wakes this thread, not the one that waits

    before, began = signal.signal(signal.SIGINT, signal.default_int_handler), time.monotonic()
    try:
        with (
            socket.create_server(("127.0.0.1", 0)) as silent,
            connect(f"tcp://127.0.0.1:{silent.getsockname()[1]}", patience=60) as opened,
            pytest.raises(KeyboardInterrupt),
        ):
            threading.Thread(target=interrupt).start()
            opened.request()
    finally:
        signal.signal(signal.SIGINT, before)
    assert time.monotonic() - began < 30  # not at the end of its patience


@pytest.mark.parametrize("address", ["tcp://127.0.0.1", "tcp://[::1:5", "tcp://a:70000", "http://a:1", "tcp://:5", "x"])
def test_what_is_no_address(address: str) -> None:
    with pytest.raises(InputError, match="is not the address of a controller"):
        connect(address)


def test_nobody_listens() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        where = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        with pytest.raises(InputError, match=r"no controller listens there .*make controller"):
            connect(where)


def test_it_listens_on_the_loopback_alone(small: dict[Real, Path]) -> None:
    path = small["float32"]
    with serving(path) as (_, where):
        port = where.rsplit(":", 1)[1]
        assert where == f"tcp://127.0.0.1:{port}"
        for words, told in (
            ((port,), "Address already in use"),
            (("0", "0.0.0.0"), "--anywhere"),
            (("70000",), "not a numeric address"),
            ((), "usage"),
        ):
            done = subprocess.run([str(path), *words], capture_output=True, text=True, check=False, timeout=PATIENCE)
            assert done.returncode == 2 and told in done.stderr and done.stderr.count("\n") == 1
    if socket.has_ipv6:
        try:
            with socket.create_server(("::1", 0), family=socket.AF_INET6):
                pass
        except OSError:
            return  # a machine without IPv6
        with serving(path, "0", "::1") as (_, where), connect(where) as opened:
            assert where.startswith("tcp://[::1]:") and opened.request().inputs == exact().inputs.size


LAW = exact()


@cache
def who() -> Identity:
    return Identity(build_bundle(LAW, {}, real="float32").id, "float32", LAW.inputs.size, 4, LAW.state.size, 0)


@dataclass
class Echo(SerialLine):
    """A line to nobody: Python answers, with the number of the step as its first thrust."""

    ends_at: int = 1 << 30

    def start(self, identity: str) -> None:
        pass

    def request(self) -> Identity:
        return who()

    def step(self, sequence: int, inputs: Vector, *, compact: bool) -> Reply:
        if sequence >= self.ends_at:
            raise LineDown(f"{self.name} closed the connection")
        return Reply(0, np.full(4, float(sequence)), LAW.initial_state(), np.zeros(LAW.outputs.size - 4), b"")


def thrusts(faults: LinkFaults, *, ends_at: int = 1 << 30, count: int = 12) -> list[tuple[float, int]]:
    """(first thrust, status) of each period."""
    mine, other = socket.socketpair()
    with other, Echo(mine, "there", ends_at=ends_at) as opened:
        linked = LinkedLaw(LAW, LAW.gains.pack(), opened, faults)
        made = [linked(LAW.initial_state(), LAW.inputs.pack(), LAW.gains.pack()) for _ in range(count)]
    return [(float(step.tau[0]), step.status) for step in made]


def test_a_late_answer_is_flown_late_and_one_that_is_too_old_is_not() -> None:
    assert thrusts(LinkFaults(), count=3) == [(1.0, 0), (2.0, 0), (3.0, 0)]
    assert thrusts(LinkFaults(delay=0.08), count=5) == [(0.0, LATE), (0.0, LATE), (1.0, 0), (2.0, 0), (3.0, 0)]
    assert thrusts(LinkFaults(delay=0.25), count=7)[4:] == [(0.0, LATE), (1.0, 0), (2.0, 0)]
    assert thrusts(LinkFaults(delay=0.3), count=50) == [(0.0, LATE)] * 50
    assert thrusts(LinkFaults(delay=0.3, deadline=0.3), count=8)[6:] == [(1.0, 0), (2.0, 0)]


def test_losses_hold_the_command_then_end_in_zero_and_repeat_with_their_seed() -> None:
    assert thrusts(LinkFaults(loss=1.0), count=20) == [(0.0, LATE)] * 20
    some = thrusts(LinkFaults(loss=0.4, deadline=0.05, seed=3), count=100)
    assert some == thrusts(LinkFaults(loss=0.4, deadline=0.05, seed=3), count=100)
    assert some != thrusts(LinkFaults(loss=0.4, deadline=0.05, seed=4), count=100)
    ages = [k + 1 - value for k, (value, status) in enumerate(some) if status == 0]
    assert set(ages) == {0.0, 1.0}
    fresh = sum(age == 0.0 for age in ages) / len(some)
    assert abs(fresh - 0.6**2) < 0.1  # both ways through
    assert all(value == 0.0 for value, status in some if status == LATE)


def test_a_line_that_ends_is_zero_thrust_from_then_on() -> None:
    assert thrusts(LinkFaults(), ends_at=4, count=6)[2:] == [(3.0, 0), (0.0, GONE), (0.0, GONE), (0.0, GONE)]


@pytest.mark.parametrize("bad", [{"loss": 1.1}, {"loss": float("nan")}, {"delay": -1.0}, {"deadline": float("inf")}])
def test_faults_are_checked(bad: dict[str, float]) -> None:
    with pytest.raises(InputError, match="link-"):
        LinkFaults(**bad)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Mission:
    """The smallest law, its numbers, and a way to fly it for three seconds."""

    law: Law
    p: Vector
    fly: Callable[..., Run]


@pytest.fixture(scope="module")
def mission() -> Mission:
    scenario = replace(load_scenario("pool-ahead"), time_limit=3.0)
    vehicle, gains, law = load_vehicle(scenario.vehicle), load_gains("default"), build_law("closed_form")

    def fly(stepper: Callable[[Vector, Vector, Vector], ControllerStep], *, seconds: float = 3.0) -> Run:
        flown = replace(scenario, time_limit=seconds)
        return simulate(flown, vehicle, gains=gains, law=law, seed=0, stepper=stepper)

    return Mission(law, law_numbers(scenario, gains, vehicle), fly)


def same_flight(mine: Run, other: Run) -> None:
    assert repr(mine.metrics) == repr(other.metrics)  # a path error may be NaN
    for name in ("time", "eta", "nu", "tau", "clearance", "law_input", "status", "telemetry"):
        assert np.array_equal(getattr(mine.record, name), getattr(other.record, name)), name
    assert np.array_equal(mine.record.law_state[1:], other.record.law_state[1:])


def test_a_flight_through_a_process_is_the_flight_in_python_and_a_killed_one_coasts(
    mission: Mission, tmp_path: Path
) -> None:
    need_compiler()
    with serving(program(mission.law, mission.p, tmp_path, "float32")) as (process, where), connect(where) as opened:
        linked = LinkedLaw(mission.law, mission.p, opened)
        run = mission.fly(linked)
        same_flight(run, mission.fly(Rounded(closed_form(mission.law, real="float32")).step))
        assert run.to_dict()["replaced"]  # the commands were not the law's own
        report = linked.report()
        assert (report.steps, report.answered, report.differing) == (60, 60, 0)
        assert np.abs(run.record.tau).max() > 1.0

        linked = LinkedLaw(mission.law, mission.p, opened)

        def killed(x: Vector, u: Vector, p: Vector) -> ControllerStep:
            if linked.report().steps == 40:
                process.kill()
                process.wait()
            return linked(x, u, p)

        run = mission.fly(killed, seconds=5.0)
        report = linked.report()
        assert run.metrics.stopped_because == LINK_LOST and not run.metrics.reached
        assert report.gone_s == 2.0 and "closed the connection" in report.gone_because
        assert (report.answered, report.failsafe, report.differing) == (40, 60, 0)
        assert not run.record.tau[40:].any() and set(run.record.status[40:]) == {GONE}
        speed = np.hypot(run.record.nu[:, 0], run.record.nu[:, 1])
        assert 0.0 < speed[-1] < 0.9 * speed[40]  # it coasts


def test_a_closed_loop_flown_by_an_emulated_cortex_m4f_is_the_flight_in_python(
    mission: Mission, tmp_path: Path
) -> None:
    """Processor in the loop: the float law on the processor, every byte of thrust, state and telemetry."""
    for tool in ("arm-none-eabi-gcc", "qemu-system-arm"):
        need(tool)
    target = emulated_target("cortex-m4f")
    sooner = replace(target, flags=tuple("-O0" if flag == "-O2" else flag for flag in target.flags))
    assert sooner != target == TARGETS["cortex-m4f"]
    bundle = build_bundle(closed_form(mission.law, real="float32"), mission.law.gains.unpack(mission.p), real="float32")
    with emulated(bundle, sooner, tmp_path / "bundle") as opened:
        linked = LinkedLaw(mission.law, mission.p, opened)
        run = mission.fly(linked)
        report = linked.report()
        assert (report.answered, report.differing, report.failsafe) == (60, 0, 0)
    same_flight(run, mission.fly(Rounded(closed_form(mission.law, real="float32")).step))
    assert opened.emulator is not None and opened.emulator.returncode == 0


@pytest.mark.parametrize("name", ["cortex-m4", "gcc-O2", ""])
def test_what_is_no_emulated_processor(name: str) -> None:
    with pytest.raises(InputError, match=r"is not an emulated processor; known: qemu:cortex-m3"):
        emulated_target(name)


def test_a_compact_step_carries_status_thrust_and_where_the_mission_stands(line: SerialLine) -> None:
    law, identity = exact(), line.request()
    at = law.state.slice("progress")
    for k in range(1, 6):
        u = law.inputs.pack() + 0.1 * k
        line.start(identity.id)
        whole = line.step(1, u)
        line.start(identity.id)
        few = line.step(1, u, compact=True)
        assert (few.status, few.tau.tolist()) == (whole.status, whole.tau.tolist())
        assert few.tau.size == 4 and not few.state.size and not few.telemetry.size
        carried = np.frombuffer(few.raw, "<f4")
        assert np.array_equal(carried, np.hstack([whole.tau, whole.state[at], whole.telemetry]))


def test_a_message_whose_bytes_drip_ends_the_connection_within_seconds(small: dict[Real, Path]) -> None:
    with serving(small["float64"]) as (_, where):
        host, port = where.removeprefix("tcp://").rsplit(":", 1)
        began = time.monotonic()
        with socket.create_connection((host, int(port)), timeout=20) as wire, contextlib.suppress(OSError):
            for byte in HEAD.pack(b"SURL", VERSION, 1, 0, 0)[:-1] * 9:
                wire.sendall(bytes([byte]))
                time.sleep(0.25)
        assert time.monotonic() - began < 20  # it closes after 2 s; not after the 34 s of all bytes
        with connect(where) as opened:  # the next robot is served
            opened.request()


def test_compact_replies_are_compared_in_thrust_and_carry_pythons_state(small: dict[Real, Path]) -> None:
    law, p = exact(), exact().gains.pack()
    for faults in (LinkFaults(), LinkFaults(loss=0.3, seed=2)):
        with serving(small["float32"]) as (_, where), connect(where) as opened:
            linked = LinkedLaw(law, p, opened, faults, compact=True)
            stepped(law, linked, 40)
            few = linked.report()
            opened.start(linked.identity)
            whole = LinkedLaw(law, p, opened, faults)
            stepped(law, whole, 40)
        assert (few.differing, whole.report().differing) == (0, 0) and few.answered == whole.report().answered
        assert np.array_equal(linked._state, whole._state)
        first = linked._log[3][2]
        linked._log[3] = (*linked._log[3][:2], first._replace(raw=first.raw[:-1] + b"!"), *linked._log[3][3:])
        assert linked.report().first == 3


def test_in_a_paused_step_no_time_without_progress_counts(tmp_path: Path) -> None:
    need_compiler()
    x, u, p = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("p", 0)
    layouts = (
        Layout(tuple(Port(name, (1,), "s", "time without progress") for name in ("stalled", "searching"))),
        Layout((Port("depth", (1,), "m", "depth"),)),
        Layout(()),
        Layout((Port("tau", (4,), "N, N, N, N m", "thrust"),)),
    )
    function = ca.Function("law", [x, u, p], [ca.fmax(x[0], x[1]) * ca.SX.ones(4), x + 0.05, ca.SX(0), ca.SX(0, 1)])
    law = StandIn("stall", 0.05, *layouts, function)
    with serving(program(law, np.zeros(0), tmp_path, "float64")) as (_, where), connect(where) as opened:
        opened.start(opened.request().id)
        stalled = [opened.step(k, np.zeros(1)).tau[0] for k in range(1, 41)]  # the thrust is the time before the step
        assert stalled[-1] == pytest.approx(39 * 0.05)
        opened._exchange(PAUSED, 41, np.zeros(1).tobytes(), COMMAND, 4 + 8 * 4)
        assert opened.step(42, np.zeros(1)).tau[0] == 0.05
