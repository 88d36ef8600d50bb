"""A row for every claim of the paper: what it says of V1, V2 and the course, as printed and as corrected."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from surctl.reproduction.row import Item, Result, agrees, differs, wrong_in_print
from surctl.verification import Claim, claims, decide
from surctl.verification.setting import Setting

__all__ = ["FULL", "claim_items"]


FULL = 4096
"""Samples of the falsifier that `surctl verify` takes."""

_SPEEDS = f"--cruise {Setting.speed:g} --cap {Setting.speed_max:g}"
"""Those of the paper; `verify` takes a scenario's."""


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
            f"surctl verify {claim.name} {_SPEEDS}" if samples == FULL else f"surctl reproduce {claim.name} --quick",
        )
        for claim in claims(gains)
        if claim.paper
    ]


def judged(claim: Claim, samples: int) -> Result:
    """The verdict: refuted at a point, proved with a certificate that the checker accepts, or left open."""
    verdict = decide(claim, samples=samples)
    counterexample, unit = verdict.counterexample, claim.unit
    if verdict.certificate is not None:
        slack = verdict.certificate["claim"]["slack"]
        ours = f"proved{f' to within {slack:.1g} {unit}' if slack else ''}, by a certificate that the checker accepts"
        return agrees(ours, worst_margin=verdict.worst_margin, slack=slack)
    if counterexample is None:
        return differs("unknown", verdict.remaining or "", worst_margin=verdict.worst_margin)
    where = ", ".join(f"{name} = {number:.4g}" for name, number in counterexample.values.items())
    ours = f"refuted: exceeded by {counterexample.margin:.3g} {unit}, in {100 * verdict.fraction:.2g} % of the samples"
    return wrong_in_print(ours, f"at {where}", margin=counterexample.margin, fraction=verdict.fraction)
