"""The C compiler: search, flags, flags that are refused; a cache on disk, where one process builds and others wait.

A cache entry is trusted only if it lies in a folder of this user to which nobody else may write, and if its digest
equals the digest stored when the entry was built. Otherwise the entry is built again.
"""

from __future__ import annotations

import hashlib
import importlib.resources
import importlib.util
import json
import os
import platform
import shlex
import shutil
import stat
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import version
from importlib.resources.abc import Traversable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from surctl.errors import InputError, SurctlError, ToolMissing

# Search for the system's C compiler, and compilation without options that change numerical results


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
    """
    if wide:
        return ("-march=native", *_REORDERED, "-fno-math-errno")
    narrow = ("-mno-avx512f",) if platform.machine().lower() in _X86 else ()
    return ("-march=native", *narrow, "-fno-math-errno")


def quick_flags() -> tuple[str, ...]:
    """Return the flag `-Og`; no flag if $SURCTL_CFLAGS sets an optimisation level.

    A law with sonars compiles in two fifths of the time of -O2, and a step takes 0.04 ms instead of 0.01 ms.
    """
    return () if any(flag.startswith("-O") for flag in further_flags()) else ("-Og",)


def further_flags() -> tuple[str, ...]:
    """Return the flags in $SURCTL_CFLAGS, which follow `FLAGS`; e.g. "-O1" compiles faster with equal results."""
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
        pip = f"{shlex.quote(sys.executable)} -m pip install ziglang"
        remedy = f"install one ({pip}, or on Debian: apt install gcc) or set CC"
        raise ToolMissing("no C compiler found (cc, gcc, clang)", remedy=remedy)
    return packaged


def packaged_compiler() -> str | None:
    """Return the command of the C compiler (clang) in the package `ziglang`; None if it is not installed."""
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
                "changes the results of floating-point arithmetic", key=key, value=flag, remedy="leave it out"
            )


def compile_program(
    sources: Sequence[Path], output: Path, *, flags: Sequence[str] = (), compiler: str | None = None
) -> Path:
    r"""Compile and link `sources` to the file `output`; with "-c" in `flags`, compile one source to an object file.

    `flags` follow `FLAGS` and `further_flags`; `compiler` is a command like that of `find_compiler`, the default.

    Raises:
        ToolMissing: there is no compiler.
        InputError: `flags` or $SURCTL_CFLAGS contains a flag that changes results, such as -ffast-math.
        SurctlError: the compiler reports an error; the message contains the first line of the error.
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
    if done.returncode != 0 and not done.stderr.strip():
        remedy = "set CC to a C compiler, or unset it"
        raise ToolMissing("fails without a message", key="CC", value=command[0], remedy=remedy)
    if done.returncode != 0:
        raise SurctlError(f"{used} failed: {_first_error(done.stderr)}")
    return output


