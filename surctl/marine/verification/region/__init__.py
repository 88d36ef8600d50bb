"""Proofs of regions of attraction with a decay rate, robust over the vehicle's parameter ranges, as certificates."""

from surctl.marine.verification.region.claim import RegionClaim, region_claim
from surctl.marine.verification.region.heading import HeadingClaim, heading_claim
from surctl.marine.verification.region.heading_proof import prove_heading
from surctl.marine.verification.region.library import (
    REGION_CLAIMS,
    applicable_region,
    prove_statement,
    refused_regions,
    region_statement,
)
from surctl.marine.verification.region.proof import RegionProof, prove_region, prove_turning
from surctl.marine.verification.region.statement import RegionStatement, load_region, write_region
from surctl.marine.verification.region.steering import SteeringClaim, steering_claim
from surctl.marine.verification.region.steering_proof import prove_steering
from surctl.marine.verification.region.turning import TurningClaim, turning_claim

__all__ = [
    "REGION_CLAIMS", "HeadingClaim", "RegionClaim", "RegionProof", "RegionStatement", "SteeringClaim", "TurningClaim",
    "applicable_region", "heading_claim", "load_region", "prove_heading", "prove_region", "prove_statement",
    "prove_steering", "prove_turning", "refused_regions", "region_claim", "region_statement", "steering_claim",
    "turning_claim", "write_region",
]  # fmt: skip
