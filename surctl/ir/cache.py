"""Cache on disk for objects that are costly to build, such as shared libraries and laws, for use by later processes.

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
import stat
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import version
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from surctl.errors import SurctlError
from surctl.ir.compiler import FLAGS, compile_program, compiler_version, find_compiler, further_flags, tuned_flags

__all__ = ["CacheUnused", "cache_folder", "cached_bytes", "shared_library", "source_digest", "stored_numbers"]

_SUFFIXES = (".py", ".toml")
_STARTED = time.time_ns()


@cache
def source_digest(*packages: str) -> str:
    """Return the SHA-256 of the source code of these packages and of the software versions with which they run.

    The digest covers names and contents of all .py and .toml files of the packages, also in inner packages; the
    versions of CasADi, NumPy and Python; and the platform, because its libm functions such as sin compute constants.
    The digest is computed once per process.

    Raises:
        SurctlError: a package is missing, a source file cannot be read, or a file was changed after this process began,
            so that the loaded code may be older than the file.

    Example:
        >>> from surctl.ir import source_digest
        >>> len(source_digest("surctl.ir", "surctl.errors"))
        64
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
    """Return the cache folder: $SURCTL_CACHE, or $XDG_CACHE_HOME/surctl, or ~/.cache/surctl (XDG specification).

    Example:
        >>> import os
        >>> from unittest.mock import patch
        >>> from surctl.ir import cache_folder
        >>> with patch.dict(os.environ, SURCTL_CACHE="compiled"):
        ...     print(cache_folder())
        compiled
    """
    own = os.environ.get("SURCTL_CACHE")
    if own:
        return Path(own)
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if Path(base).is_absolute() else Path.home() / ".cache") / "surctl"


def cached_bytes(key: str, suffix: str, build: Callable[[], bytes], *, folder: Path | None = None) -> bytes:
    """Return the bytes of the cache entry `key`; if there is no such entry, store and return the bytes of `build`.

    If several processes need one entry at the same time, one of them builds it and the others wait. Without locks (in a
    new folder, or on Windows) each uses the bytes that it built itself, and the bytes of the last one are stored.

    Args:
        key: hexadecimal digest of everything on which the bytes depend.
        suffix: suffix of the entry's file, with the dot.
        build: function that is called if no cache entry can be trusted; its exceptions are passed on.
        folder: cache folder; `cache_folder()` if None. A folder is not used if this process cannot write to it or
            another user can; then the warning `CacheUnused` is issued.

    Example:
        >>> from pathlib import Path
        >>> from surctl.ir import cached_bytes
        >>> cached_bytes("00ff", ".txt", lambda: b"built", folder=Path("cache"))
        b'built'
        >>> cached_bytes("00ff", ".txt", lambda: b"built anew", folder=Path("cache"))
        b'built'
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
        text = f"the cache folder {place} is not used: {why}; each process builds its own results (set SURCTL_CACHE)"
        warnings.warn(text, CacheUnused, stacklevel=2)
    return built


def shared_library(
    source: str | Callable[[], str],
    *,
    flags: Sequence[str] = (),
    folder: Path | None = None,
    wide: bool = False,
    identity: str = "",
) -> bytes:
    r"""Return the shared library compiled from one C source.

    Args:
        source: the C text, or a function that writes it.
        flags: additional compiler flags, after `FLAGS`, `further_flags` and `tuned_flags`.
        folder: cache folder, as in `cached_bytes`.
        wide: whether to use the processor's widest vector instructions, see `tuned_flags`.
        identity: text that differs if the C text differs; a function `source` is then called only if no library with
            this identity is in the cache. Empty: the C text itself.

    Returns:
        The bytes of the library, so that the caller can load exactly the library that was checked.

    Raises:
        ToolMissing, InputError, SurctlError: as in `compile_program`.

    Example:
        >>> import ctypes
        >>> from pathlib import Path
        >>> from surctl.ir import shared_library
        >>> text = "int twice(int x); int twice(int x) { return 2 * x; }\n"
        >>> _ = Path("twice.so").write_bytes(shared_library(text))
        >>> ctypes.CDLL("./twice.so").twice(21)
        42
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
        sources: packages or modules that contain the code, as in `source_digest`.
        key: everything on which the numbers depend beside the code, with an exact `repr`; arrays as `tobytes()`.
        compute: returns the numbers as JSON can hold them; its exceptions are passed on.
        suffix: suffix of the entry's file, with the dot.
    """
    try:
        digest = source_digest(*sources)
    except SurctlError:  # the source code is missing or changed since the import, so it cannot identify the numbers
        return compute()
    text = f"{digest}\0{version('scipy')}\0{tuple(key)!r}"
    stored = cached_bytes(hashlib.sha256(text.encode()).hexdigest(), suffix, lambda: json.dumps(compute()).encode())
    numbers: dict[str, Any] = json.loads(stored)
    return numbers
