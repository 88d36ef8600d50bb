"""What a law needs for export: ports, step, status codes (RANGE, STALE, ITER); names refused for a bundle or a port."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from surctl.errors import InputError
from surctl.ir import Layout, Port
from surctl.ir.c99 import identifier
from surctl.system import Controller, SampledController
from surctl.system.controller import command_ports

STATUS: tuple[tuple[str, int, str], ...] = (
    ("OK", 0, "thrust is valid"),
    ("SATURATED", 1, "bit: a thrust limit was reached"),
    ("SWITCHED", 2, "bit: the passing side changed in this step"),
    ("DEGRADED", 4, "bit: no course satisfies every limit; the least violation was chosen"),
    ("TRAPPED", 8, "bit: dead end; the robot stays and only evades moving obstacles, until a reset"),
    ("RESTARTED", 16384, "bit: the numbers of the samples started again; every age is at its largest value"),
    ("NULL", -1, "a pointer was NULL; thrust is zero, state is unchanged"),
    ("NONFINITE", -2, "a number was not finite; thrust is zero, state is unchanged"),
    ("RANGE", -3, "a number is out of its range, or changed more than it can; thrust is zero, state is unchanged"),
    ("STALE", -4, "the sample is not newer than the last accepted one; thrust is zero, state is unchanged"),
    ("ITER", -5, "the law reports an unfinished iteration; thrust is zero, state is unchanged"),
)
"""(name, code, meaning) of each status of a step: positive codes are bits, a negative code is a refused step."""

SATURATED = next(code for name, code, _ in STATUS if name == "SATURATED")

FILES = (
    "sil_main",
    "main_example",
    "loop",
    "control_task",
    "board",
    "board_example",
    "setup",
    "link",
    "mission",
    "controller",
    "target_start",
    "target_link",
    "fmu",
    "fmi2",
    "fmi3",
    "proof",
)
"""Names of the bundle's C files, without ending, that are not part of the controller."""

MISSION_FILES = ("mission.h", "mission.c")
"""Files of a bundle that feed the law with a mission of any length; a robot without such missions leaves them out."""

DATA = "mission_data.h"
"""File of a bundle with the waypoints of one mission."""
_HEADERS_OF_C = (
    "assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic "
    "stdbool stdckdint stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype"
)
_HEADERS_OF_POSIX = (
    "aio alloca dirent dlfcn endian fcntl features fmtmsg fnmatch ftw glob grp iconv langinfo libgen malloc memory "
    "monetary mqueue ndbm netdb nl_types poll pthread pwd regex sched search semaphore spawn strings stropts syslog "
    "tar termios trace ulimit unistd utime utmpx values wordexp"
)
_HEADERS_OF_FMI = "fmi2functions fmi2functiontypes fmi2typesplatform"
_HEADERS = frozenset(f"{_HEADERS_OF_C} {_HEADERS_OF_POSIX} {_HEADERS_OF_FMI}".split())


Exportable: TypeAlias = SampledController
"""A controller that can be exported: a law of the robot, whose only command is the thrust tau, or any other."""


@dataclass(frozen=True, eq=False)
class WrappedLaw:
    """Base class of a law that wraps another law and has its name, period, states, inputs and outputs."""

    law: Exportable

    @property
    def name(self) -> str:
        """Return the name of the law, a C identifier."""
        return self.law.name

    @property
    def dt(self) -> float:
        """Return the control period [s]."""
        return self.law.dt

    @property
    def state(self) -> Layout:
        """Return the layout (names and sizes of the entries) of the controller state x (nx,)."""
        return self.law.state

    @property
    def inputs(self) -> Layout:
        """Return the layout (names and sizes of the entries) of the inputs u (nu,)."""
        return self.law.inputs

    @property
    def outputs(self) -> Layout:
        """Return the layout (names and sizes of the entries) of the outputs: first commands, then telemetry."""
        return self.law.outputs


def commands(law: Exportable) -> tuple[Port, ...]:
    """Return the name and size of each command; the commands are the first outputs."""
    return command_ports(law).ports


def command_size(law: Exportable) -> int:
    """Return how many numbers all commands have together."""
    return command_ports(law).size


def telemetry_ports(law: Exportable) -> tuple[Port, ...]:
    """Return the name and size of each telemetry output; the telemetry follows the commands."""
    return law.outputs.ports[len(commands(law)) :]


def glance(law: Exportable) -> tuple[tuple[Port, ...], tuple[Port, ...]]:
    """Return the states and telemetry that a compact reply of the link carries: what says where the mission stands."""
    states = tuple(law.state.port(name) for name in ("progress", "own_age") if name in law.state)
    return states, tuple(port for port in telemetry_ports(law) if port.name == "healthy")


def is_robot_law(law: Exportable) -> bool:
    """Return True for a control law of the robot, False for a `surctl.system.Controller` of another plant."""
    while isinstance(law, WrappedLaw):
        law = law.law
    return not isinstance(law, Controller)


def command_word(law: Exportable) -> str:
    """Return the word for the commands in texts: "thrust" for a law of the robot, "command" for another controller."""
    return "thrust" if is_robot_law(law) else "command"


