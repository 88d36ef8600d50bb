"""What is said of a scenario before it is flown."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

__all__ = ["Finding"]


@dataclass(frozen=True)
class Finding:
    """One thing that cannot work (`error`), that a reader should know (`warning`), or may like to (`info`)."""

    level: Literal["error", "warning", "info"]
    key: str
    text: str

    def to_dict(self) -> dict[str, str]:
        """Plain data for JSON."""
        return asdict(self)
