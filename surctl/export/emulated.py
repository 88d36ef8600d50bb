"""The exported controller on an emulated processor, at the other end of a line: processor in the loop."""

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

_PATIENCE = 60.0  # s; a busy machine emulates slowly
_PARTING = 5.0  # s in which the emulator may end by itself


@dataclass
class EmulatedLine(Line):
    """A line to a controller in QEMU, which ends with it."""

    emulator: subprocess.Popen[bytes] | None = None

    def close(self) -> None:
        """Hang up: the program sees the end of its line, and ends."""
        super().close()
        if self.emulator is None:
            return
        try:
            self.emulator.wait(_PARTING)
        except subprocess.TimeoutExpired:
            self.emulator.kill()
            self.emulator.wait()


def emulated_target(name: str) -> Target:
    """The emulated processor of that name, e.g. cortex-m4f.

    Raises:
        InputError: it is none.
        ToolMissing: QEMU or the cross compiler is not here.

    Example:
        >>> from surctl.export import emulated_target
        >>> target = emulated_target("cortex-m4f")
        >>> target.machine, target.compiler
        ('mps2-an386', 'arm-none-eabi-gcc')
    """
    known = [target for target in TARGETS.values() if target.machine is not None]
    if name not in [target.name for target in known]:
        raise InputError(
            "is no emulated processor",
            key="controller",
            value=f"qemu:{name}",
            remedy="known: " + ", ".join(f"qemu:{target.name}" for target in known),
        )
    (target,), _ = chosen_targets([name])
    return target


def emulated(bundle: Bundle, target: Target, folder: Path) -> EmulatedLine:
    """Compile the bundle for the processor, and start it in QEMU with its console as the line.

    Args:
        bundle: the controller.
        target: an emulated processor.
        folder: where to compile; the program has to stay there.

    Raises:
        SurctlError: the compiler refuses.

    Example:
        >>> from pathlib import Path
        >>> from surctl.control import build_law
        >>> from surctl.export import build_bundle, emulated, emulated_target
        >>> law = build_law("closed_form")
        >>> bundle = build_bundle(law, {}, real="float32")
        >>> with emulated(bundle, emulated_target("cortex-m4f"), Path("board")) as line:
        ...     line.ask().id == bundle.id, line.identity.real, line.identity.inputs
        (True, 'float32', 14)
    """
    write_bundle(bundle, folder)
    names = ("target_start.c", "target_link.c", "link.c", *bundle.sources)
    program = compile_program(
        [folder / name for name in names], folder / "linked", flags=target.bare(folder), compiler=target.compiler
    )
    mine, theirs = socket.socketpair()
    with theirs:
        # a session of its own: ctrl-C is for whoever flies, who then hangs up
        emulator = subprocess.Popen(
            target.board(str(program)),
            stdin=theirs.fileno(),
            stdout=theirs.fileno(),
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    return EmulatedLine(mine, f"qemu:{target.name}", _PATIENCE, emulator=emulator)
