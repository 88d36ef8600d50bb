from __future__ import annotations

import pytest

from tests.pictures import blank_pictures


@pytest.fixture
def blank(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is rendered: for tests of what stands around the pictures."""
    blank_pictures(monkeypatch)
