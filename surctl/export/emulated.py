"""Link to an exported controller in another process, also in QEMU: messages, compilers and processors (--targets)."""

from __future__ import annotations

import platform
import shutil
import socket
import struct
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, SurctlError, ToolMissing, check_known
from surctl.export.bundle import Bundle, write_bundle
from surctl.files import Closeable
from surctl.ir.cache import compile_program, packaged_compiler

# Compilers and processors on which the exported C is checked: this machine's, and emulated microcontrollers


_BOARD = ("-nographic", "-monitor", "none", "-serial", "none", "-semihosting-config", "enable=on,target=native")


@dataclass(frozen=True)
class Target:
    """A compiler with its flags, and the processor that runs the compiled bundle.

    Attributes:
        name: short name on the command line.
        compiler: command of the compiler, which may include arguments.
        flags: compiler flags of the target, used after those of `compile_program`.
        machine: QEMU's name of the emulated board; None runs the program on this machine.
    """

    name: str
    compiler: str
    flags: tuple[str, ...]
    machine: str | None = None

    @property
    def tools(self) -> tuple[str, ...]:
        """Return the programs that the target needs."""
        compiler = "ziglang" if self.name.startswith("zig-") else self.compiler
        return (compiler,) if self.machine is None else (compiler, "qemu-system-arm")

    @property
    def size_tool(self) -> str:
        """Return the name of the `size` tool for the target's object files."""
        return "size" if self.machine is None else "arm-none-eabi-size"

    @property
    def missing(self) -> tuple[str, ...]:
        """Return the tools of the target that are not installed."""
        packaged = ("ziglang",) if packaged_compiler() else ()
        return tuple(tool for tool in self.tools if tool not in packaged and shutil.which(tool) is None)

    def board(self, program: str) -> tuple[str, ...]:
        """Return the command that runs a program on the emulated board."""
        return ("qemu-system-arm", "-M", self.machine or "", *_BOARD, "-kernel", program)

    def bare(self, folder: Path) -> tuple[str, ...]:
        """Return flags that link a program for the board; `folder` contains the start-up code and the memory map."""
        return (*self.flags, "--specs=rdimon.specs", "-nostartfiles", f"-T{folder / 'target.ld'}")


def _emulated(name: str, board: str, *flags: str, level: str = "-O2") -> Target:
    return Target(name, "arm-none-eabi-gcc", (level, "-mthumb", *flags), board)


_M4F = ("mps2-an386", "-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard")
_NATIVE = ("-O3", "-march=native") if platform.machine().lower() in ("x86_64", "amd64") else ("-O3",)

_BUILT_IN = (
    *(Target(f"{c}-O{n}", c, (f"-O{n}",)) for c in ("gcc", "clang") for n in range(4)),
    *(Target(f"{c}-native", c, _NATIVE) for c in ("gcc", "clang")),
    Target("zig-O2", packaged_compiler() or "ziglang", ("-O2",)),
    _emulated("cortex-m3", "mps2-an385", "-mcpu=cortex-m3", "-mfloat-abi=soft"),
    _emulated("cortex-m4f", *_M4F),
    _emulated("cortex-m4f-Os", *_M4F, level="-Os"),
    _emulated("cortex-m7", "mps2-an500", "-mcpu=cortex-m7", "-mfpu=fpv5-d16", "-mfloat-abi=hard"),
)

TARGETS: dict[str, Target] = {target.name: target for target in _BUILT_IN}
"""Targets by name: gcc and clang with -O0 to -O3 and -march=native, the package `ziglang`, and QEMU's Cortex-M."""


