"""Randomness has a seed: Hypothesis draws the same examples in every run, and no deadline on noisy machines.

Blocks are compiled sooner than with -O2, to the same bytes; the tests of those name their own -O.
"""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

MANY_RUNS = ("cli", "tuning")  # elsewhere compiling is what takes the time


@pytest.fixture(autouse=True, scope="module")
def _compiled_soon(request: pytest.FixtureRequest) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        if "SURCTL_CFLAGS" not in os.environ:
            room = request.path.relative_to(Path(__file__).parent).parts[0]
            patch.setenv("SURCTL_CFLAGS", "-O1" if room in MANY_RUNS else "-O0")
        yield
