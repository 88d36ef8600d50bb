"""What several rooms' tests need of the machine."""

from __future__ import annotations

import os

import pytest

from surctl.errors import ToolMissing
from surctl.ir import find_compiler


def need_compiler() -> str:
    """The C compiler; without one the test is skipped, or fails where CI=true promises one."""
    try:
        return find_compiler()
    except ToolMissing as missing:
        if os.environ.get("CI") == "true":
            pytest.fail(f"CI must have a C compiler: {missing}")
        pytest.skip(str(missing))
