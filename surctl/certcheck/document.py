"""The certificate file: JSON with a hash over its own canonical text."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from surctl.errors import InputError

__all__ = ["FORMAT", "LARGEST", "VERSION", "Rejected", "canonical", "read", "seal"]

FORMAT, VERSION = "surctl-certificate", 2
LARGEST = 8_000_000
"""Most bytes of a certificate that is read."""


class Rejected(Exception):
    """The certificate does not show what it claims; the text says why, without a full stop."""


def canonical(document: Mapping[str, Any]) -> bytes:
    """UTF-8 JSON with sorted keys and no spaces, without the key `sha256`; floats as Python's `repr`.

    Raises:
        ValueError: a number that JSON does not know (NaN, infinity).

    Example:
        >>> from surctl.certcheck import canonical
        >>> canonical({"kind": "interval", "bound": 0.1, "sha256": "left out"})
        b'{"bound":0.1,"kind":"interval"}'
    """
    body = {key: value for key, value in document.items() if key != "sha256"}
    text = json.dumps(body, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.encode("utf-8")


def seal(kind: str, claim: Mapping[str, Any], evidence: Mapping[str, Any]) -> dict[str, Any]:
    """A complete certificate: format, version, kind, claim, the kind's own keys, and the hash over all of them.

    Args:
        kind: name of the module of `surctl.certcheck` that checks it.
        claim: what is proved, as plain data.
        evidence: the kind's own keys.

    Raises:
        ValueError: evidence that bears a name of the frame, or a number that JSON does not know.

    Example:
        >>> from surctl.certcheck import check_document, seal
        >>> from surctl.verification import claims, prove
        >>> [claim] = claims(names=["m-norm-corrected"])
        >>> proved = prove(claim).certificate
        >>> evidence = {key: proved[key] for key in proved.keys() - {"format", "version", "kind", "claim", "sha256"}}
        >>> check_document(seal("interval", proved["claim"], evidence)).accepted
        True
        >>> bolder = seal("interval", proved["claim"] | {"right": "-1"}, evidence)  # another claim, the same evidence
        >>> check_document(bolder).reason
        'the cases are not all choices, each once'
    """
    frame = {"format": FORMAT, "version": VERSION, "kind": kind, "claim": dict(claim)}
    clashes = sorted(set(evidence) & {*frame, "sha256"})
    if clashes:
        raise ValueError(f"evidence bears names of the frame: {clashes}")
    document = {**frame, **evidence}
    # what is hashed is what a reader of the file gets: tuples are lists, keys are text
    document = json.loads(canonical(document))
    return {**document, "sha256": hashlib.sha256(canonical(document)).hexdigest()}


def read(path: Path) -> dict[str, Any]:
    """The document, with format, version and hash verified.

    Raises:
        InputError: a file that cannot be read, or is no certificate at all.
        Rejected: a certificate that was altered or damaged.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(f"is larger than {LARGEST} bytes", file=path, remedy="give a certificate")
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path, remedy="check the path") from None
    try:
        document = json.loads(raw.decode("utf-8"), parse_constant=_refuse, object_pairs_hook=_once)
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        raise InputError(f"is not JSON: {error}", file=path, remedy="give a certificate") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InputError(f"is not of format {FORMAT!r}", file=path, remedy="give a certificate")
    verify_frame(document)
    return document


def verify_frame(document: Mapping[str, Any]) -> None:
    """Raise Rejected unless the frame is of this version, complete, and the hash is the document's own."""
    if document.get("format") != FORMAT:
        raise Rejected(f"the format is not {FORMAT!r}")
    version = document.get("version")
    if type(version) is not int or version != VERSION:
        raise Rejected(f"version {version!r} is not the version {VERSION} that this checker knows")
    if not isinstance(document.get("kind"), str) or not isinstance(document.get("claim"), dict):
        raise Rejected("kind or claim is missing")
    try:
        own = hashlib.sha256(canonical(document)).hexdigest()
    except (ValueError, RecursionError) as error:  # an infinity inside a list, half a surrogate pair, a deep nest
        raise Rejected(f"it has no canonical text: {error}") from None
    if document.get("sha256") != own:
        raise Rejected("the hash is not that of the content: the file was altered")


def _refuse(name: str) -> float:
    raise ValueError(f"{name} is no number")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        raise ValueError("a key stands twice")
    if any(isinstance(v, float) and not math.isfinite(v) for v in table.values()):
        raise ValueError("a number is not finite")
    return table