def _first_error(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return next((line for line in lines if "error" in line), lines[0])


def compiler_version(compiler: str | None = None) -> str:
    """Return the first line of the compiler's `--version` output; None means the compiler of `find_compiler`."""
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


_SUFFIXES = (".py", ".toml", ".c", ".h")
_STARTED = time.time_ns()


@cache
def source_digest(*packages: str) -> str:
    """Return the SHA-256 of the source code of these packages and of the software versions with which they run.

    The digest covers names and contents of all .py, .toml, .c and .h files of the packages, also in inner packages; the
    versions of CasADi, NumPy and Python; and the platform, because its libm functions such as sin compute constants.
    The digest is computed once per process.

    Raises:
        SurctlError: a package is missing, a source file cannot be read, or a file was changed after this process began,
            so that the loaded code may be older than the file.
    """
    total = hashlib.sha256()
    for part in (ca.CasadiMeta.version(), np.__version__, platform.python_version(), platform.platform()):
        total.update(f"{part}\0".encode())
    for package in sorted(packages):
        try:
            sources = sorted(_sources(package))
        except (ImportError, OSError, ValueError) as error:
            raise SurctlError(f"the sources of {package} cannot be read: {error}") from None
        if not any(name.endswith(".py") for name, _ in sources):
            raise SurctlError(f"{package} has no source files")
        for name, body in sources:
            total.update(f"{package}\0{name}\0{len(body)}\0".encode() + body)
    return total.hexdigest()


def _sources(package: str) -> Iterator[tuple[str, bytes]]:
    """Yield (name, content) of each source file of a package, or of the file of a module that is not a package."""
    spec = importlib.util.find_spec(package)
    if spec is None:
        raise ImportError("there is no such package")
    if spec.submodule_search_locations is not None:
        yield from _inside(importlib.resources.files(package), "")
    elif spec.origin and spec.origin.endswith(".py"):
        path = Path(spec.origin)
        if path.exists():  # otherwise it is in a zip file, as below
            _refuse_changed(path)
        yield ".py", spec.loader.get_data(spec.origin)  # type: ignore[union-attr]


def _inside(folder: Traversable, above: str) -> Iterator[tuple[str, bytes]]:
    for item in folder.iterdir():
        name = f"{above}{item.name}"
        if item.name.endswith(_SUFFIXES):
            if isinstance(item, Path):  # files in a zip file do not change
                _refuse_changed(item)
            yield name, item.read_bytes()
        elif item.is_dir() and item.name != "__pycache__":
            yield from _inside(item, f"{name}/")


def _refuse_changed(path: Path) -> None:
    state = path.stat()
    if max(state.st_mtime_ns, state.st_ctime_ns) > _STARTED:
        raise SurctlError(f"{path} was changed after this process began")


_SHARED = ("-shared", "-fPIC")
_LOCKS = "locks"
_PATIENCE, _PAUSE = 120.0, 0.02  # [s] longest wait for another process, and time between two attempts
_NOTE = hashlib.sha256().digest_size  # size of the digest, stored before the entry in the same file


class CacheUnused(UserWarning):
    """Warning that the cache on disk cannot be used, so each process builds its libraries and laws itself."""


def cache_folder() -> Path:
    """Return the cache folder: $SURCTL_CACHE, or $XDG_CACHE_HOME/surctl, or ~/.cache/surctl (XDG specification)."""
    own = os.environ.get("SURCTL_CACHE")
    if own:
        return Path(own)
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if Path(base).is_absolute() else Path.home() / ".cache") / "surctl"


def cached_bytes(key: str, suffix: str, build: Callable[[], bytes], *, folder: Path | None = None) -> bytes:
    """Return the bytes of the cache entry `key`; if there is no such entry, store and return the bytes of `build`.

    If several processes need one entry at the same time, one of them builds it and the others wait. Without locks (in a
    new folder, or on Windows) each uses the bytes that it built itself, and the bytes of the last one are stored.

    A folder (default: `cache_folder()`) is not used if this process cannot write to it or another user can; then the
    warning `CacheUnused` is issued. `key` is a hexadecimal digest of everything on which the bytes depend.
    """
    place = cache_folder() if folder is None else folder
    path = place / f"{key}{suffix}"
    stored = _read(path)
    if stored is not None:
        return stored
    with _locked(place, key):
        stored = _read(path)
        if stored is not None:  # another process has built it in the meantime
            return stored
        built = build()
        why = _write(path, built)
    if why:
        _warn_unused(place, why)
    return built


@cache
def _warn_unused(place: Path, why: str) -> None:
    """Warn once in a process that a folder is not used, whatever filter of warnings is set."""
    text = f"the cache folder {place} is not used: {why}; each process builds its own results (set SURCTL_CACHE)"
    warnings.warn(text, CacheUnused, stacklevel=3)


def shared_library(
    source: str | Callable[[], str],
    *,
    flags: Sequence[str] = (),
    folder: Path | None = None,
    wide: bool = False,
    identity: str = "",
) -> bytes:
    r"""Return the shared library compiled from one C source: its bytes, so that the caller loads what was checked.

    Args:
        source: the C text, or a function that writes it.
        flags: additional compiler flags, after `FLAGS`, `further_flags` and `tuned_flags` (`wide`).
        identity: text that differs if the C text differs; a function `source` is then called only if no library with
            this identity is in the cache. Empty: the C text itself.

    Raises:
        ToolMissing, InputError, SurctlError: as in `compile_program`.
    """
    tuned = tuned_flags(wide=wide)
    key = _key(identity or _text(source), (*tuned, *flags))
    return cached_bytes(key, ".so", lambda: _build(_text(source), flags, tuned), folder=folder)


def _text(source: str | Callable[[], str]) -> str:
    return source if isinstance(source, str) else source()


