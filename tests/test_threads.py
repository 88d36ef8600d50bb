"""Linear algebra of the tests runs in one thread, see `tests/__init__.py`."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np

ASKED = ("scipy_openblas_get_num_threads64_", "scipy_openblas_get_num_threads", "openblas_get_num_threads")


def test_openblas_has_one_thread() -> None:
    np.linalg.solve(np.eye(2), np.ones(2))  # loads it
    maps = Path("/proc/self/maps").read_text().splitlines()
    loaded = {words[-1] for line in maps if "openblas" in (words := line.split())[-1]}
    counts = {
        path: int(getattr(library, name)())
        for path in loaded
        for library in [ctypes.CDLL(path)]
        for name in ASKED
        if hasattr(library, name)
    }
    assert set(counts.values()) == ({1} if loaded else set()), counts
