"""The prover: cases, exact rewriting, interval branch and bound; what it proves it writes as a certificate."""

from surctl.verification.proving.prove import Proof, certain_excess, prove

__all__ = ["Proof", "certain_excess", "prove"]
