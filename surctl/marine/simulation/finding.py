"""A finding about a scenario, reported before the simulation."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any, Literal

__all__ = ["Finding", "escaped"]


@dataclass(frozen=True)
class Finding:
    """One finding about a scenario: an error (the mission cannot work), a warning, or a note (`info`).

    `clearance_m` is the distance [m] from hull to wall or obstacle that an error reports; it is negative for an
    overlap.
    """

    level: Literal["error", "warning", "info"]
    key: str
    text: str
    clearance_m: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as plain data for JSON; `clearance_m` is present only if the finding has a clearance."""
        return {name: value for name, value in asdict(self).items() if value is not None}


def escaped(name: str) -> str:
    r"""Return a name with control and format characters escaped as in JSON, so that a text with it stays on one line.

    Example:
        >>> from surctl.marine.simulation.finding import escaped
        >>> print(escaped("two\nlines"))
        two\nlines
    """
    return "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in name)
