"""Compilers and processors on which the exported C is checked: this machine's, and emulated microcontrollers."""

from __future__ import annotations

import platform
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from surctl.errors import InputError, ToolMissing, nearest
from surctl.ir import packaged_compiler

__all__ = ["TARGETS", "Target", "chosen_targets"]

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


def _here() -> list[Target]:
    native = ("-O3", "-march=native") if platform.machine().lower() in ("x86_64", "amd64") else ("-O3",)
    targets = [Target(f"{c}-O{n}", c, (f"-O{n}",)) for c in ("gcc", "clang") for n in range(4)]
    targets += [Target(f"{c}-native", c, native) for c in ("gcc", "clang")]
    return [*targets, Target("zig-O2", packaged_compiler() or "ziglang", ("-O2",))]


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
"""Targets by name: gcc and clang with -O0 to -O3 and -march=native, the package `ziglang`, and QEMU's Cortex-M."""


def chosen_targets(names: Sequence[str] = ()) -> tuple[list[Target], dict[str, tuple[str, ...]]]:
    """Return the targets to try, and the missing tools of each target that cannot be tried on this machine.

    Args:
        names: names of targets; if empty, all targets whose tools are installed.

    Raises:
        InputError: a name is not known.
        ToolMissing: a tool of a named target is not installed.

    Example:
        >>> from surctl.export import chosen_targets
        >>> targets, lacking = chosen_targets(["gcc-O0", "gcc-O2"])
        >>> [target.flags for target in targets], lacking
        ([('-O0',), ('-O2',)], {})
    """
    for name in names:
        if name not in TARGETS:
            raise InputError("is not a known target", key="targets", value=name, remedy=nearest(name, TARGETS))
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
