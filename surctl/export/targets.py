"""Compilers and processors that the exported C is tried on: this machine's, and emulated microcontrollers."""

from __future__ import annotations

import platform
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from surctl.errors import InputError, ToolMissing, nearest

__all__ = ["TARGETS", "Target", "chosen_targets"]

_BOARD = ("-nographic", "-monitor", "none", "-serial", "none", "-semihosting-config", "enable=on,target=native")


@dataclass(frozen=True)
class Target:
    """A way to build the bundle, and to run it.

    Attributes:
        name: short name, as the command line takes it.
        compiler: command of the compiler.
        flags: after the usual ones.
        machine: QEMU's name of the board; None runs it here.
    """

    name: str
    compiler: str
    flags: tuple[str, ...]
    machine: str | None = None

    @property
    def tools(self) -> tuple[str, ...]:
        """Programs that it takes."""
        return (self.compiler,) if self.machine is None else (self.compiler, "qemu-system-arm")

    @property
    def size_tool(self) -> str:
        """The `size` of its objects."""
        return "size" if self.machine is None else "arm-none-eabi-size"

    @property
    def missing(self) -> tuple[str, ...]:
        """Those of its tools that this machine has not."""
        return tuple(tool for tool in self.tools if shutil.which(tool) is None)

    def board(self, program: str) -> tuple[str, ...]:
        """What runs the program on the emulated board."""
        return ("qemu-system-arm", "-M", self.machine or "", *_BOARD, "-kernel", program)

    def bare(self, folder: Path) -> tuple[str, ...]:
        """Flags that link a program for the board, with the bundle's start and memory map in `folder`."""
        return (*self.flags, "--specs=rdimon.specs", "-nostartfiles", f"-T{folder / 'target.ld'}")


def _here() -> list[Target]:
    native = ("-O3", "-march=native") if platform.machine().lower() in ("x86_64", "amd64") else ("-O3",)
    targets = [Target(f"{c}-O{n}", c, (f"-O{n}",)) for c in ("gcc", "clang") for n in range(4)]
    return [*targets, *(Target(f"{c}-native", c, native) for c in ("gcc", "clang"))]


def _emulated(name: str, board: str, *flags: str, level: str = "-O2") -> Target:
    return Target(name, "arm-none-eabi-gcc", (level, "-mthumb", *flags), board)


_M4F = ("mps2-an386", "-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard")


_BUILT_IN = (
    *_here(),
    _emulated("cortex-m3", "mps2-an385", "-mcpu=cortex-m3", "-mfloat-abi=soft"),
    _emulated("cortex-m4f", *_M4F),
    _emulated("cortex-m4f-Os", *_M4F, level="-Os"),
    _emulated("cortex-m7", "mps2-an500", "-mcpu=cortex-m7", "-mfpu=fpv5-d16", "-mfloat-abi=hard"),
)

TARGETS: dict[str, Target] = {target.name: target for target in _BUILT_IN}
"""By name: gcc and clang at -O0 to -O3 and for this very processor, and QEMU's Cortex-M3, -M4F and -M7."""


def chosen_targets(names: Sequence[str] = ()) -> tuple[list[Target], dict[str, tuple[str, ...]]]:
    """Targets to try, and those that cannot be tried here with the tools that are missing.

    Args:
        names: which; none means all that this machine has the tools for.

    Raises:
        InputError: an unknown name.
        ToolMissing: a target that was asked for has not its tools here.

    Example:
        >>> from surctl.export import chosen_targets
        >>> targets, lacking = chosen_targets(["gcc-O0", "gcc-O2"])
        >>> [target.flags for target in targets], lacking
        ([('-O0',), ('-O2',)], {})
    """
    for name in names:
        if name not in TARGETS:
            raise InputError("is no target", key="targets", value=name, remedy=nearest(name, TARGETS))
    chosen = [TARGETS[name] for name in names or TARGETS]
    lacking = {target.name: target.missing for target in chosen if target.missing}
    if names and lacking:
        name, tools = next(iter(lacking.items()))
        raise ToolMissing(
            f"needs {' and '.join(tools)}",
            key="targets",
            value=name,
            remedy="install it (Debian: gcc, clang, gcc-arm-none-eabi, libnewlib-arm-none-eabi, qemu-system-arm)",
        )
    return [target for target in chosen if not target.missing], lacking
