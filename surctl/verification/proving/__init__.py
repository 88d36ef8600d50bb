"""The prover: cases, exact rewriting, interval branch and bound; what it proves it writes as a certificate."""

from surctl.verification.proving.prove import Proof, certain_excess, prove
from surctl.verification.proving.statement import Statement, statement_of

__all__ = ["Proof", "Statement", "certain_excess", "prove", "statement_of"]
