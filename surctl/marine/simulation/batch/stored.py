"""C text and digest of a closed loop, stored on disk, so that another process need not build the loop again."""

from __future__ import annotations

import hashlib
from functools import cache
from typing import NamedTuple

from surctl.errors import SurctlError
from surctl.ir import batch_source, cached_bytes, fused, source_digest, without_libm
from surctl.marine.control.build import LAW_SOURCES
from surctl.marine.simulation.batch.loop import Structure, build_loop
from surctl.own_code import is_own

__all__ = ["StoredLoop", "stored_loop"]

_SOURCES = (
    *LAW_SOURCES,
    *(f"surctl.{name}" for name in ("files", "own_code", "units")),
    *(f"surctl.marine.{name}" for name in ("allocation", "simulation", "world")),
)
"""Packages whose source code determines the instruction list of a closed loop."""


class StoredLoop(NamedTuple):
    """A closed loop for many runs.

    Attributes:
        digest: digest of the loop's step.
        source: C text that `compile_batch_source` compiles.
    """

    digest: str
    source: str


@cache
def stored_loop(structure: Structure) -> StoredLoop:
    """Return the digest and the C text of a loop, from the cache on disk if a process with this source code stored it.

    A loop with a law of the user's own is built again in every process, because the modules that its file imports may
    have changed. So is a loop with thrusters, whose numbers have no exact text.
    """
    if is_own(structure.law) or structure.actuators is not None:
        return _built(structure)
    try:
        sources = source_digest(*_SOURCES)
    except SurctlError:  # the source code is missing or changed since the import, so it cannot identify a cached loop
        return _built(structure)
    key = hashlib.sha256(f"{sources}\0{structure!r}".encode()).hexdigest()
    stored = cached_bytes(key, ".loop", lambda: "\n".join(_built(structure)).encode())
    return StoredLoop(*stored.decode().split("\n", 1))


def _built(structure: Structure) -> StoredLoop:
    step = build_loop(structure).step
    return StoredLoop(step.digest(), batch_source(fused(without_libm(step))))
