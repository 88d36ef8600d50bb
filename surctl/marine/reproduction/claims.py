"""Verdicts on the paper's claims about Lyapunov functions V1, V2 and about the course, as printed and as corrected."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from surctl.marine.reproduction.row import Item, Result, agrees, differs, wrong_in_print
from surctl.marine.verification import claims
from surctl.verification import Claim, decide
from surctl.verification.setting import Setting

__all__ = ["FULL", "claim_items"]


FULL = 4096
"""Number of samples that the falsifier of `surctl verify` uses."""

_SPEEDS = f"--cruise {Setting.speed:g} --cap {Setting.speed_max:g}"
"""Options with the speeds of the paper; without them, `surctl verify` uses the speeds of a scenario."""


def claim_items(gains: Mapping[str, float], *, samples: int = FULL) -> list[Item]:
    """Return, for each claim of the paper, the comparison of its verdict with the expected one, for these gains.

    The falsifier takes `samples` samples per claim.
    """
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
    """Return the verdict on a claim: refuted by a counterexample, proved by a checked certificate, or undecided."""
    verdict = decide(claim, samples=samples)
    counterexample, unit = verdict.counterexample, claim.unit
    if verdict.certificate is not None:
        slack = verdict.certificate["claim"]["slack"]
        within = f" with a slack of {slack:.1g} {unit}" if slack else ""
        ours = f"proved{within} by a certificate that the checker accepts"
        return agrees(ours, worst_margin=verdict.worst_margin, slack=slack)
    if counterexample is None:
        return differs("undecided", verdict.remaining or "", worst_margin=verdict.worst_margin)
    where = ", ".join(f"{name} = {number:.4g}" for name, number in counterexample.values.items())
    share = f"the claim fails for {100 * verdict.fraction:.2g} % of the samples"
    ours = f"refuted: the bound is exceeded by {counterexample.margin:.3g} {unit}; {share}"
    return wrong_in_print(ours, f"at {where}", margin=counterexample.margin, fraction=verdict.fraction)
