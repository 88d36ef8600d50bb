"""Rounds of a tuning, and the file that stores them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surctl.files import write_file
from surctl.marine.tuning.claim_points import ClaimPoint
from surctl.marine.tuning.montecarlo import Counterexample, MonteCarlo

__all__ = ["Round", "RoundsFile"]


@dataclass(frozen=True)
class Round:
    """One round of a tuning: a search, training runs that screen its gain sets, and fresh runs that verify one set.

    Attributes:
        gains: the gains that the round chose, by name.
        score: score of the chosen gains; see `Pool.score`.
        feasible: whether the chosen gains meet every hard goal over the runs known at the end of the round.
        missed: names of the goals that the chosen gains miss over the runs known at the end of the round.
        training: training runs that refuted other gain sets, which ranked better in the search than the chosen gains.
        verified: result of the fresh runs; None if no fresh runs were made.
        claims: points at which a claim that should hold fails with the chosen gains.
        others: the gain sets that rank next after the chosen set over the known runs, best first; the next search also
            starts from these sets.
    """

    gains: Mapping[str, float]
    score: float
    feasible: bool
    missed: tuple[str, ...]
    training: tuple[Counterexample, ...]
    verified: MonteCarlo | None
    claims: tuple[ClaimPoint, ...]
    others: tuple[Mapping[str, float], ...]

    @property
    def refuted(self) -> tuple[str, ...]:
        """Names of the goals that fresh runs refute, and of the claims that fail."""
        goals = () if self.verified is None else self.verified.refuted
        return (*goals, *(p.name for p in self.claims))

    @property
    def fresh(self) -> tuple[Counterexample, ...]:
        """The fresh runs that refute a goal although the tuned gains meet this goal over the known runs."""
        counterexamples = () if self.verified is None else self.verified.counterexamples
        return tuple(c for c in counterexamples if c.goal not in self.missed)

    def to_dict(self) -> dict[str, Any]:
        """The round as plain data for JSON."""
        return {
            "gains": dict(self.gains),
            "score": self.score,
            "feasible": self.feasible,
            "missed": list(self.missed),
            "training": [c.to_dict() for c in self.training],
            "monte_carlo": None if self.verified is None else self.verified.to_dict(),
            "claims": [{"name": p.name, "values": dict(p.values), "threshold": p.threshold} for p in self.claims],
            "others": [dict(gains) for gains in self.others],
        }


class RoundsFile:
    """JSON file with the finished rounds of one request; the whole file is written again after each round.

    Args:
        folder: folder of `rounds.json`; None stores nothing.
        request: text that determines the rounds completely; a file that belongs to another request is ignored.
    """

    def __init__(self, folder: Path | None, request: str) -> None:
        self.path = None if folder is None else folder / "rounds.json"
        self.digest = hashlib.sha256(request.encode()).hexdigest()
        self.rounds: list[Round] = self._load()

    def round(self, k: int) -> Round | None:
        """Return the k-th round if it is finished, otherwise None."""
        return self.rounds[k] if k < len(self.rounds) else None

    def add(self, one: Round) -> None:
        """Store a finished round."""
        self.rounds.append(one)
        if self.path is None:
            return
        text = json.dumps({"request": self.digest, "rounds": [r.to_dict() for r in self.rounds]}, indent=1)
        write_file(self.path, text)

    def _load(self) -> list[Round]:
        # a file that belongs to another request is ignored
        if self.path is None or not self.path.exists():
            return []
        try:
            table = json.loads(self.path.read_text(encoding="utf-8"))
            if table["request"] != self.digest:
                return []
            return [_round_from(one) for one in table["rounds"]]
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return []


def _round_from(table: Mapping[str, Any]) -> Round:
    verified, m = None, table["monte_carlo"]
    if m is not None:
        counterexamples = _counterexamples(m["counterexamples"])
        verified = MonteCarlo(m["runs"], (m["seeds"][0], m["seeds"][1]), m["missed"], m["normalised"], counterexamples)
    return Round(
        table["gains"],
        table["score"],
        table["feasible"],
        tuple(table["missed"]),
        _counterexamples(table["training"]),
        verified,
        tuple(ClaimPoint(**p) for p in table["claims"]),
        tuple(table["others"]),
    )


def _counterexamples(table: list[dict[str, Any]]) -> tuple[Counterexample, ...]:
    return tuple(Counterexample(**c) for c in table)
