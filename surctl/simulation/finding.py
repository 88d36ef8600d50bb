"""A finding about a scenario, reported before the simulation."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

__all__ = ["Finding"]


@dataclass(frozen=True)
class Finding:
    """One finding about a scenario: it cannot work (`error`), deserves attention (`warning`), or is a note (`info`)."""

    level: Literal["error", "warning", "info"]
    key: str
    text: str

    def to_dict(self) -> dict[str, str]:
        """Return plain data for JSON."""
        return asdict(self)
