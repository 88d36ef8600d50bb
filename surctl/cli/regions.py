"""Region claims of `surctl verify`: names that begin with `region-`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from surctl.cli.output import progress

__all__ = ["Regions", "is_region", "prove_regions"]


class Regions(NamedTuple):
    """What the region claims came to: plain data, lines to print, whether all were proved."""

    claims: list[dict[str, Any]]
    lines: list[str]
    passed: bool


def is_region(name: str) -> bool:
    """Whether a claim's name is that of a region claim."""
    return name.startswith("region-")


def prove_regions(names: Sequence[str], *, vehicle: str, gains: str, seed: int = 0, out: Path | None = None) -> Regions:
    """Prove region claims by name, for a vehicle and a gain file; the certificates go to `out` as NAME.json.

    Raises:
        InputError: an unknown claim, vehicle or gain file, or a vehicle that the claim does not fit.
    """
    from surctl.control import load_gains
    from surctl.vehicle import load_vehicle
    from surctl.verification.region import REGION_CLAIMS, prove_region, region_claim_named

    flown, values = load_vehicle(vehicle), load_gains(gains)
    claims = [region_claim_named(name, flown, values) for name in names]
    proofs = []
    for claim in claims:
        progress(claim.name)
        proof = prove_region(claim, attempts=REGION_CLAIMS[claim.name].attempts, seed=seed)
        proofs.append(proof)
        if out is not None and proof.verdict == "proved":
            out.mkdir(parents=True, exist_ok=True)
            proof.write(out / f"{claim.name}.json")
    lines = [f"{'ok  ' if p.verdict == 'proved' else 'FAIL'} {p.claim.name:<22} {p.sentence}" for p in proofs]
    return Regions([p.to_dict() for p in proofs], lines, all(p.verdict == "proved" for p in proofs))
