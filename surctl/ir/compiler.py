"""Search for the system's C compiler, and compilation without options that change numerical results."""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from surctl.errors import InputError, SurctlError, ToolMissing

__all__ = [
    "FLAGS",
    "compile_program",
    "compiler_version",
    "find_compiler",
    "further_flags",
    "packaged_compiler",
    "quick_flags",
    "tuned_flags",
]

FLAGS = (
    *("-std=c99", "-O2", "-ffp-contract=off"),  # no fused multiply-add: it changes the bytes
    "-fno-tree-vectorize",  # gcc 12's vectoriser on x86 fuses a b - c next to a b + c (vfmaddsub) despite that flag
    *("-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic"),
)
"""Flags of every compilation; the generated Makefile uses the same flags."""

# for gcc; clang always reorders, and warns that it ignores these flags
_REORDERED = ("-fschedule-insns", "-fsched-pressure", "-Wno-ignored-optimization-argument")
_ZIG = "cc -fno-sanitize=undefined"  # without -O2, zig adds checks that need its run-time library
_X86 = ("x86_64", "amd64", "i386", "i686")


def tuned_flags(*, wide: bool = False) -> tuple[str, ...]:
    """Return flags that allow all instructions of this machine's processor but do not change numerical results.

    The flags switch errno off, so that a square root is one instruction. They exclude AVX-512 unless `wide`: vectors of
    eight numbers need AVX-512, but with vectors of four numbers the masks of AVX-512 make the QP solver a tenth slower
    than AVX2. For `wide`, the compiler also schedules instructions before register allocation, which saves an eighth of
    the run time of a closed loop.

    Example:
        >>> from surctl.ir import tuned_flags
        >>> tuned_flags()[0], sorted(set(tuned_flags(wide=True)) - set(tuned_flags()))
        ('-march=native', ['-Wno-ignored-optimization-argument', '-fsched-pressure', '-fschedule-insns'])
    """
    if wide:
        return ("-march=native", *_REORDERED, "-fno-math-errno")
    narrow = ("-mno-avx512f",) if platform.machine().lower() in _X86 else ()
    return ("-march=native", *narrow, "-fno-math-errno")


def quick_flags() -> tuple[str, ...]:
    """Return the flag `-Og`; no flag if $SURCTL_CFLAGS sets an optimisation level.

    A law with sonars compiles in two fifths of the time of -O2, and runs a third longer: 0.04 ms instead of 0.03 ms.
    """
    return () if any(flag.startswith("-O") for flag in further_flags()) else ("-Og",)


def further_flags() -> tuple[str, ...]:
    """Return the compiler flags in $SURCTL_CFLAGS, which follow `FLAGS`; e.g. "-O1" compiles faster with equal results.

    Raises:
        InputError: a quote is not closed, or a flag changes results.
    """
    text = os.environ.get("SURCTL_CFLAGS", "")
    try:
        words = shlex.split(text)
    except ValueError:
        raise InputError("cannot be read", key="SURCTL_CFLAGS", value=text, remedy="close its quotes") from None
    _refuse(words, key="SURCTL_CFLAGS")
    return tuple(words)


_TIMEOUT = 1200.0  # s; gcc needs 25 s for 30,000 operations, and ten times that on a busy machine

_REFUSED = (
    "-ffast-math",
    "-Ofast",
    "-ffinite-math-only",
    "-funsafe-math-optimizations",
    "-fassociative-math",
    "-freciprocal-math",
    "-fno-signed-zeros",
    "-ffp-contract=fast",
    "-ffp-contract=on",
)


def find_compiler() -> str:
    """Return the command of the C compiler: $CC, which may include arguments, or the first available of cc, gcc, clang.

    Without any of them, it is that of the package `ziglang`, if this is installed (`surctl[compiler]`).

    Raises:
        ToolMissing: $CC does not name a program, or there is no compiler.
        InputError: $CC contains a flag that changes results.

    Example:
        >>> import os
        >>> from unittest.mock import patch
        >>> from surctl.ir import find_compiler
        >>> find_compiler()  # usually cc
        '...c...'
        >>> with patch.dict(os.environ, CC="no-such-cc"):
        ...     find_compiler()
        Traceback (most recent call last):
            ...
        surctl.errors.ToolMissing: CC = 'no-such-cc': names no program; unset CC or set it to a C compiler
    """
    command = os.environ.get("CC", "").strip()
    if command:
        words = _words(command)
        if shutil.which(words[0]) is None:
            raise ToolMissing("names no program", key="CC", value=command, remedy="unset CC or set it to a C compiler")
        _refuse(words)
        return command
    for name in ("cc", "gcc", "clang"):
        if shutil.which(name):
            return name
    packaged = packaged_compiler()
    if packaged is None:
        raise ToolMissing(
            "no C compiler found (cc, gcc, clang)",
            remedy="install one (pip install 'surctl[compiler]', or on Debian: apt install gcc) or set CC",
        )
    return packaged


