"""What an exported controller says that it was made of, verified as far as that can be.

What is exported tells in `manifest.json` what it was made of: every gain, the vehicle's numbers, the hash of the law's
instructions, and hashes of all its files. Everything that can be computed anew is: the files' hashes, those of gains
and vehicle, and the id that the C source returns, which is a hash over law, period, precision, gains and initial state.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surctl.certcheck.document import LARGEST, canonical
from surctl.errors import InputError

__all__ = ["Manifest", "numbers_sha256", "read_bundle", "stated_sha256"]

MANIFEST = "manifest.json"
_STATED = ("variables", "left", "right", "constraints")


@dataclass(frozen=True)
class Manifest:
    """What an exported controller says that it was made of, verified as far as that can be.

    Attributes:
        id: of what it computes.
        real: its precision.
        period: control period [s].
        laws: hash of the instructions, then that of the same law told true positions.
        gains: numbers by name, as flown.
        vehicle: hash of the vehicle's numbers; empty if none was named.
        claims: hashes of the library's claims for these gains, by name.
        wrong: what is not as the manifest says.
        values: the vehicle's numbers by name.
        ranges: (least, largest) of those that its file gives a range; None if the manifest does not say.
    """

    id: str
    real: str
    period: float
    laws: tuple[str, str]
    gains: Mapping[str, Sequence[float]]
    vehicle: str
    claims: Mapping[str, str]
    wrong: tuple[str, ...]
    values: Mapping[str, float]
    ranges: Mapping[str, tuple[float, float]] | None


def numbers_sha256(numbers: Sequence[float]) -> str:
    """Hash of numbers to the last bit, in their order."""
    return hashlib.sha256("\n".join(float(value).hex() for value in numbers).encode()).hexdigest()


def stated_sha256(claim: Mapping[str, Any]) -> str:
    """Hash of what an inequality's claim states: variables with their ranges, both sides, constraints."""
    return hashlib.sha256(canonical({key: claim.get(key) for key in _STATED})).hexdigest()


def read_bundle(folder: Path) -> Manifest:
    """The manifest of a bundle, its files compared with it.

    Raises:
        InputError: there is no manifest, or it is none.
    """
    path = folder / MANIFEST
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(f"is larger than {LARGEST} bytes", file=path, remedy="give the folder of an export")
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", file=path, remedy="give the folder of an export"
        ) from None
    except (UnicodeDecodeError, ValueError, RecursionError):
        raise InputError("is not JSON", file=path, remedy="give the folder of an export") from None
    return read_manifest(document, folder)


def read_manifest(document: Any, folder: Path | None = None) -> Manifest:
    """The manifest as data; without a folder its files are not looked at.

    Raises:
        InputError: it is none.
    """
    try:
        law, files = document["law"], document["sha256"]
        gains = {str(row["name"]): tuple(float(v) for v in row["values"]) for row in document["gains"]["values"]}
        vehicle = document.get("vehicle") or {"sha256": "", "values": {}}
        values = {str(name): float(value) for name, value in vehicle["values"].items()}
        manifest = Manifest(
            str(document["id"]),
            str(document["real"]),
            float(document["dt_s"]),
            (str(law["sha256"]), str(law["ground_truth_sha256"])),
            gains,
            str(vehicle["sha256"]),
            {str(name): str(text) for name, text in document.get("claims", {}).items()},
            (),
            values,
            _ranges(vehicle.get("ranges")),
        )
        flat = numbers_sha256([v for row in gains.values() for v in row])
        parts = (manifest.laws[0], manifest.period.hex(), manifest.real, flat, str(law["initial_state_sha256"]))
        wrong = [] if document["gains"]["sha256"] == flat else ["the hash of the gains is not theirs"]
        if manifest.vehicle and manifest.vehicle != _vehicle_sha256(values):
            wrong.append("the hash of the vehicle is not that of its numbers")
        if manifest.id != hashlib.sha256("\n".join(parts).encode()).hexdigest():
            wrong.append("the id is not that of law, period, precision, gains and initial state")
        if folder is not None:
            wrong += _files(folder, files, f"{document['name']}.c", manifest.id)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        raise InputError(
            "is no manifest of an export, or of an older one",
            file=None if folder is None else folder / MANIFEST,
            remedy="export the controller again",
        ) from None
    return Manifest(**{**vars(manifest), "wrong": tuple(wrong)})


def _ranges(ranges: Any) -> dict[str, tuple[float, float]] | None:
    if ranges is None:
        return None
    ends = {str(name): (float(low), float(high)) for name, (low, high) in ranges.items()}
    if not all(low <= high for low, high in ends.values()):
        raise ValueError("a range is none")
    return ends


def _vehicle_sha256(values: Mapping[str, float]) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def _files(folder: Path, files: Mapping[str, str], source: str, identity: str) -> list[str]:
    """What is wrong with the files on disk."""
    wrong = []
    if source not in files:
        wrong.append(f"{source} is not listed")
    for name, digest in files.items():
        if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", name):
            raise ValueError(name)
        try:
            body = (folder / name).read_bytes()
        except OSError:
            wrong.append(f"{name} is missing")
            continue
        if hashlib.sha256(body).hexdigest() != digest:
            wrong.append(f"{name} was altered")
        elif name == source and f'return "{identity}";'.encode() not in body:
            wrong.append(f"{name} returns another id")
    return wrong
