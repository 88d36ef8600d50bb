"""Check of a certificate of kind `barrier`, which claims that no solution reaches a set of unsafe states.

The claim is about solutions that start in the box where all expressions of `initial` are ≤ 0, as long as they stay in
the box: they do not reach a state where all expressions of `unsafe` are ≤ 0. The proof shows for the function B:

1. B ≤ 0 where all expressions of `initial` are ≤ 0;
2. B ≥ margin > 0 where all expressions of `unsafe` are ≤ 0;
3. B' ≤ multiplier · B in the box (continuous time), or B(x⁺) ≤ 0 where B ≤ 0 (discrete time, without a multiplier).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from surctl.certcheck.document import Rejected, record
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.inequality import listed, number
from surctl.certcheck.motion import Obligation, check_all, decimal_text, read_motion

__all__ = ["check"]

_CLAIM = {
    "name", "time", "property", "states", "parameters", "dynamics", "function", "initial", "unsafe", "multiplier",
    "about",
}  # fmt: skip
_DOCUMENT = {"format", "version", "kind", "claim", "sha256", "change", "margin", "proofs"}


def check(document: Mapping[str, Any]) -> None:
    """Raise Rejected unless the certificate proves its claim."""
    claim = document["claim"]
    motion = read_motion(claim)
    record(claim, _CLAIM, "claim")
    record(document, _DOCUMENT, "the certificate")
    if claim["property"] != "safety":
        raise Rejected("claim.property is not 'safety'")
    function, multiplier = claim["function"], claim["multiplier"]
    if number(document["margin"]) <= 0:
        raise Rejected("the margin is not positive")
    change = motion.verify_change(function, document["change"])
    states, box = motion.states, motion.state_box
    initial, unsafe = listed(claim["initial"]), listed(claim["unsafe"])
    needed = [
        Obligation(states, box, function, "0", initial),
        Obligation(states, box, decimal_text(document["margin"]), function, unsafe),
    ]
    if motion.discrete:
        if multiplier is not None:
            raise Rejected("the multiplier must be null because the claim is in discrete time")
        needed.append(Obligation(motion.names, motion.box, change, "0", [function]))
    else:
        ExpressionTable(motion.names).read(multiplier)
        needed.append(Obligation(motion.names, motion.box, change, f"({multiplier})*({function})"))
    check_all(needed, document["proofs"], motion.normal)
