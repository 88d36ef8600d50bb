"""Verdicts as data: proved, refuted, unknown or not applicable; whether as expected, and on which evidence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from surctl.errors import NotApplicable
from surctl.verification.claim import Claim, VerdictWord
from surctl.verification.counterexample import Counterexample


@dataclass(frozen=True)
class Inapplicable:
    """Record of a claim that does not apply to the given vehicle or gains; it is not a verdict on the claim.

    Attributes:
        claim: name of the claim.
        because: the violated assumption of the claim, with the numbers that violate it.
        to: the object to which the claim does not apply: "this vehicle" or "these gains".
    """

    claim: str
    because: str
    to: str = "this vehicle"

    @classmethod
    def of(cls, claim: str, reason: NotApplicable) -> Inapplicable:
        """Create the record from the `NotApplicable` error that the check of the claim raised."""
        return cls(claim, reason.because, reason.to)

    @property
    def sentence(self) -> str:
        """The reason why the claim does not apply, in one line."""
        return f"not applicable to {self.to}, because {self.because}"

    def to_dict(self) -> dict[str, Any]:
        """The record as plain data for JSON, with the keys that every verdict has."""
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
    """The result of checking one claim.

    Attributes:
        claim: the claim.
        verdict: `proved` with a certificate, `refuted` with a counterexample, or `unknown` if neither was found.
            `not refuted` is the verdict of the falsifier alone: a search without a counterexample proves nothing.
        counterexample: a point where the claim fails.
        worst_margin: largest value of left − right found in the domain, in the claim's unit.
        threshold: largest margin that counts as rounding, in the claim's unit.
        fraction: share of the samples in the domain at which the claim fails.
        samples: number of samples in the domain.
        searches: number of local searches.
        witnesses: the claim's witnesses with their margins.
        seconds: duration of the check [s].
        certificate: the certificate that `surctl.certcheck` accepts as a proof.
        open_ends: description of the part of the domain that the prover could not decide.
        open_boxes: the largest boxes that the prover could not decide; a box maps each variable to (lower, upper).
        vacuous: why a proved claim says nothing, as the checker finds; empty if its domain has a point.
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
    vacuous: str = ""

    @property
    def as_expected(self) -> bool:
        """Whether the verdict is the expected verdict of the claim.

        The falsifier alone cannot prove a claim; if the expected verdict is "proved", the falsifier's verdict "not
        refuted" therefore counts as expected. For a claim whose expected verdict is "not refuted", every verdict except
        "refuted" is as expected.
        """
        if self.claim.expected == "not refuted":
            return self.verdict != "refuted"
        return self.verdict == self.claim.expected or (self.verdict, self.claim.expected) == ("not refuted", "proved")

    @property
    def remaining(self) -> str | None:
        """The reason why the claim is not decided; None if the claim is proved or refuted."""
        if self.verdict not in ("not refuted", "unknown"):
            return None
        stopped = f"{self.open_ends}; " if self.open_ends else ""
        return (
            f"not proved: {stopped}the largest margin left - right that {self.samples} samples and {self.searches} "
            f"local searches found is {self.worst_margin:.3g} {self.claim.unit}"
        )

    def to_dict(self) -> dict[str, Any]:
        """The verdict as plain data for JSON."""
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
            "vacuous": self.vacuous or None,
            "worst_margin": self.worst_margin if math.isfinite(self.worst_margin) else None,
            "unit": self.claim.unit,
            "fraction": self.fraction,
            "samples": self.samples,
            "witnesses": [w.to_dict() for w in self.witnesses],
            "seconds": self.seconds,
        }

    def _proof(self) -> dict[str, Any] | None:
        if self.certificate is None:
            return None
        slack = self.certificate["claim"]["slack"]
        return {"kind": self.certificate["kind"], "sha256": self.certificate["sha256"], "slack": slack}
