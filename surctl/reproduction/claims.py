"""A row for every claim of the paper: what it says of V1, V2 and the course, as printed and as corrected."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from surctl.reproduction.row import Found, Item, agrees, wrong_in_print
from surctl.verification import Claim, claims, falsify

__all__ = ["FULL", "claim_items"]


FULL = 4096
"""Samples of the falsifier that `surctl verify` takes."""


def claim_items(gains: Mapping[str, float], *, samples: int = FULL) -> list[Item]:
    """Rows of all claims for these gains, `samples` of the falsifier each."""
    return [
        Item(
            claim.name,
            "claims",
            claim.statement,
            "; ".join([claim.equation, *claim.errata]),
            "wrong in print" if claim.expected == "refuted" else "agrees",
            partial(judged, claim, samples),
            f"surctl verify {claim.name}" if samples == FULL else f"surctl reproduce {claim.name} --quick",
        )
        for claim in claims(gains)
        if claim.paper
    ]


def judged(claim: Claim, samples: int) -> Found:
    """The falsifier's verdict; a claim that is not refuted is not proved."""
    verdict = falsify(claim, samples=samples)
    found, unit = verdict.counterexample, claim.unit
    if found is None:
        ours = f"not refuted: largest left − right {verdict.worst_margin:.3g} {unit} of {verdict.samples} samples"
        return agrees(ours, worst_margin=verdict.worst_margin, samples=float(verdict.samples))
    where = ", ".join(f"{name} = {number:.4g}" for name, number in found.values.items())
    ours = f"refuted: exceeded by {found.margin:.3g} {unit}, in {100 * verdict.fraction:.2g} % of the samples"
    return wrong_in_print(ours, f"at {where}", margin=found.margin, fraction=verdict.fraction)
