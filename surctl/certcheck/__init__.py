"""The independent checker of certificates: shares no code with the provers and knows nothing of CasADi.

A certificate is one JSON file: `format`, `version`, `kind`, `claim`, the kind's own keys, and `sha256`, the hash of
the canonical JSON (sorted keys, no spaces, UTF-8, floats as `repr`) without that key. Each kind is a module of this
package with `check(document) -> None`, which raises `Rejected(reason)`.

A certificate that was altered is rejected by its hash. With the hash mended it is another certificate, of another
claim: it is rejected unless the mathematics proves that claim. A false claim is never accepted; one that is altered
and still true may be.
"""

from __future__ import annotations

import importlib
import importlib.util
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surctl.certcheck.document import Rejected, canonical, read, seal, verify_frame

__all__ = ["KINDS", "Checked", "Rejected", "canonical", "check_document", "check_file", "seal"]

KINDS = ("braking", "heading", "interval", "region")
"""Kinds of certificate, each a module of this package."""


@dataclass(frozen=True)
class Checked:
    """What the checker says of one certificate.

    Attributes:
        accepted: whether the certificate proves its claim.
        reason: why not; empty when accepted.
        kind: its kind; empty when even that cannot be read.
        claim: the claim as plain data.
        seconds: time it took [s].
    """

    accepted: bool
    reason: str
    kind: str
    claim: Mapping[str, Any]
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "accepted": self.accepted, "reason": self.reason, "kind": self.kind,
            "claim": dict(self.claim), "seconds": self.seconds,
        }  # fmt: skip


def check_file(path: str | Path) -> Checked:
    """Check one certificate: format and hash first, then the mathematics.

    Raises:
        InputError: the file cannot be read, or is no certificate at all.

    Example:
        >>> import json
        >>> from pathlib import Path
        >>> from surctl.certcheck import check_file
        >>> from surctl.verification import claims, prove
        >>> [claim] = claims(names=["m-norm-corrected"])
        >>> _ = Path("m-norm.json").write_text(json.dumps(prove(claim).certificate))
        >>> checked = check_file("m-norm.json")
        >>> checked.accepted, checked.kind, checked.claim["name"]
        (True, 'interval', 'm-norm-corrected')
    """
    began = time.perf_counter()
    try:
        document = read(Path(path))
    except Rejected as reason:
        return Checked(False, str(reason), "", {}, time.perf_counter() - began)
    return check_document(document, began=began)


def check_document(document: Mapping[str, Any], *, began: float | None = None) -> Checked:
    """As `check_file`, of a document in memory; `seconds` counts from `began`, a reading of perf_counter.

    Example:
        >>> from surctl.certcheck import check_document
        >>> from surctl.verification import claims, prove
        >>> [claim] = claims(names=["m-norm-corrected"])
        >>> certificate = prove(claim).certificate
        >>> check_document(certificate).accepted
        True
        >>> check_document(certificate | {"claim": {}}).reason
        'the hash is not that of the content: the file was altered'
    """
    began = time.perf_counter() if began is None else began
    kind, claim = document.get("kind"), document.get("claim")
    kind = kind if isinstance(kind, str) else ""
    reason = ""
    try:
        verify_frame(document)
        _checker(kind)(document)
    except Rejected as rejected:
        reason = str(rejected) or "rejected without a reason"
    return Checked(not reason, reason, kind, claim if isinstance(claim, dict) else {}, time.perf_counter() - began)


def _checker(kind: str) -> Any:
    name = f"{__name__}.{kind}"
    # the name comes from a file: only what is listed is ever imported
    if kind not in KINDS or not re.fullmatch(r"[a-z_]+", kind) or importlib.util.find_spec(name) is None:
        raise Rejected(f"kind {kind!r} is not one that this checker knows")
    return importlib.import_module(name).check
