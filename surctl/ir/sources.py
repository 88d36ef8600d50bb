"""Digest of the code that builds a law; data on disk is valid only for the code that wrote it."""

from __future__ import annotations

import hashlib
import importlib.resources
import importlib.util
import platform
import time
from collections.abc import Iterator
from functools import cache
from importlib.resources.abc import Traversable
from pathlib import Path

import casadi as ca
import numpy as np

from surctl.errors import SurctlError

__all__ = ["source_digest"]

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
