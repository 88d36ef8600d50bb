"""The result of an attempted proof that the independent checker has checked."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol


class _Claim(Protocol):
    @property
    def name(self) -> str:
        """The name of the claim."""


@dataclass(frozen=True)
class Certified:
    """A claim with its verdict and its certificate.

    Attributes:
        claim: the claim.
        verdict: `proved` if the checker accepted the certificate, otherwise `unknown`.
        document: the certificate; empty if the verdict is `unknown`.
        reason: reason why the claim is not proved; empty if the verdict is `proved`.
    """

    claim: _Claim
    verdict: Literal["proved", "unknown"]
    document: dict[str, Any]
    reason: str

    def certificate(self) -> dict[str, Any]:
        """The certificate as plain data for JSON; empty if the claim is not proved."""
        return self.document

    def text(self) -> str:
        """The certificate as the text of a file."""
        return json.dumps(self.document, separators=(",", ":")) + "\n"

    def write(self, path: Path) -> None:
        """Write the certificate file."""
        path.write_text(self.text(), encoding="utf-8")

    def decided(self) -> dict[str, Any]:
        """The claim's name, the verdict and the certificate as plain data for JSON."""
        return {
            "claim": self.claim.name,
            "expected": "proved",
            "verdict": self.verdict,
            "certificate": self.document or None,
            "remaining": self.reason or None,
        }