def chosen_targets(names: Sequence[str] = ()) -> tuple[list[Target], dict[str, tuple[str, ...]]]:
    """Return the targets to try (without names: all), and the missing tools of each one that cannot be tried.

    Raises:
        InputError: a name is not known.
        ToolMissing: a tool of a named target is not installed.
    """
    for name in names:
        check_known(name, TARGETS, "is not a known target", key="targets")
    chosen = [TARGETS[name] for name in names or TARGETS]
    lacking = {target.name: target.missing for target in chosen if target.missing}
    if names and lacking:
        name, tools = next(iter(lacking.items()))
        raise ToolMissing(
            f"needs {' and '.join(tools)}",
            key="targets",
            value=name,
            remedy="install it (pip: ziglang; on Debian: gcc, clang, gcc-arm-none-eabi, libnewlib-arm-none-eabi, "
            "qemu-system-arm)",
        )
    return [target for target in chosen if not target.missing], lacking


Vector = NDArray[np.float64]

VERSION = 2
"""Version of the messages; `SerialLine` refuses a controller with another version, with an error that says so."""

_MAGIC = b"SURL"
_HEAD = struct.Struct("<4sHHII")
_REQUEST, _IDENTITY, _START, _STARTED, _STEP, _STEPPED, _REFUSED, _COMPACT, _COMMAND = range(1, 10)
_SIZES = struct.Struct("<64s6I")
_GLANCE = 0.25  # s: longest wait in one system call, so that Ctrl-C takes effect soon
_MOST = 1_000_000  # largest count of inputs, states or other numbers that a controller may report
_REFUSALS = {
    1: "received bytes that are not a message of this link",
    2: f"does not speak version {VERSION} of the link",
    3: "does not know this kind of message",
    4: "expects another number of inputs",
    5: "runs another controller",
    6: "has not been started",
    7: "already received this step or a later one",
}


class LineDown(SurctlError):
    """Error: the connection ended, was silent for too long, or carried an invalid message."""


class Identity(NamedTuple):
    """Identity of a controller and the sizes of its vectors, as the controller reports them.

    Attributes:
        id: hash of what the controller computes, see `law_id`.
        inputs, thrusts, states, telemetry: sizes of the vectors.
        glance: number of values after the thrust in a compact reply, see `contract.glance`.
    """

    id: str
    real: str
    inputs: int
    thrusts: int
    states: int
    telemetry: int
    glance: int = 0


class Reply(NamedTuple):
    """Reply of the controller to one step: status, thrust (n_tau,) [N, N m], next state (nx,), telemetry (k,).

    `raw` are the received bytes of these numbers; in a compact reply, of the thrust and the values of `glance`.
    """

    status: int
    tau: Vector
    state: Vector
    telemetry: Vector
    raw: bytes


