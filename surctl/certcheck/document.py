"""Certificate files: JSON with the hash of its text, numbers read exactly; size and form that are rejected."""

from __future__ import annotations

import hashlib
import json
import math
import os
import stat
from collections import Counter
from collections.abc import Iterable, Mapping
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

from surctl.errors import InputError

__all__ = [
    "FORMAT", "LARGEST", "MALFORMED", "VERSION", "Rejected", "canonical", "listed", "number", "parse", "read",
    "read_bytes", "record", "seal",
]  # fmt: skip

FORMAT, VERSION = "surctl-certificate", 2
_CHANGED = {"braking": 3}  # versions of the kinds whose format is younger
LARGEST = 8_000_000
"""Largest size of a certificate file [bytes]; a larger file is not read."""

_WHOLE = 2**53  # a larger integer may not be a double
_MEMORY = 160_000_000  # largest memory of the data of a file [bytes]
_LIST, _ENTRY = 96, 32  # memory of a list or object, and of an entry in it [bytes]
_DIGITS = 4000  # most characters of an integer
_SHOWN = 60  # most characters of a text in an error message


MALFORMED = (
    KeyError, TypeError, ValueError, IndexError, ArithmeticError, AttributeError, RecursionError, MemoryError,
)  # fmt: skip
"""Errors that data of a wrong form cause."""


class Rejected(Exception):
    """Error for a certificate that does not prove its claim; its message states the reason, without a full stop."""


def canonical(document: Mapping[str, Any]) -> bytes:
    """Return the document as UTF-8 JSON with sorted keys, no spaces and floats as `repr`, without the key `sha256`.

    Raises:
        ValueError: the document contains a NaN or an infinity, which JSON cannot represent.

    Example:
        >>> from surctl.certcheck import canonical
        >>> canonical({"kind": "interval", "bound": 0.1, "sha256": "left out"})
        b'{"bound":0.1,"kind":"interval"}'
    """
    body = {key: value for key, value in document.items() if key != "sha256"}
    text = json.dumps(body, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.encode("utf-8")


def seal(kind: str, claim: Mapping[str, Any], evidence: Mapping[str, Any]) -> dict[str, Any]:
    """Return a complete certificate: format, version, kind, claim, the entries of `evidence`, and the hash of these.

    Args:
        kind: name of the module of `surctl.certcheck` that checks this kind.
        claim: the statement that is proved, as plain data.
        evidence: the entries that only certificates of this kind have, as plain data.

    Raises:
        ValueError: the evidence uses a key that every certificate has, or contains a number that JSON cannot represent.

    Example:
        >>> from surctl.certcheck import check_document, seal
        >>> from surctl.marine.verification import claims
        >>> from surctl.verification import prove
        >>> [claim] = claims(names=["m-norm-corrected"])
        >>> proved = prove(claim).certificate
        >>> evidence = {key: proved[key] for key in proved.keys() - {"format", "version", "kind", "claim", "sha256"}}
        >>> check_document(seal("interval", proved["claim"], evidence)).accepted
        True
        >>> bolder = seal("interval", proved["claim"] | {"right": "-1"}, evidence)  # another claim, the same evidence
        >>> check_document(bolder).reason
        'the cases do not cover every choice exactly once'
    """
    frame = {"format": FORMAT, "version": _CHANGED.get(kind, VERSION), "kind": kind, "claim": dict(claim)}
    clashes = sorted(set(evidence) & {*frame, "sha256"})
    if clashes:
        raise ValueError(f"the evidence uses keys that every certificate has: {clashes}")
    document = {**frame, **evidence}
    # hash the data as a reader of the file gets them, because JSON turns tuples into lists and keys into text
    document = json.loads(canonical(document))
    return {**document, "sha256": hashlib.sha256(canonical(document)).hexdigest()}


def read(path: Path) -> dict[str, Any]:
    """Read a certificate file and verify its format, version and hash.

    Raises:
        InputError: the file cannot be read or is not a certificate.
        Rejected: the certificate was altered or damaged.
    """
    remedy = "give a certificate file"
    document = parse(read_bytes(path, LARGEST, remedy=remedy), path, remedy=remedy)
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InputError(f"is not a file of format {FORMAT!r}", file=path, remedy=remedy)
    verify_frame(document)
    return document


def parse(raw: bytes, path: object, *, remedy: str) -> Any:
    """Return the data of a JSON text (UTF-8) whose numbers are read exactly.

    A number with a point or an exponent must be the one that a double prints (`repr` in Python), in any notation: so
    the double, its text and the text that a hash covers are the same number. Integers are exact.

    Args:
        raw: the text.
        path: the file, for error messages.
        remedy: what the user can do, for error messages.

    Raises:
        InputError: the text is not JSON, a number is not exact, a key occurs twice, a text is not Unicode, or the data
            would take more than `_MEMORY` bytes.
    """
    lists, entries = raw.count(b"[") + raw.count(b"{"), raw.count(b",")
    if _LIST * lists + _ENTRY * entries > _MEMORY:
        problem = f"has {lists} lists or objects and {entries} commas, too many to be read"
        raise InputError(problem, file=path, remedy=remedy)
    try:
        text = raw.decode("utf-8")
        document = json.loads(
            text, parse_float=_exact, parse_int=_integer, parse_constant=_refuse, object_pairs_hook=_once
        )
        if "\\u" in text:  # an escape may be half a surrogate pair, which has no UTF-8
            json.dumps(document, ensure_ascii=False).encode("utf-8")
    except _Inexact:
        key, literal = _first_inexact(text)
        nearest = float(literal)
        what = f"write {nearest!r}" if math.isfinite(nearest) else "it is too large for a double"
        problem = f"{key} = {_short(literal)}: is not a number that a double prints; {what}"
        raise InputError(problem, file=path, remedy=remedy) from None
    except RecursionError:
        raise InputError("is not JSON that can be read: it is nested too deeply", file=path, remedy=remedy) from None
    except (UnicodeError, ValueError) as error:
        raise InputError(f"is not JSON: {error}", file=path, remedy=remedy) from None
    return document


def read_bytes(path: Path, largest: int, *, remedy: str) -> bytes:
    """Return the content of a regular file, which is opened and read once.

    Args:
        path: the file; a link is followed.
        largest: largest size of the file [bytes].
        remedy: what the user can do, for error messages.

    Raises:
        InputError: the file cannot be read, is not a regular file, or is larger than `largest`.
    """
    try:
        # without O_NONBLOCK, opening a FIFO waits for a writer
        at = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with os.fdopen(at, "rb") as file:
            if not stat.S_ISREG(os.fstat(at).st_mode):
                raise InputError("is not a regular file", file=path, remedy=remedy)
            body = file.read(largest + 1)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path, remedy=remedy) from None
    if len(body) > largest:
        raise InputError(f"is larger than {largest} bytes", file=path, remedy=remedy)
    return body


