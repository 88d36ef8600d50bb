"""The summary of a campaign: shares and percentiles of its runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.marine.simulation.campaign.assumptions import MEANINGS
from surctl.marine.simulation.campaign.share import Share
from surctl.marine.simulation.campaign.table import RunTable
from surctl.marine.simulation.metrics import STOPS

__all__ = ["PERCENTILES", "Summary", "summarise"]

PERCENTILES = (0, 5, 25, 50, 75, 95, 100)


@dataclass(frozen=True)
class Summary:
    """Shares and percentiles of n runs.

    Attributes:
        stopped: share of the runs that ended for each reason of `STOPS`, by reason.
        time_s: percentiles of the arrival time of the runs that arrived [s]; empty if no run arrived.
        clearance_m: percentiles of the smallest clearance of all runs [m]; empty without obstacles and walls.
        broken: number of collided runs that violate an assumption, by assumption; the entry `none` counts collided runs
            that violate no assumption.
        inside: share of collided runs among the runs that violate no assumption; None if every run violates an
            assumption.
        violated: number of runs, collided or not, that violate an assumption, by assumption.
    """

    stopped: Mapping[str, Share]
    time_s: Mapping[int, float]
    clearance_m: Mapping[int, float]
    broken: Mapping[str, int]
    inside: Share | None
    violated: Mapping[str, int]

    def to_dict(self) -> dict[str, Any]:
        """Return the summary as plain data for JSON."""
        return {
            "stopped": {reason: _share_dict(share) for reason, share in self.stopped.items()},
            "collisions_within_assumptions": None if self.inside is None else _share_dict(self.inside),
            "time_s": {f"p{p}": value for p, value in self.time_s.items()},
            "min_clearance_m": {f"p{p}": value for p, value in self.clearance_m.items()},
            "collisions_by_broken_assumption": dict(self.broken),
            "runs_by_broken_assumption": dict(self.violated),
        }

    def lines(self, *, claim: bool = True) -> list[str]:
        """Return the summary as lines of text.

        If `claim` is true, the text includes the claim that the hull touches no obstacle, if the law has this claim.
        """
        lines = []
        for reason in ("collision", "time limit", "standstill", "dead end", "fault"):
            s = self.stopped[reason]
            lines.append(
                f"  {reason:<11}{s.count:>7} of {s.runs}: {s.rate:.3%}, with 95 % confidence at most {s.at_most():.3%}"
            )
        reached = self.stopped["reached"]
        lines.append(f"  {'reached':<11}{reached.count:>7} of {reached.runs}: {reached.rate:.3%}")
        for name, unit, percentiles in (("time", "s", self.time_s), ("clearance", "m", self.clearance_m)):
            if percentiles:
                values = ", ".join(f"{value:.4g} {unit} ({p} %)" for p, value in percentiles.items())
                lines.append(f"  {name:<11}{values}")
        if not claim:
            return lines
        if self.broken:
            counts = ", ".join(f"{n} {k}" for k, n in self.broken.items())
            lines.append(f"  collisions by violated assumption: {counts}")
        if self.violated:
            counts = "; ".join(f"{name}, {MEANINGS[name]} ({n} runs)" for name, n in self.violated.items())
            lines.append(f"  violated assumptions of the no-contact claim: {counts}")
        if self.inside is None:
            lines.append("  every run violates an assumption of the no-contact claim")
        else:
            s = self.inside
            lines.append(
                f"  within the assumptions of the no-contact claim: {s.count} of {s.runs} collided, "
                f"with 95 % confidence at most {s.at_most():.3%}"
            )
        return lines


def summarise(table: RunTable) -> Summary:
    """Return the summary of a table of campaign runs.

    Raises:
        InputError: the table has no runs.
    """
    ended = np.round(table.column("stopped"))
    stopped = {reason: Share(int(np.sum(ended == code)), len(table)) for code, reason in enumerate(STOPS)}
    arrived = table.column("reached") > 0.5
    broken: dict[str, int] = {}
    collided = table.column("collided") > 0.5
    holds = np.array([not names for names in table.broken])
    inside = Share(int(np.sum(collided & holds)), int(np.sum(holds))) if holds.any() else None
    for k in np.flatnonzero(collided):
        for name in table.broken[int(k)] or ("none",):
            broken[name] = broken.get(name, 0) + 1
    violated = dict(Counter(name for names in table.broken for name in names).most_common())
    clear = table.column("min_clearance_m")
    return Summary(
        stopped,
        _percentiles(table.column("time_s")[arrived]),
        _percentiles(clear[np.isfinite(clear)]),
        broken,
        inside,
        violated,
    )


def _share_dict(share: Share) -> dict[str, float]:
    return {"count": share.count, "runs": share.runs, "rate": share.rate, "at_most_95": share.at_most()}


def _percentiles(values: NDArray[np.float64]) -> dict[int, float]:
    if not len(values):
        return {}
    return {p: float(v) for p, v in zip(PERCENTILES, np.percentile(values, PERCENTILES), strict=True)}
