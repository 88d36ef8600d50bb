"""The independent checker of certificates: it imports none of the provers' code and does not use CasADi.

A certificate is one JSON file. It has the keys `format`, `version`, `kind`, `claim` and `sha256`, and further keys that
depend on its kind. The hash `sha256` covers the canonical JSON (sorted keys, no spaces, UTF-8, floats as `repr`) of all
other keys. For each kind of certificate, this package has a module with a function `check(document) -> None`, which
raises `Rejected(reason)`.

A certificate whose content does not match its hash is rejected. If someone alters the content and recomputes the hash,
the file becomes a certificate of a different claim, and the checker rejects the file unless its content proves this
different claim. So a false claim is never accepted, but an altered claim that is still true may be accepted. The check
of a file is limited to `PATIENCE` seconds of processor time and to `MEMORY` bytes of intermediate results: a process
that checks a file below 100 kB needs at most 100 MB, and 400 MB for a larger file.
"""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from surctl.certcheck.document import MALFORMED, Rejected, canonical, read, seal, verify_frame
from surctl.certcheck.elementary import Undefined
from surctl.certcheck.emptiness import is_empty
from surctl.certcheck.interval import variables_of
from surctl.certcheck.patience import MEMORY, PATIENCE, patient

__all__ = ["KINDS", "MEMORY", "PATIENCE", "Checked", "Rejected", "canonical", "check_document", "check_file", "seal"]

KINDS = ("barrier", "braking", "interval", "lyapunov", "mission", "turning")
"""The kinds of certificate; each kind is a module of this package."""

_LONGEST = 400  # largest number of characters of `reason`


@dataclass(frozen=True)
class Checked:
    """The checker's result for one certificate.

    Attributes:
        accepted: whether the certificate proves its claim.
        reason: why the certificate is rejected; empty if the certificate is accepted.
        kind: kind of the certificate; empty if the kind cannot be read.
        claim: the certificate's claim, as plain data (dicts, lists, numbers, text).
        seconds: duration of the check [s].
        proves: sentence that states what an accepted inequality proves; empty for other kinds of certificate and for a
            rejected certificate.
        vacuous: why an accepted claim says nothing, such as "no point of the box satisfies the constraints"; empty if
            nothing shows that.
        slack: tolerance of an accepted inequality (left side ≤ right side + slack), in the claim's unit; 0 for other
            kinds of certificate.
    """

    accepted: bool
    reason: str
    kind: str
    claim: Mapping[str, Any]
    seconds: float
    proves: str = ""
    slack: float = 0.0
    vacuous: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        return {
            "accepted": self.accepted, "reason": self.reason, "kind": self.kind,
            "claim": dict(self.claim), "seconds": self.seconds, "proves": self.proves, "slack": self.slack,
            "vacuous": self.vacuous,
        }  # fmt: skip


