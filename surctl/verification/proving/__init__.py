"""The prover splits a claim into cases, rewrites them exactly, and proves them by interval branch and bound."""

from surctl.verification.proving.prove import Proof, certain_excess, prove
from surctl.verification.proving.statement import Statement, statement_of
from surctl.verification.proving.touching import range_at, vanishes

__all__ = ["Proof", "Statement", "certain_excess", "prove", "range_at", "statement_of", "vanishes"]