def verify_frame(document: Mapping[str, Any]) -> None:
    """Raise Rejected unless the document has this format, a kind in its version, a claim, and the correct hash."""
    if document.get("format") != FORMAT:
        raise Rejected(f"the format is not {FORMAT!r}")
    version, kind = document.get("version"), document.get("kind")
    if not isinstance(kind, str) or not isinstance(document.get("claim"), dict):
        raise Rejected("the key kind or claim is missing")
    known = _CHANGED.get(kind, VERSION)
    if type(version) is not int or version != known:
        only = f"this checker reads version {known} of kind {kind!r} only"
        raise Rejected(f"the version is {version!r}, but {only}: prove the claim again")
    try:
        own = hashlib.sha256(canonical(document)).hexdigest()
    except (ValueError, RecursionError) as error:  # infinity in a list, half a surrogate pair, deep nesting
        raise Rejected(f"the certificate cannot be written as canonical JSON: {error}") from None
    if document.get("sha256") != own:
        raise Rejected("the hash does not match the content: the file was altered")


def listed(value: object) -> list[Any]:
    """Return the value; raise Rejected unless it is a list."""
    if not isinstance(value, list):
        raise Rejected("a list is missing")
    return value


def record(value: object, keys: Iterable[str], where: str) -> Mapping[str, Any]:
    """Return `value` if it is a JSON object with exactly these keys; raise Rejected otherwise."""
    keys = set(keys)
    if not isinstance(value, dict) or set(value) != keys:
        actual = sorted(value) if isinstance(value, dict) else type(value).__name__
        raise Rejected(f"{where} must have exactly the keys {', '.join(sorted(keys))}, not {actual}")
    return value


def number(value: object) -> float:
    """Return a number of the document as a double; raise Rejected unless it is finite and exact."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise Rejected(f"{value!r} is not a finite number")
    if isinstance(value, int) and abs(value) > _WHOLE:
        raise Rejected("an integer is too large to be represented exactly")
    return float(value)


class _Inexact(ValueError):
    """A number that is not exactly what a double prints."""


def _exact(text: str) -> float:
    value = float(text)
    shown = repr(value)
    if text != shown:
        try:
            same = Decimal(text) == Decimal(shown)  # exact, at any size of an exponent
        except InvalidOperation:
            same = False
        if not same:
            raise _Inexact(text)
    return value


def _integer(text: str) -> int:
    if len(text) > _DIGITS:
        raise ValueError(f"an integer has {len(text)} characters, more than {_DIGITS}")
    return int(text)


def _first_inexact(text: str) -> tuple[str, str]:
    """Return the dotted key and the text of the first number of a JSON text that is not exact."""
    met: list[_Inexact] = []

    def mark(literal: str) -> object:
        try:
            return 0.0 if met else _exact(literal)
        except _Inexact as error:
            met.append(error)
            return error

    waiting = [("", json.loads(text, parse_float=mark))]
    while True:  # there is one
        key, value = waiting.pop()
        if met and value is met[0]:
            return key.lstrip("."), str(value)
        if isinstance(value, dict):
            waiting += [(f"{key}.{_short(name)}", entry) for name, entry in value.items()]
        elif isinstance(value, list):
            waiting += [(f"{key}[{k}]", entry) for k, entry in enumerate(value) if not isinstance(entry, float)]


def _short(text: str) -> str:
    text = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
    return text if text.isprintable() else ascii(text)[1:-1]


def _refuse(name: str) -> float:
    raise ValueError(f"{name} is not a JSON number")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        key, times = Counter(name for name, _ in pairs).most_common(1)[0]
        raise ValueError(f"the key '{_short(key)}' occurs {times} times")
    return table
