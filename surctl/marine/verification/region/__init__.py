"""Proofs of regions of attraction with a decay rate, robust over the vehicle's parameter ranges, as certificates."""

from surctl.marine.verification.region.library import (
    REGION_CLAIMS,
    applicable_region,
    prove_statement,
    refused_regions,
    region_statement,
)
from surctl.marine.verification.region.proof import RegionProof, prove_steering, prove_turning
from surctl.marine.verification.region.statement import RegionStatement, load_region, write_region
from surctl.marine.verification.region.steering import SteeringClaim
from surctl.marine.verification.region.turning import TurningClaim

__all__ = [
    "REGION_CLAIMS", "RegionProof", "RegionStatement", "SteeringClaim", "TurningClaim",
    "applicable_region", "load_region", "prove_statement",
    "prove_steering", "prove_turning", "refused_regions", "region_statement", "write_region",
]  # fmt: skip
