"""How often something happened in runs that were drawn, and how often it may happen at most."""

from __future__ import annotations

from dataclasses import dataclass

from surctl.errors import InputError

__all__ = ["Share"]


@dataclass(frozen=True)
class Share:
    """So many of so many independent runs.

    Attributes:
        count: runs in which it happened.
        runs: all runs, at least 1.

    Raises:
        InputError: no runs, or a count outside 0 to runs.
    """

    count: int
    runs: int

    def __post_init__(self) -> None:
        """Check."""
        if self.runs < 1:
            raise InputError("a share needs a run", key="runs", value=self.runs, remedy="fly at least one")
        if not 0 <= self.count <= self.runs:
            raise InputError("is not among the runs", key="count", value=self.count, remedy=f"0 to {self.runs}")

    @property
    def rate(self) -> float:
        """Share seen."""
        return self.count / self.runs

    def at_most(self, confidence: float = 0.95) -> float:
        """Exact one-sided upper bound of the true rate (Clopper and Pearson, Biometrika 26, 1934).

        Raises:
            InputError: a confidence that is not between 0 and 1.
        """
        if not 0 < confidence < 1:
            raise InputError("must be between 0 and 1", key="confidence", value=confidence, remedy="such as 0.95")
        from scipy.stats import beta  # takes half a second to load

        return 1.0 if self.count == self.runs else float(beta.ppf(confidence, self.count + 1, self.runs - self.count))
