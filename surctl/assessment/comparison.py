"""Two assessments of one subject, before and after a change: every figure of both, and what got worse."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from surctl.assessment.assessment import Assessment, Figure

__all__ = ["Comparison"]


@dataclass(frozen=True, eq=False)
class Comparison:
    """An assessment before and after a change of the gains."""

    before: Assessment
    after: Assessment

    @property
    def rows(self) -> list[tuple[Figure, Figure]]:
        """Every figure of one of both, before and after; NaN where one has none. What got worse comes first."""
        known = {**self.after.figures, **self.before.figures}
        pairs = [tuple(_of(one, figure) for one in (self.before, self.after)) for figure in known.values()]
        return sorted(((old, new) for old, new in pairs), key=lambda pair: -_loss(*pair))

    @property
    def worse(self) -> list[tuple[Figure, Figure]]:
        """The figures that got worse, the largest share first."""
        return [(old, new) for old, new in self.rows if new.worse(old)]

    @property
    def headline(self) -> str:
        """What got worse, or that nothing did, in one line."""
        if not self.worse:
            return "no figure of the assessment is worse than before"
        changes = ", ".join(f"{old.name} {_text(old)} -> {_text(new)}" for old, new in self.worse)
        return f"WORSE than before: {changes}"

    def lines(self) -> list[str]:
        """Return the headline, the table of all figures, and what fails or is not decided after the change."""
        table = [f"{'figure':<28}{'unit':<6}{'required':>10}{'before':>12}{'after':>12}"]
        for old, new in self.rows:
            sign = "" if new.least is None else f"{'≥' if new.better == 'high' else '≤'} {new.least:g}"
            mark = "  worse" if new.worse(old) else ""
            table.append(f"{new.name:<28}{new.unit:<6}{sign:>10}{_text(old):>12}{_text(new):>12}{mark}")
        open_ends = [f"{line.mark} {line.text}" for line in self.after.lines if line.rank < 2]
        return [self.headline, *table, *open_ends]

    def to_dict(self) -> dict[str, Any]:
        """Return both assessments and the names of the figures that got worse as plain data for JSON."""
        worse = [new.name for _, new in self.worse]
        return {"before": self.before.to_dict(), "after": self.after.to_dict(), "worse": worse}


def _of(one: Assessment, figure: Figure) -> Figure:
    missing = Figure(figure.name, float("nan"), figure.unit, figure.meaning, figure.better, figure.least)
    return one.figures.get(figure.name, missing)


def _loss(old: Figure, new: Figure) -> float:
    # share of the value that is lost; 0 or less if nothing is
    if not new.worse(old):
        return 0.0
    lost = abs(new.value - old.value) / max(abs(old.value), 1e-9)
    return float(lost) if np.isfinite(lost) else float("inf")


def _text(figure: Figure) -> str:
    return "none" if np.isnan(figure.value) else f"{figure.value:.3g}"