def packaged_compiler() -> str | None:
    """Return the command of the C compiler (clang) in the package `ziglang`; None if it is not installed.

    Example:
        >>> from surctl.ir import packaged_compiler
        >>> "-m ziglang cc" in (packaged_compiler() or "python -m ziglang cc")
        True
    """
    return None if find_spec("ziglang") is None else f"{shlex.quote(sys.executable)} -m ziglang {_ZIG}"


def _words(command: str) -> list[str]:
    try:
        return shlex.split(command)
    except ValueError:
        raise ToolMissing("names no program", key="CC", value=command, remedy="close its quotes") from None


def _refuse(flags: Sequence[str], *, key: str = "flags") -> None:
    for flag in flags:
        if flag in _REFUSED:
            raise InputError(
                "changes the results of floating-point arithmetic",
                key=key,
                value=flag,
                remedy="leave it out",
            )


def compile_program(
    sources: Sequence[Path], output: Path, *, flags: Sequence[str] = (), compiler: str | None = None
) -> Path:
    r"""Compile and link `sources` to the file `output`; with "-c" in `flags`, compile one source to an object file.

    Args:
        sources: C sources or object files.
        output: the file to write.
        flags: additional flags, after `FLAGS` and `further_flags`.
        compiler: command of the C compiler, which may include arguments; if None, that of `find_compiler`.

    Returns:
        `output`.

    Raises:
        ToolMissing: there is no compiler.
        InputError: `flags` or $SURCTL_CFLAGS contains a flag that changes results, such as -ffast-math.
        SurctlError: the compiler reports an error; the message contains the first line of the error.

    Example:
        >>> import subprocess
        >>> from pathlib import Path
        >>> from surctl.ir import compile_program
        >>> source = Path("hello.c")
        >>> _ = source.write_text('int puts(const char *); int main(void) { return puts("diving") < 0; }\n')
        >>> program = compile_program([source], Path("hello").resolve())
        >>> subprocess.run([program], capture_output=True, text=True).stdout.strip()
        'diving'
    """
    _refuse(flags)
    link = [] if "-c" in flags else ["-lm"]
    files = [str(s) for s in sources]
    used = find_compiler() if compiler is None else compiler
    if "-m ziglang" in used:  # refuses what clang ignores
        flags = [flag for flag in flags if flag not in _REORDERED]
    command = [*_words(used), *FLAGS, *further_flags(), *flags, "-o", str(output), *files, *link]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_TIMEOUT)
    except subprocess.TimeoutExpired:
        raise SurctlError(f"{used} was stopped after {_TIMEOUT:.0f} s: {' '.join(files)}") from None
    except OSError as error:
        raise ToolMissing("cannot be run", key="CC", value=command[0], remedy=error.strerror) from None
    if done.returncode != 0:
        raise SurctlError(f"{used} failed: {_first_error(done.stderr)}")
    return output


def _first_error(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return next((line for line in lines if "error" in line), lines[0] if lines else "no message")


def compiler_version(compiler: str | None = None) -> str:
    """Return the first line of the compiler's `--version` output; None means the compiler of `find_compiler`.

    Example:
        >>> from surctl.ir import compiler_version
        >>> compiler_version()  # for example "cc (Debian 12.2.0-14) 12.2.0"
        '...c...'
    """
    command = tuple(_words(find_compiler() if compiler is None else compiler))
    executable = os.path.realpath(shutil.which(command[0]) or command[0])
    try:
        state = Path(executable).stat()
    except OSError:  # the call below reports the error
        return _reported_version(command)
    return _known_version(command, executable, (state.st_ino, state.st_size, state.st_mtime_ns))


@cache
def _known_version(command: tuple[str, ...], _file: str, _state: tuple[int, ...]) -> str:
    # requested once per process for each command and state of the compiler's file
    return _reported_version(command)


def _reported_version(command: Sequence[str]) -> str:
    done = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False, timeout=_TIMEOUT)
    return (done.stdout or done.stderr or command[0]).splitlines()[0].strip()