def status_table(law: Exportable) -> tuple[tuple[str, int, str], ...]:
    """Return (name, code, meaning) of each status of a law of the robot, or of those that other controllers share.

    A controller of another plant defines its further status bits itself.
    """
    if is_robot_law(law):
        return STATUS
    return tuple(
        (name, code, text.replace("thrust", "command")) for name, code, text in STATUS if code <= 0 or code == 16384
    )


def checked_name(law: Exportable, name: str | None = None) -> str:
    """Check every name that the C text uses, and return the bundle's name."""
    chosen = identifier(law.name if name is None else name)
    _check_files(chosen)
    for layout in (law.state, law.inputs, law.gains, law.outputs):
        for port in layout:
            identifier(port.name)
            if port.name.startswith(f"{chosen.upper()}_"):
                raise InputError(
                    "may be a macro of the exported header", key="name", value=port.name, remedy="rename it"
                )
    if "sample" in law.inputs:
        raise InputError("is the name of the sample number", key=f"{chosen}.inputs.sample", remedy="rename this input")
    if not command_size(law):
        raise InputError("commands nothing", key=f"{chosen}.outputs", remedy="begin with the commands")
    if not (np.isfinite(law.dt) and law.dt > 0.0):
        raise InputError("is not a positive time", key=f"{chosen}.dt", value=law.dt, remedy="give seconds")
    _check_sizes(law, chosen)
    return chosen


def _check_files(name: str) -> None:
    # on some file system, two files or macros of the bundle would have the same name
    small = name.lower()
    if small in FILES:
        raise InputError(
            "is already the name of a file of the bundle", key="name", value=name, remedy="choose another name"
        )
    if small in _HEADERS:
        problem = f"is the name of a system header, which {small}.h would hide"
        raise InputError(problem, key="name", value=name, remedy="choose another name")
    if small in sys.stdlib_module_names or small in ("numpy", "setuptools"):
        problem = f"is the name of a Python module, which {small}.py of the bundle would hide"
        raise InputError(problem, key="name", value=name, remedy=f"choose another name, such as my_{small}")
    for ending in ("_link", "_loop"):
        if small.endswith(ending):
            problem = f"gives its header the include guard of another bundle's {ending[1:]}.h"
            raise InputError(problem, key="name", value=name, remedy=f"choose a name that does not end in {ending}")
    if name != small:
        problem = f"has capital letters: its macros, and on some file systems its files, get the names of {small}"
        raise InputError(problem, key="name", value=name, remedy=f"write {small}")


def _check_sizes(law: Exportable, name: str) -> None:
    n_tau = command_size(law)
    have = [size for _, size in (*law.block.inputs, *law.block.outputs)]
    want = [law.state.size, law.inputs.size, law.gains.size]
    want += [n_tau, law.state.size, 1, law.outputs.size - n_tau]
    if have != want:
        problem = f"has vectors of {have} entries, but its layouts have {want}"
        remedy = "the order is x, u, p, then tau, x_next, status, telemetry"
        raise InputError(problem, key=f"{name}.block", remedy=remedy)


def starts(layout: Layout) -> list[tuple[Port, int]]:
    """Return the ports that are not empty, with the index of their first entry in the flat vector."""
    return [(port, layout.slice(port.name).start) for port in layout if port.size]


def field(port: Port) -> str:
    """Return the C declarator of a port: a scalar for one entry, else an array of the port's shape, row by row."""
    return port.name if port.size == 1 else port.name + "".join(f"[{n}]" for n in port.shape)


def entries(ports: Layout | Sequence[Port], base: int = 0) -> list[tuple[str, int]]:
    """Return (C member access, flat index) of every number in layout order; the index starts at `base`."""
    members: list[str] = []
    for port in ports:
        if port.size == 1:
            members.append(port.name)
            continue
        indices = itertools.product(*(range(n) for n in port.shape))
        members += [port.name + "".join(f"[{i}]" for i in index) for index in indices]
    return [(member, base + at) for at, member in enumerate(members)]


def transfers(ports: Layout | Sequence[Port], base: int = 0) -> list[tuple[str, str, str]]:
    """Return C loops over every number of the ports in layout order, one loop for each port.

    Returns:
        (loop header, C member access, C text of the flat index) of each port. The loop header is empty for a single
        number, and otherwise leaves one brace open. The index starts at `base`.
    """
    items, at = [], base
    for port in ports:
        if port.size == 1:
            items.append(("", port.name, str(at)))
        elif port.size:
            items.append(_loops(port, at))
        at += port.size
    return items


def _loops(port: Port, at: int) -> tuple[str, str, str]:
    names = [f"k{d}" if len(port.shape) > 1 else "k" for d in range(len(port.shape))]
    loops = " ".join(f"for (int {k} = 0; {k} < {n}; ++{k})" for k, n in zip(names, port.shape, strict=True))
    strides = [math.prod(port.shape[d + 1 :]) for d in range(len(port.shape))]
    terms = [k if stride == 1 else f"{stride} * {k}" for k, stride in zip(names, strides, strict=True)]
    member = port.name + "".join(f"[{k}]" for k in names)
    return f"{loops} {{ ", member, " + ".join([str(at)] * bool(at) + terms)
