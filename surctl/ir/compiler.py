"""The system's C compiler: find it, and compile strictly, without any option that changes results."""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from surctl.errors import InputError, SurctlError, ToolMissing

__all__ = ["FLAGS", "compile_program", "compiler_version", "find_compiler", "further_flags", "tuned_flags"]

FLAGS = (
    *("-std=c99", "-O2", "-ffp-contract=off"),  # no fused multiply-add: it changes the bytes
    "-fno-tree-vectorize",  # gcc 12's vectoriser on x86 fuses a b - c beside a b + c (vfmaddsub) in spite of that
    *("-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic"),
)
"""Flags of every compilation; the generated Makefile uses the same."""

# gcc's; clang always does, and says of the flags that it ignores them
_REORDERED = ("-fschedule-insns", "-fsched-pressure", "-Wno-ignored-optimization-argument")
_X86 = ("x86_64", "amd64", "i386", "i686")


def tuned_flags(*, wide: bool = False) -> tuple[str, ...]:
    """Flags for code that stays on this machine: all its instructions, but no other results.

    errno is not asked for, so that a root is one instruction. AVX-512 is left out unless `wide`: its masks are slower
    than AVX2's for vectors of four, by a tenth of a solve; for vectors of eight there is nothing else. Wide code is
    ordered anew before registers are given out, which saves an eighth of a closed loop's time.

    Example:
        >>> from surctl.ir import tuned_flags
        >>> tuned_flags()[0], sorted(set(tuned_flags(wide=True)) - set(tuned_flags()))
        ('-march=native', ['-Wno-ignored-optimization-argument', '-fsched-pressure', '-fschedule-insns'])
    """
    if wide:
        return ("-march=native", *_REORDERED, "-fno-math-errno")
    narrow = ("-mno-avx512f",) if platform.machine().lower() in _X86 else ()
    return ("-march=native", *narrow, "-fno-math-errno")


def further_flags() -> tuple[str, ...]:
    """$SURCTL_CFLAGS, after `FLAGS`: "-O1" compiles sooner than "-O2", to code that gives the same bytes.

    Raises:
        InputError: quotes that do not close, or a flag that changes results.
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
    """The command of the C compiler: $CC (may hold arguments), else the first of cc, gcc, clang.

    Raises:
        ToolMissing: $CC names no program, or there is no compiler.
        InputError: $CC holds a flag that changes results.

    Example:
        >>> import os
        >>> from unittest.mock import patch
        >>> from surctl.ir import find_compiler
        >>> find_compiler()  # as a rule: cc
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
    raise ToolMissing("no C compiler found (cc, gcc, clang)", remedy="install one (Debian: apt install gcc) or set CC")


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
    r"""Compile and link `sources` to `output` (with "-c" in `flags`: compile one source to an object).

    Args:
        sources: C sources or objects.
        output: the file to make.
        flags: more flags, after `FLAGS` and `further_flags`.
        compiler: another compiler's command, instead of `find_compiler`'s.

    Returns:
        `output`.

    Raises:
        ToolMissing: there is no compiler.
        InputError: a flag that changes results, such as -ffast-math, here or in $SURCTL_CFLAGS.
        SurctlError: the compiler refuses; carries its first error line.

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
    used = _words(find_compiler()) if compiler is None else [compiler]
    command = [*used, *FLAGS, *further_flags(), *flags, "-o", str(output), *files, *link]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_TIMEOUT)
    except subprocess.TimeoutExpired:
        raise SurctlError(f"{command[0]} was stopped after {_TIMEOUT:.0f} s: {' '.join(files)}") from None
    except OSError as error:
        raise ToolMissing("cannot be run", key="CC", value=command[0], remedy=error.strerror) from None
    if done.returncode != 0:
        raise SurctlError(f"{command[0]} failed: {_first_error(done.stderr)}")
    return output


def _first_error(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return next((line for line in lines if "error" in line), lines[0] if lines else "no message")


def compiler_version(compiler: str | None = None) -> str:
    """First line of the compiler's --version; of `find_compiler`'s if no command is given.

    Example:
        >>> from surctl.ir import compiler_version
        >>> compiler_version()  # "cc (Debian 12.2.0-14) 12.2.0", for one
        '...c...'
    """
    command = tuple(_words(find_compiler()) if compiler is None else [compiler])
    executable = os.path.realpath(shutil.which(command[0]) or command[0])
    try:
        state = Path(executable).stat()
    except OSError:  # the asking says it
        return _reported_version(command)
    return _known_version(command, executable, (state.st_ino, state.st_size, state.st_mtime_ns))


@cache
def _known_version(command: tuple[str, ...], _file: str, _state: tuple[int, ...]) -> str:
    """Asked once a process of one command and the file that it is."""
    return _reported_version(command)


def _reported_version(command: Sequence[str]) -> str:
    done = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False, timeout=_TIMEOUT)
    return (done.stdout or done.stderr or command[0]).splitlines()[0].strip()
