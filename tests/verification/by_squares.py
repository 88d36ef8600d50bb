"""Certificates whose cases are proved by sums of squares, also where intervals would do."""

import importlib
from typing import Any

import pytest

from surctl.verification import Claim, prove
from surctl.verification.proving import Proof

PROVER = importlib.import_module("surctl.verification.proving.prove")


def squares_first(claim: Claim, *, time_limit: float = 60.0) -> Proof:
    """The proof of a prover that tries sums of squares before any box."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PROVER, "_EXACT_SHORT", 0)
        patch.setattr(PROVER, "_EXACT_ROUNDS", PROVER._EXACT_ROUNDS[:1])
        return prove(claim, time_limit=time_limit)


def certificate(claim: Claim) -> dict[str, Any]:
    """A certificate by sums of squares; the test fails if there is none."""
    proof = squares_first(claim)
    assert proof.certificate is not None, (claim.name, proof.remaining)
    assert any("squares" in case for case in proof.certificate["cases"]), claim.name
    return proof.certificate