def _key(source: str, flags: Sequence[str]) -> str:
    used = [*FLAGS, *further_flags(), *_SHARED, *flags]
    parts = [source, *used, find_compiler(), compiler_version(), platform.platform(), _processor()]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _processor() -> str:
    # the compiler flag -march=native depends on these properties
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return "\n".join(sorted({line for line in lines if line.startswith(("flags", "model name", "Features"))}))


def _read(path: Path) -> bytes | None:
    try:
        if not (_is_ours(path.parent) and _is_ours(path)):
            return None
        entry = path.read_bytes()
    except OSError:
        return None
    noted, body = entry[:_NOTE], entry[_NOTE:]
    return body if hashlib.sha256(body).digest() == noted else None


def _is_ours(path: Path) -> bool:
    status = path.lstat()
    if stat.S_ISLNK(status.st_mode) or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return False
    return not hasattr(os, "getuid") or status.st_uid == os.getuid()


@contextmanager
def _locked(folder: Path, key: str) -> Iterator[None]:
    """Hold the lock of a cache entry, so that one process builds it while others wait; nothing else relies on it.

    There is no lock if the folder does not exist yet or has no locks, nor after `_PATIENCE` if its owner is stopped.
    """
    # one byte of one file for each entry, since a file for each entry would have to be cleaned up
    byte = int(hashlib.sha256(key.encode()).hexdigest()[:7], 16)
    try:
        import fcntl

        file = _lock_file(folder) if _is_ours(folder) else None
    except (OSError, ImportError):  # on a network, without the right to write, or on Windows
        file = None
    if file is None:
        yield
        return
    began = time.monotonic()
    while time.monotonic() - began < _PATIENCE:
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, byte)
            break
        except BlockingIOError:
            time.sleep(_PAUSE)
        except OSError:
            break
    try:
        yield
    finally:
        with suppress(OSError):
            fcntl.lockf(file, fcntl.LOCK_UN, 1, byte)


@cache
def _lock_file(folder: Path) -> int:
    # stays open: to close it would release all locks of this process, also those of an outer entry
    return os.open(folder / _LOCKS, os.O_WRONLY | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)


def _write(path: Path, body: bytes) -> str:
    """Store the cache entry; return "", or the reason why the entry cannot be stored."""
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _is_ours(path.parent):
            return "it belongs to another user, is a link, or others may write to it"
        _replace(path, hashlib.sha256(body).digest() + body)
    except OSError as error:
        return f"it cannot be written ({error.strerror})"
    return ""


def _replace(path: Path, body: bytes) -> None:
    handle, name = tempfile.mkstemp(dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(body)
        Path(name).replace(path)
    except OSError:
        Path(name).unlink(missing_ok=True)
        raise


def _build(source: str, flags: Sequence[str], tuned: Sequence[str]) -> bytes:
    try:
        with tempfile.TemporaryDirectory(prefix="surctl-") as folder:
            text = Path(folder) / "block.c"
            text.write_text(source, encoding="utf-8")
            output = Path(folder) / "block.so"
            try:
                compile_program([text], output, flags=[*_SHARED, *tuned, *flags])
            except SurctlError:  # the compiler may not support these flags; if the source is wrong, it fails again
                compile_program([text], output, flags=[*_SHARED, *flags])
            return output.read_bytes()
    except OSError as error:
        raise SurctlError(f"cannot compile in the temporary folder: {error.strerror}") from None


def stored_numbers(
    sources: Sequence[str], key: Sequence[object], compute: Callable[[], dict[str, Any]], *, suffix: str = ".json"
) -> dict[str, Any]:
    """Return the numbers of `key`, from the cache on disk if a process with the same source code stored them.

    Args:
        key: everything on which the numbers depend beside the code, with an exact `repr`; arrays as `tobytes()`.
        compute: returns the numbers as JSON can hold them; its exceptions are passed on.
    """
    try:
        digest = source_digest(*sources)
    except SurctlError:  # the source code is missing or changed since the import, so it cannot identify the numbers
        return compute()
    text = f"{digest}\0{version('scipy')}\0{tuple(key)!r}"
    stored = cached_bytes(hashlib.sha256(text.encode()).hexdigest(), suffix, lambda: json.dumps(compute()).encode())
    numbers: dict[str, Any] = json.loads(stored)
    return numbers
