"""The prover splits a claim into cases, rewrites them exactly, and proves them by interval branch and bound."""

from surctl.verification.proving.prove import Proof, certain_excess, prove
from surctl.verification.proving.statement import Statement, statement_of

__all__ = ["Proof", "Statement", "certain_excess", "prove", "statement_of"]
