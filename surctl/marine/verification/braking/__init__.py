"""Certificates about braking before obstacles, for the braking rule alone and for the guarded law's speed bound."""

from surctl.marine.verification.braking.claim import BrakingClaim, law_numbers
from surctl.marine.verification.braking.library import BRAKING_CLAIMS, BrakingStatement, braking_claim_named
from surctl.marine.verification.braking.proof import BrakingProof, prove_braking

__all__ = [
    "BRAKING_CLAIMS", "BrakingClaim", "BrakingProof", "BrakingStatement", "braking_claim_named", "law_numbers",
    "prove_braking",
]  # fmt: skip
