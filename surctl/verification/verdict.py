"""A verdict is data: what was claimed, what came out, and the evidence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from surctl.errors import NotApplicable
from surctl.verification.claim import Claim, VerdictWord
from surctl.verification.counterexample import Counterexample

__all__ = ["Inapplicable", "Verdict"]


@dataclass(frozen=True)
class Inapplicable:
    """A claim that is not about the case at hand, which is no verdict on the claim.

    Attributes:
        claim: its name.
        because: the assumption that is violated, with its numbers.
        to: what the claim does not apply to: "this vehicle", "these gains".
    """

    claim: str
    because: str
    to: str = "this vehicle"

    @classmethod
    def of(cls, claim: str, reason: NotApplicable) -> Inapplicable:
        """From the error that said so."""
        return cls(claim, reason.because, reason.to)

    @property
    def sentence(self) -> str:
        """The reason in one line."""
        return f"not applicable to {self.to}, because {self.because}"

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON, with the keys that every claim has."""
        return {
            "claim": self.claim,
            "expected": None,
            "verdict": "not applicable",
            "because": self.because,
            "certificate": None,
            "counterexample": None,
            "remaining": None,
            "seconds": 0.0,
        }


@dataclass(frozen=True)
class Verdict:
    """What a check of one claim came to.

    Attributes:
        claim: the claim.
        verdict: `proved`, with a certificate; `refuted`, with a counterexample; `unknown`, with what is left open; or,
            of the falsifier alone, `not refuted`: a vain search proves nothing.
        counterexample: a point where the claim fails.
        worst_margin: largest left − right found in the domain, in the claim's unit.
        threshold: margins up to this count as rounding.
        fraction: share of the samples in the domain where the claim fails.
        samples: number of samples in the domain.
        searches: number of local searches.
        witnesses: the claim's own points with the margin found there.
        seconds: time it took [s].
        certificate: what `surctl.certcheck` accepts as a proof.
        open_ends: what an attempt at a proof left open, in words.
        open_boxes: the largest boxes of it, (lower, upper) by variable.
    """

    claim: Claim
    verdict: VerdictWord
    counterexample: Counterexample | None
    worst_margin: float
    threshold: float
    fraction: float
    samples: int
    searches: int
    witnesses: tuple[Counterexample, ...] = ()
    seconds: float = field(default=0.0, compare=False)
    certificate: Mapping[str, Any] | None = field(default=None, repr=False)
    open_ends: str = ""
    open_boxes: tuple[Mapping[str, list[float]], ...] = field(default=(), repr=False)

    @property
    def as_expected(self) -> bool:
        """Whether the verdict is the one the claim ships with.

        The falsifier alone cannot prove: from it, "not refuted" is what is expected of a claim that can be proved. A
        claim that ships as "not refuted" expects no more than that there is no counterexample.
        """
        if self.claim.expected == "not refuted":
            return self.verdict != "refuted"
        return self.verdict == self.claim.expected or (self.verdict, self.claim.expected) == ("not refuted", "proved")

    @property
    def remaining(self) -> str | None:
        """What is left open; None when the claim is settled."""
        if self.verdict not in ("not refuted", "unknown"):
            return None
        stopped = f"{self.open_ends}; " if self.open_ends else ""
        return (
            f"not proved: {stopped}{self.samples} samples and {self.searches} local searches found nothing worse than "
            f"{self.worst_margin:.3g} {self.claim.unit}"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        counterexample = self.counterexample
        return {
            "claim": self.claim.name,
            "statement": self.claim.statement,
            "equation": self.claim.equation,
            "errata": list(self.claim.errata),
            "expected": self.claim.expected,
            "verdict": self.verdict,
            "certificate": self._proof(),
            "counterexample": None if counterexample is None else counterexample.to_dict(),
            "remaining": self.remaining,
            "slack": None if self.certificate is None else self.certificate["claim"]["slack"],
            "worst_margin": self.worst_margin,
            "unit": self.claim.unit,
            "fraction": self.fraction,
            "samples": self.samples,
            "witnesses": [w.to_dict() for w in self.witnesses],
            "seconds": self.seconds,
        }

    def _proof(self) -> dict[str, Any] | None:
        """What is told of the certificate: its hash, and by how much left may exceed right."""
        if self.certificate is None:
            return None
        slack = self.certificate["claim"]["slack"]
        return {"kind": self.certificate["kind"], "sha256": self.certificate["sha256"], "slack": slack}
