"""A finding about a scenario, reported before the simulation."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

__all__ = ["Finding"]


@dataclass(frozen=True)
class Finding:
    """One finding about a scenario: it cannot work (`error`), deserves attention (`warning`), or is a note (`info`).

    `clearance_m` is the distance [m] between hull and wall or obstacle that an error is about, negative for an overlap.
    """

    level: Literal["error", "warning", "info"]
    key: str
    text: str
    clearance_m: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON; `clearance_m` only where there is one."""
        return {name: value for name, value in asdict(self).items() if value is not None}