@dataclass
class SerialLine(Closeable):
    """Connection to one controller; call `close` at the end, or use the connection in a `with` statement.

    Attributes:
        wire: a connected stream socket.
        name: name of the controller in error messages.
        patience: longest wait for a reply [s].
        identity: identity that the controller reported; None before `request`.
    """

    wire: socket.socket
    name: str
    patience: float = 5.0
    identity: Identity | None = None

    def close(self) -> None:
        """Close the connection."""
        self.wire.close()

    def request(self) -> Identity:
        """Request the controller's identity and the sizes of its vectors.

        Raises:
            LineDown: the other process is not an exported controller, or the connection is down.
        """
        body = self._exchange(_REQUEST, 0, b"", _IDENTITY, _SIZES.size)
        name, width, *counts = _SIZES.unpack(body)
        if width not in (4, 8) or any(count > _MOST for count in counts) or not name.isalnum():
            raise LineDown(f"{self.name} reports an identity or a size that is not possible")
        self.identity = Identity(name.decode("ascii"), "float64" if width == 8 else "float32", *counts)
        return self.identity

    def start(self, identity: str) -> None:
        """Make the controller set its initial state and its tuned gains.

        Raises:
            LineDown: the controller's identity differs from `identity`, or the connection is down.
        """
        self._exchange(_START, 0, identity.encode("ascii"), _STARTED, 0)

    def step(self, sequence: int, inputs: Vector, *, compact: bool = False) -> Reply:
        """Run one step of the controller; call `request` and `start` before the first step.

        Args:
            sequence: number of the step, at least 1 and larger than the number of every earlier step since `start`.
            inputs: inputs u of the law (nu,), which are rounded to the controller's precision.
            compact: True requests few bytes, for a slow line: status, thrust and the values of `glance`, which `raw`
                has; state and telemetry are then empty.

        Raises:
            LineDown: the controller sent no valid reply.
        """
        who = self.identity
        assert who is not None
        kind: np.dtype[Any] = np.dtype(who.real).newbyteorder("<")
        with np.errstate(over="ignore"):
            sent = np.asarray(inputs, dtype=kind).tobytes()
        ends = np.cumsum([who.thrusts, *((0, 0) if compact else (who.states, who.telemetry))])
        more = who.glance if compact else 0
        kinds = (_COMPACT, _COMMAND) if compact else (_STEP, _STEPPED)
        body = self._exchange(kinds[0], sequence, sent, kinds[1], 4 + kind.itemsize * (int(ends[-1]) + more))
        numbers = np.frombuffer(body, dtype=kind, offset=4).astype(np.float64)
        tau, state, telemetry = np.split(numbers[: ends[-1]], ends[:-1])
        return Reply(struct.unpack_from("<i", body)[0], tau, state, telemetry, body[4:])

    def _exchange(self, kind: int, sequence: int, body: bytes, expected: int, length: int) -> bytes:
        deadline = time.monotonic() + self.patience
        try:
            self.wire.settimeout(self.patience)
            self.wire.sendall(_HEAD.pack(_MAGIC, VERSION, kind, sequence, len(body)) + body)
            magic, version, got, echoed, size = _HEAD.unpack(self._received(_HEAD.size, deadline))
            if magic != _MAGIC:
                raise LineDown(f"{self.name} is not a controller of this kind: its reply is not a message of the link")
            if version != VERSION:
                raise LineDown(
                    f"{self.name} speaks version {version} of the link protocol, this program version {VERSION}"
                )
            if got == _REFUSED and size == 4:
                (why,) = struct.unpack("<I", self._received(4, deadline))
                raise LineDown(f"{self.name} {_REFUSALS.get(why, f'refuses, with code {why}')}")
            if (got, echoed, size) != (expected, sequence, length):
                raise LineDown(f"{self.name} sent a reply that does not fit the request")
            return self._received(length, deadline)
        except TimeoutError:
            raise LineDown(f"{self.name} was silent for {self.patience:g} s") from None
        except OSError as error:
            raise LineDown(f"{self.name} closed the connection ({error.strerror})") from None

    def _received(self, count: int, deadline: float) -> bytes:
        parts = []
        while count > 0:
            left = deadline - time.monotonic()
            if left <= 0:
                raise TimeoutError
            self.wire.settimeout(min(left, _GLANCE))
            try:
                part = self.wire.recv(min(count, 1 << 16))
            except TimeoutError:
                continue
            if not part:
                raise LineDown(f"{self.name} closed the connection")
            parts.append(part)
            count -= len(part)
        return b"".join(parts)


def connect(address: str, *, patience: float = 5.0) -> SerialLine:
    """Connect to a controller at tcp://HOST:PORT; HOST is a name, an IPv4 address, or an IPv6 address in brackets.

    Raises:
        InputError: the address is not valid, or no controller listens there.

    Example:
        >>> from pathlib import Path
        >>> from subprocess import PIPE, Popen
        >>> from surctl.marine.control import build_law
        >>> from surctl.marine.export import build_bundle
        >>> from surctl.export import connect, write_bundle
        >>> from surctl.ir.cache import compile_program
        >>> law, folder = build_law("closed_form"), Path("closed_form")
        >>> bundle = build_bundle(law, {})
        >>> _ = write_bundle(bundle, folder)
        >>> code = [folder / name for name in ("controller.c", "link.c", *bundle.sources)]
        >>> controller = Popen([compile_program(code, folder / "controller"), "0"], stdout=PIPE, text=True)  # any port
        >>> with connect(controller.stdout.readline().split()[-1]) as line:
        ...     line.request().real, line.identity.inputs == law.inputs.size
        ('float64', True)
        >>> _ = controller.kill(), controller.communicate()
    """
    host, port = _host_and_port(address)
    try:
        wire = socket.create_connection((host, port), timeout=patience)
    except (OSError, UnicodeError) as error:
        why = "no reply" if isinstance(error, TimeoutError) else getattr(error, "strerror", None) or str(error)
        problem = f"no controller listens there ({why})"
        remedy = "start the exported controller: make controller && ./controller PORT"
        raise InputError(problem, key="controller", value=address, remedy=remedy) from None
    wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return SerialLine(wire, address, patience)


