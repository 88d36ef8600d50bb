"""Regions of attraction with a rate, robust over the vehicle's ranges, as certificates that a checker accepts."""

from surctl.verification.region.claim import RegionClaim, region_claim
from surctl.verification.region.library import REGION_CLAIMS, RegionEntry, region_claim_named
from surctl.verification.region.proof import RegionProof, prove_region

__all__ = [
    "REGION_CLAIMS",
    "RegionClaim",
    "RegionEntry",
    "RegionProof",
    "prove_region",
    "region_claim",
    "region_claim_named",
]
