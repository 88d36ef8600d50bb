from __future__ import annotations

import pytest
from matplotlib.figure import Figure

from tests.blank import save_blank


@pytest.fixture
def blank(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is rendered: for tests of what stands around the pictures."""
    monkeypatch.setattr(Figure, "savefig", save_blank)
