"""The prover: cases, exact rewriting and interval branch and bound; it writes each proof as a certificate."""

from surctl.verification.proving.prove import Proof, certain_excess, prove
from surctl.verification.proving.statement import Statement, statement_of

__all__ = ["Proof", "Statement", "certain_excess", "prove", "statement_of"]
