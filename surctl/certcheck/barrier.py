"""Check of a certificate of kind `barrier`, which claims that no solution reaches a set of unsafe states.

The claim is about solutions that start in the box where all expressions of `initial` are ≤ 0: as long as they stay in
the box, they do not reach a state where all expressions of `unsafe` are ≤ 0. With `stays`, the claim is also that they
stay in the box for ever. The proof shows for the function B:

1. B ≤ 0 where all expressions of `initial` are ≤ 0;
2. B ≥ margin > 0 where all expressions of `unsafe` are ≤ 0;
3. B' ≤ multiplier · B in the box (continuous time), or B(x⁺) ≤ 0 where B ≤ 0 (discrete time, without a multiplier);
4. with `stays`, where B ≤ 0: on each face of the box, the state's rate is at least `inward` > 0 towards the inside, one
   number for each face (continuous time), or the successor lies in the box (discrete time, `inward` is null).

By 1 and 3, B ≤ 0 along a solution up to the first time at which it is on a face and about to leave. By 4, the state
then moves inwards at once, because rates do not jump.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from surctl.certcheck.document import Rejected, record
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.inequality import Obligation, check_all, listed, number
from surctl.certcheck.motion import Motion, decimal_text, read_motion

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
    stays = "stays" in claim
    record(claim, _CLAIM | {"stays"} if stays else _CLAIM, "claim")
    record(document, _DOCUMENT | {"inward"} if stays else _DOCUMENT, "the certificate")
    if stays and claim["stays"] is not True:
        raise Rejected("claim.stays is not true; leave it out if the solutions may leave the box")
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
        if stays:
            if document["inward"] is not None:
                raise Rejected("'inward' must be null because the claim is in discrete time")
            needed += motion.stays([function])
    else:
        ExpressionTable(motion.names).read(multiplier)
        needed.append(Obligation(motion.names, motion.box, change, f"({multiplier})*({function})"))
        if stays:
            needed += _inward(motion, function, listed(document["inward"]))
    check_all(needed, document["proofs"], motion.normal)


def _inward(motion: Motion, function: str, speeds: Sequence[object]) -> list[Obligation]:
    """Return the obligations that each state moves inwards on both its faces where the function is ≤ 0."""
    if len(speeds) != 2 * len(motion.states) or any(number(speed) <= 0 for speed in speeds):
        raise Rejected("'inward' is not one positive number for each face")
    needed = []
    for k, (rate, ends) in enumerate(zip(motion.rates, motion.state_box, strict=True)):
        for side, end in enumerate(ends):
            face = [*motion.box[:k], (end, end), *motion.box[k + 1 :]]
            speed = decimal_text(speeds[2 * k + side])
            sides = (rate, f"-{speed}") if side else (speed, rate)
            needed.append(Obligation(motion.names, face, *sides, [function]))
    return needed
