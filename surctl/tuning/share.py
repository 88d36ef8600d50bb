"""The share of random runs in which an event happens, with an upper bound of its probability."""

from __future__ import annotations

from dataclasses import dataclass

from surctl.errors import InputError

__all__ = ["Share"]


@dataclass(frozen=True)
class Share:
    """The number of runs in which an event happens, out of a number of independent runs.

    Attributes:
        count: number of runs with the event, between 0 and `runs`.
        runs: number of all runs, at least 1.

    Raises:
        InputError: `runs` is less than 1, or `count` is not between 0 and `runs`.
    """

    count: int
    runs: int

    def __post_init__(self) -> None:
        """Check `runs` and `count`."""
        if self.runs < 1:
            raise InputError("must be at least 1", key="runs", value=self.runs, remedy="simulate at least one run")
        if not 0 <= self.count <= self.runs:
            raise InputError(
                "is not between 0 and the number of runs",
                key="count",
                value=self.count,
                remedy=f"give 0 to {self.runs}",
            )

    @property
    def rate(self) -> float:
        """Observed share of the runs with the event."""
        return self.count / self.runs

    def at_most(self, confidence: float = 0.95) -> float:
        """Return the exact one-sided upper bound of the true rate (Clopper and Pearson, Biometrika 26, 1934).

        Raises:
            InputError: the confidence is not between 0 and 1.
        """
        if not 0 < confidence < 1:
            raise InputError(
                "must be between 0 and 1", key="confidence", value=confidence, remedy="give for instance 0.95"
            )
        from scipy.stats import beta  # this import takes half a second

        return 1.0 if self.count == self.runs else float(beta.ppf(confidence, self.count + 1, self.runs - self.count))
