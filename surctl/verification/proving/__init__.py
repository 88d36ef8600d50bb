"""The prover splits a claim into cases, rewrites them exactly, and proves them by interval branch and bound."""

from surctl.verification.formula import Statement
from surctl.verification.proving.forms import statement_of
from surctl.verification.proving.prove import Cases, Proof, certain_excess, prove, prove_by_boxes, prove_cases
from surctl.verification.proving.touching import range_at, vanishes

__all__ = [
    "Cases", "Proof", "Statement", "certain_excess", "prove", "prove_by_boxes", "prove_cases", "range_at",
    "statement_of", "vanishes",
]  # fmt: skip