def check_file(path: str | Path, *, time_limit: float = PATIENCE) -> Checked:
    """Check a certificate file: first its format and hash, then its proof.

    Args:
        path: the certificate file.
        time_limit: processor time [s] after which the certificate is rejected.

    Raises:
        InputError: the file cannot be read or is not a certificate.

    Example:
        >>> import json
        >>> from pathlib import Path
        >>> from surctl.certcheck import check_file
        >>> from surctl.marine.verification import claims
        >>> from surctl.verification import prove
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
    """Check a certificate in memory: first its format and hash, then its proof.

    Args:
        document: the certificate.
        began: value of `time.perf_counter` at which the reported duration starts; None means the time of the call.
        time_limit: processor time [s] after which the certificate is rejected; by default there is no limit, because
            the document usually comes from the caller's own proof.

    Example:
        >>> from surctl.certcheck import check_document
        >>> from surctl.marine.verification import claims
        >>> from surctl.verification import prove
        >>> [claim] = claims(names=["m-norm-corrected"])
        >>> certificate = prove(claim).certificate
        >>> check_document(certificate).accepted
        True
        >>> check_document(certificate | {"claim": {}}).reason
        'the hash does not match the content: the file was altered'
    """
    began = time.perf_counter() if began is None else began
    kind, claim = document.get("kind"), document.get("claim")
    kind = kind if isinstance(kind, str) else ""
    claim = claim if isinstance(claim, dict) else {}
    try:
        with patient(time_limit), np.errstate(all="ignore"):  # a comparison with NaN is false, so NaN proves nothing
            verify_frame(document)
            _checker(kind)(document)
            vacuous = _vacuous(kind, claim)
    except Rejected as rejected:
        reason = str(rejected) or "rejected without a reason"
    except (*MALFORMED, Undefined) as error:
        reason = f"the certificate is malformed: {type(error).__name__}: {error}"
    else:
        slack, proves = float(claim.get("slack", 0.0)), _proves(kind, claim)
        return Checked(True, "", kind, claim, time.perf_counter() - began, proves, slack, vacuous)
    reason = reason if len(reason) <= _LONGEST else f"{reason[:_LONGEST]} ..."
    return Checked(False, reason, kind, claim, time.perf_counter() - began)


def _vacuous(kind: str, claim: Mapping[str, Any]) -> str:
    """Return why an accepted claim says nothing; empty if a set that it is about may have a point."""
    if kind == "interval":
        names, box = variables_of(claim["variables"])
        empty = is_empty(names, box, claim["constraints"])
        if empty is None:
            return "perhaps, as no point of the box is known that satisfies the constraints"
        return "no point of the box satisfies the constraints" if empty else ""
    if kind == "barrier":
        names, box = variables_of(claim["states"])
        sets = [name for name in ("initial", "unsafe") if is_empty(names, box, claim[name])]
        return " and ".join(f"the {name} set has no point in the box" for name in sets)
    return ""


def _proves(kind: str, claim: Mapping[str, Any]) -> str:
    """Return a sentence that states what an accepted inequality proves."""
    if kind in ("barrier", "lyapunov"):
        return _proves_motion(claim)
    if kind == "mission":
        start, motion = claim["start"], claim["motion"]
        (along, across), how = start["within_m"], "at rest" if start["at_rest"] else "with the target's velocity"
        return (
            f"a robot that begins {how}, within {along:g} m along and {across:g} m across the path at its start, stays "
            f"within {max(motion['tube_m']):g} m of the path, and is within {motion['goal_m']:g} m of its end when the "
            "target reaches it"
        )
    if kind != "interval":
        return ""
    if not claim["slack"]:
        return "left <= right on the whole domain, exactly"
    slack = f"{claim['slack']:g} {claim['unit']}"
    return (
        f"left <= right + {slack} on the whole domain: left <= right is proved to within {slack}; "
        "a rate that may be positive by that much is no proof of asymptotic stability"
    )


def _proves_motion(claim: Mapping[str, Any]) -> str:
    """Return a sentence that states what an accepted claim about solutions proves."""
    discrete = claim["time"] == "discrete"
    if claim["property"] == "safety":
        if claim.get("stays"):
            return "no solution that starts in the initial set in the box leaves the box or reaches the unsafe set"
        return "as long as it stays in the box, no solution that starts in the initial set reaches the unsafe set"
    region = f"every solution that starts in the box where V < {claim['level']:g} stays there"
    if claim["time"] == "sampled":
        held = f"sampled every {claim['period_s']:g} s with held commands"
        region = f"{held}: every solution that starts at an instant where V < {claim['level']:g} stays in the box"
    if claim["property"] == "bound":
        return f"{region}, and V decays to the stated bound"
    goal, about = "the equilibrium", ""
    if "radius" in claim:
        at, about = claim["equilibrium"], " about the equilibrium"
        box = ", ".join(f"{name} = {float(Fraction(at[name])):g} ± {r:g}" for name, r in claim["radius"].items())
        varies = any(row["lower"] < row["upper"] for row in claim["parameters"])
        inside = f"the box {box} and, with constant parameters, to the equilibrium in this box"
        goal = inside if varies else f"the equilibrium at {box}"
        if claim.get("constant"):
            goal = f"the equilibrium of its parameters, which are constant, at {box}"
    if claim["rate"] is None:
        return f"{region} and converges to {goal}, which is asymptotically stable"
    pace = (
        f"falls by at least {claim['rate']:g} of its value in every step"
        if discrete
        else f"falls by at least {claim['rate']:g} of its value in every period"
        if claim["time"] == "sampled"
        else (f"decays at least as exp(-{claim['rate']:g} t)")
    )
    return f"{region} and converges to {goal}: V{about} {pace}"


def _checker(kind: str) -> Any:
    # the kind comes from a file: import listed modules only
    if kind not in KINDS:
        raise Rejected(f"the kind {kind!r} is not known to this checker")
    return importlib.import_module(f"{__name__}.{kind}").check
