"""Processor in the loop: the exported controller runs on an emulated processor and exchanges messages with Python."""

from __future__ import annotations

import socket
import subprocess
from dataclasses import dataclass
from pathlib import Path

from surctl.errors import InputError
from surctl.export.bundle import Bundle, write_bundle
from surctl.export.link import Line
from surctl.export.targets import TARGETS, Target, chosen_targets
from surctl.ir import compile_program

__all__ = ["EmulatedLine", "emulated", "emulated_target"]

_PATIENCE = 60.0  # s; emulation is slow on a busy machine
_PARTING = 5.0  # s in which the emulator may end by itself before it is killed


@dataclass
class EmulatedLine(Line):
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
        raise InputError(
            "is not an emulated processor",
            key="controller",
            value=f"qemu:{name}",
            remedy="known: " + ", ".join(f"qemu:{target.name}" for target in known),
        )
    (target,), _ = chosen_targets([name])
    return target


def emulated(bundle: Bundle, target: Target, folder: Path) -> EmulatedLine:
    """Compile the bundle for an emulated processor, start it in QEMU, and connect to its console.

    Args:
        bundle: the exported controller.
        target: an emulated processor.
        folder: folder for the sources and the program; do not delete the folder while the emulator runs.

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
