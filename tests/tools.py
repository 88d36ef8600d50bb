"""What several rooms' tests need of the machine."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path
from shutil import which

import pytest

from surctl.errors import ToolMissing
from surctl.ir.cache import find_compiler

PATIENCE = 1200  # s; until a process that says nothing is taken for one that hangs, on a busy machine too


def need_compiler() -> str:
    """The C compiler; without one the test is skipped, or fails where CI=true promises one."""
    try:
        return find_compiler()
    except ToolMissing as missing:
        _without(str(missing))
        raise


def need(tool: str) -> str:
    """A program, on the same terms."""
    found = which(tool)
    if found is None:
        _without(f"{tool} is not installed")
    return str(found)


def need_module(name: str) -> None:
    """An optional module, on the same terms."""
    if importlib.util.find_spec(name) is None:
        _without(f"the module {name} is not installed")


def need_make() -> str:
    """`make`, on the same terms."""
    return need("make")


def widest_vectors() -> tuple[str, ...]:
    """Flags that undo `tuned_flags`' leaving out of AVX-512; none where the processor would end on its instructions."""
    try:
        told = Path("/proc/cpuinfo").read_text()
    except OSError:
        return ()
    return ("-mavx512f",) if "avx512f" in told.split() else ()


def _without(reason: str) -> None:
    """Skip, with the reason; under CI=true nothing may be missing."""
    if os.environ.get("CI") == "true":
        pytest.fail(f"CI must have it: {reason}")
    pytest.skip(reason)
