"""The independent checker of certificates: shares no code with the provers and knows nothing of CasADi.

A certificate is one JSON file: `format`, `version`, `kind`, `claim`, the kind's own keys, and `sha256`, the hash of
the canonical JSON (sorted keys, no spaces, UTF-8, floats as `repr`) without that key. Each kind is a module of this
package with `check(document) -> None`, which raises `Rejected(reason)`.

A certificate that was altered is rejected by its hash. With the hash mended it is another certificate, of another
claim: it is rejected unless the mathematics proves that claim. A false claim is never accepted; one that is altered
and still true may be. What a file holds costs at most `PATIENCE` seconds and some 400 MB.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surctl.certcheck.document import Rejected, canonical, read, seal, verify_frame
from surctl.certcheck.patience import PATIENCE, patient

__all__ = ["KINDS", "PATIENCE", "Checked", "Rejected", "canonical", "check_document", "check_file", "seal"]

KINDS = ("braking", "heading", "interval", "region")
"""Kinds of certificate, each a module of this package."""

_MALFORMED = (
    KeyError, TypeError, ValueError, IndexError, ArithmeticError, AttributeError, RecursionError, MemoryError,
)  # fmt: skip
_LONGEST = 400  # characters of a reason


@dataclass(frozen=True)
class Checked:
    """What the checker says of one certificate.

    Attributes:
        accepted: whether the certificate proves its claim.
        reason: why not; empty when accepted.
        kind: its kind; empty when even that cannot be read.
        claim: the claim as plain data.
        seconds: time it took [s].
        proves: what an accepted inequality amounts to, in words; empty for other kinds, and when rejected.
        slack: how far left may exceed right of an inequality, in the claim's unit; 0 for other kinds.
    """

    accepted: bool
    reason: str
    kind: str
    claim: Mapping[str, Any]
    seconds: float
    proves: str = ""
    slack: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "accepted": self.accepted, "reason": self.reason, "kind": self.kind,
            "claim": dict(self.claim), "seconds": self.seconds, "proves": self.proves, "slack": self.slack,
        }  # fmt: skip


def check_file(path: str | Path, *, time_limit: float = PATIENCE) -> Checked:
    """Check one certificate: format and hash first, then the mathematics.

    Args:
        path: the file.
        time_limit: processor time [s] after which it is rejected.

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
    return check_document(document, began=began, time_limit=time_limit)


def check_document(document: Mapping[str, Any], *, began: float | None = None, time_limit: float = math.inf) -> Checked:
    """As `check_file`, of a document in memory; `seconds` counts from `began`, a reading of perf_counter.

    There is no limit of time [s] unless one is given: it is meant for what the caller has proved.

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
    claim = claim if isinstance(claim, dict) else {}
    try:
        with patient(time_limit), np.errstate(all="ignore"):  # what is no number proves nothing
            verify_frame(document)
            _checker(kind)(document)
    except Rejected as rejected:
        reason = str(rejected) or "rejected without a reason"
    except _MALFORMED as error:
        reason = f"the certificate is malformed: {type(error).__name__}: {error}"
    else:
        slack = float(claim.get("slack", 0.0))
        return Checked(True, "", kind, claim, time.perf_counter() - began, _proves(kind, claim), slack)
    reason = reason if len(reason) <= _LONGEST else f"{reason[:_LONGEST]} ..."
    return Checked(False, reason, kind, claim, time.perf_counter() - began)


def _proves(kind: str, claim: Mapping[str, Any]) -> str:
    """What was shown; words of a file are not part of it."""
    if kind != "interval":
        return ""
    if not claim["slack"]:
        return "left <= right on the whole domain, exactly"
    slack = f"{claim['slack']:g} {claim['unit']}"
    return (
        f"left <= right + {slack} on the whole domain, not left <= right: proved to within {slack}; "
        "a rate that may be positive by that much is no proof of asymptotic stability"
    )


def _checker(kind: str) -> Any:
    name = f"{__name__}.{kind}"
    # the name comes from a file: only what is listed is ever imported
    if kind not in KINDS or not re.fullmatch(r"[a-z_]+", kind) or importlib.util.find_spec(name) is None:
        raise Rejected(f"kind {kind!r} is not one that this checker knows")
    return importlib.import_module(name).check