def _host_and_port(address: str) -> tuple[str, int]:
    try:
        parts = urlsplit(address)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(""), None
    rest = parts.path or parts.query or parts.fragment or parts.username or parts.password
    if parts.scheme != "tcp" or not parts.hostname or not port or rest:
        remedy = "use tcp://HOST:PORT, e.g. tcp://127.0.0.1:5555 or tcp://[::1]:5555"
        raise InputError("is not the address of a controller", key="controller", value=address, remedy=remedy)
    return parts.hostname, port


_PATIENCE = 60.0  # s; emulation is slow on a busy machine
_PARTING = 5.0  # s in which the emulator may end by itself before it is killed


@dataclass
class EmulatedLine(SerialLine):
    """Connection to a controller in QEMU; closing the connection ends the emulator."""

    emulator: subprocess.Popen[bytes] | None = None

    def close(self) -> None:
        """Close the connection, and wait until the emulated program ends."""
        super().close()
        if self.emulator is None:
            return
        try:
            self.emulator.wait(_PARTING)
        except subprocess.TimeoutExpired:
            self.emulator.kill()
            self.emulator.wait()


def emulated_target(name: str) -> Target:
    """Return the emulated processor with the given name, for example cortex-m4f.

    Raises:
        InputError: no emulated processor has the given name.
        ToolMissing: QEMU or the cross compiler is not installed.

    Example:
        >>> from surctl.export import emulated_target
        >>> target = emulated_target("cortex-m4f")
        >>> target.machine, target.compiler
        ('mps2-an386', 'arm-none-eabi-gcc')
    """
    known = [target for target in TARGETS.values() if target.machine is not None]
    if name not in [target.name for target in known]:
        remedy = "known: " + ", ".join(f"qemu:{target.name}" for target in known)
        raise InputError("is not an emulated processor", key="controller", value=f"qemu:{name}", remedy=remedy)
    (target,), _ = chosen_targets([name])
    return target


def emulated(bundle: Bundle, target: Target, folder: Path) -> EmulatedLine:
    """Compile the bundle for an emulated processor, start it in QEMU, and connect to its console.

    Sources and program are in `folder`, which must stay while the emulator runs.

    Raises:
        SurctlError: the compiler reports an error.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.control import build_law
        >>> from surctl.marine.export import build_bundle
        >>> from surctl.export import emulated, emulated_target
        >>> law = build_law("closed_form")
        >>> bundle = build_bundle(law, {}, real="float32")
        >>> with emulated(bundle, emulated_target("cortex-m4f"), Path("board")) as line:
        ...     line.request().id == bundle.id, line.identity.real, line.identity.inputs
        (True, 'float32', 14)
    """
    write_bundle(bundle, folder)
    names = ("target_start.c", "target_link.c", "link.c", *bundle.sources)
    program = compile_program(
        [folder / name for name in names], folder / "linked", flags=target.bare(folder), compiler=target.compiler
    )
    mine, theirs = socket.socketpair()
    with theirs:
        # a session of its own: Ctrl-C stops only the simulation, which then closes the connection
        emulator = subprocess.Popen(
            target.board(str(program)),
            stdin=theirs.fileno(),
            stdout=theirs.fileno(),
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    return EmulatedLine(mine, f"qemu:{target.name}", _PATIENCE, emulator=emulator)
