"""What an attempt at a proof came to whose certificate the independent checker decides on."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

__all__ = ["Certified"]


class _Claim(Protocol):
    @property
    def name(self) -> str:
        """Its name."""


@dataclass(frozen=True)
class Certified:
    """Verdict and certificate.

    Attributes:
        claim: what was claimed.
        verdict: `proved` if the checker accepted, else `unknown`.
        document: the certificate; empty when unknown.
        reason: why the checker did not accept; empty when proved.
    """

    claim: _Claim
    verdict: Literal["proved", "unknown"]
    document: dict[str, Any]
    reason: str

    def certificate(self) -> dict[str, Any]:
        """The certificate as plain data, ready for JSON; empty when nothing was proved."""
        return self.document

    def text(self) -> str:
        """The certificate's file."""
        return json.dumps(self.document, separators=(",", ":")) + "\n"

    def write(self, path: Path) -> None:
        """Write the certificate's file."""
        path.write_text(self.text(), encoding="utf-8")

    def decided(self) -> dict[str, Any]:
        """Claim, verdict and certificate as plain data for JSON."""
        return {
            "claim": self.claim.name,
            "expected": "proved",
            "verdict": self.verdict,
            "certificate": self.document or None,
            "remaining": self.reason or None,
        }
