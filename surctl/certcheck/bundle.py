"""Reader of the manifest of an exported controller; it verifies every entry that it can recompute.

The export writes `manifest.json`, which lists the content of the bundle: every gain, the vehicle's parameters, the hash
of the law's instruction list, and the hashes of all files. This module recomputes the hashes of the files, of the gains
and of the vehicle, and the id that the C source returns (a hash of law, period, precision, gains and initial state).
"""

from __future__ import annotations

import hashlib
import json
import re
import struct
import zlib
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
    """The manifest of an exported controller, after its comparison with the exported files.

    Attributes:
        id: hash of the law, its period, its precision, its gains and its initial state.
        real: floating-point precision of the exported code.
        period: control period [s].
        laws: two hashes: of the law's instruction list, and of the instruction list of the same law with true obstacle
            positions as input.
        gains: values of the exported gains by name.
        vehicle: hash of the vehicle's parameters; empty if the export names no vehicle.
        claims: for each claim of the library about the exported gains, its hash by its name.
        wrong: one message for each entry of the manifest that is false.
        values: values of the vehicle's parameters by name.
        ranges: (least, largest) value, by name, of each vehicle parameter for which the vehicle file gives a range;
            None if the manifest states no ranges.
        gains_id: id of law and gains, which the C function `gains_id` returns for the gains that the robot uses.
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
    gains_id: str = ""


def numbers_sha256(numbers: Sequence[float]) -> str:
    """Return the SHA-256 of a sequence of numbers; it changes with every bit of a number and with their order."""
    return hashlib.sha256("\n".join(float(value).hex() for value in numbers).encode()).hexdigest()


def stated_sha256(claim: Mapping[str, Any]) -> str:
    """Return the SHA-256 of an inequality's statement (variables with their ranges, both sides, and constraints)."""
    return hashlib.sha256(canonical({key: claim.get(key) for key in _STATED})).hexdigest()


def read_bundle(folder: Path) -> Manifest:
    """Read the manifest of a bundle and compare the bundle's files with it.

    Raises:
        InputError: the folder has no manifest, or the file is not a manifest.
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
    """Read a manifest from plain data; if a folder is given, compare the exported files with the manifest.

    Raises:
        InputError: the data are not a manifest.
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
            str(document["gains"]["id"]),
        )
        numbers = [v for row in gains.values() for v in row]
        flat = numbers_sha256(numbers)
        parts = (manifest.laws[0], manifest.period.hex(), manifest.real, flat, str(law["initial_state_sha256"]))
        wrong = [] if document["gains"]["sha256"] == flat else ["the stated hash of the gains is wrong"]
        if manifest.vehicle and manifest.vehicle != _vehicle_sha256(values):
            wrong.append("the stated hash of the vehicle is wrong")
        if manifest.gains_id != _gains_id(parts, numbers, manifest.real):
            wrong.append("the stated id of law and gains is wrong")
        if manifest.id != hashlib.sha256("\n".join(parts).encode()).hexdigest():
            wrong.append("the id does not match law, period, precision, gains and initial state")
        if folder is not None:
            wrong += _files(folder, files, f"{document['name']}.c", manifest.id)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        raise InputError(
            "is not the manifest of an export, or an older version wrote it",
            file=None if folder is None else folder / MANIFEST,
            remedy="export the controller again",
        ) from None
    return Manifest(**{**vars(manifest), "wrong": tuple(wrong)})


def _ranges(ranges: Any) -> dict[str, tuple[float, float]] | None:
    if ranges is None:
        return None
    ends = {str(name): (float(low), float(high)) for name, (low, high) in ranges.items()}
    if not all(low <= high for low, high in ends.values()):
        raise ValueError("the lower end of a range exceeds its upper end")
    return ends


def _vehicle_sha256(values: Mapping[str, float]) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def _gains_id(parts: Sequence[str], numbers: Sequence[float], real: str) -> str:
    """Return the id that the C function `gains_id` computes: the CRC-32 of the gains as `gains_save` stores them."""
    key = hashlib.sha256("\n".join((*parts[:3], parts[4])).encode()).digest()[:8]
    letter, width = {"float64": ("d", 8), "float32": ("f", 4)}[real]
    stored = (
        b"SURG" + struct.pack("<HHI", 1, width, len(numbers)) + key + struct.pack(f"<{len(numbers)}{letter}", *numbers)
    )
    return f"{zlib.crc32(stored):08x}"


def _files(folder: Path, files: Mapping[str, str], source: str, identity: str) -> list[str]:
    """Return one message for each file that is missing or differs from the manifest."""
    wrong = []
    if source not in files:
        wrong.append(f"the manifest does not list {source}")
    for name, digest in files.items():
        if not all(re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", part) for part in name.split("/")):
            raise ValueError(name)
        try:
            body = (folder / name).read_bytes()
        except OSError:
            wrong.append(f"{name} is missing")
            continue
        if hashlib.sha256(body).hexdigest() != digest:
            wrong.append(f"{name} was altered")
        elif name == source and f'return "{identity}";'.encode() not in body:
            wrong.append(f"{name} returns an id that is not the manifest's")
    return wrong
