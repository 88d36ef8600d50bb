"""Reader of the folder of an exported controller; it verifies each hash and entry of the manifest that it can.

The export writes `manifest.json`, which lists the content of the bundle: every gain, the vehicle's parameters, the
instruction lists of the law (and of the plant of a user) with the names and units of their vectors, and the hashes of
all files; `seal` is the hash of the manifest itself. This module recomputes the seal, the hashes of the files, of the
gains and of the vehicle, the digests of the instruction lists, and the id that the C source returns (a hash of law,
period, precision, gains and initial state).

Every file is read once, and only if it is a regular file. A file that the manifest does not list is an error, except
for results of a compiler, which are named.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

from surctl.certcheck.document import LARGEST, canonical, parse, read_bytes
from surctl.certcheck.instructions import digest
from surctl.errors import InputError

__all__ = ["Listed", "Manifest", "Port", "manifest_seal", "numbers_sha256", "places", "ports_sha256",
           "read_bundle", "read_manifest", "stated_sha256"]  # fmt: skip

MANIFEST, LAW = "manifest.json", "law.txt"
FORMAT_VERSION = 2  # of the manifest and of what it lists
_LARGEST = 32_000_000  # [bytes] of one file
_MOST = 2000  # files and folders
_DEEPEST = 6  # folders inside one another
_LONGEST = 200_000  # numbers of all vectors of the instruction lists
_OBJECTS = (".o", ".obj", ".a", ".lib", ".so", ".dylib", ".dll", ".exe", ".elf", ".pyc")
_PROGRAMS = (b"\x7fELF", b"MZ", b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe")  # first bytes of an executable
_NUMBERS = {"initial_state": "state", "values": "parameters"}
"""Entries of an instruction list that are numbers, with the vector whose values they are."""

_REMEDY = "give the folder of an export"


@dataclass(frozen=True)
class Port:
    """A named part of a vector of an instruction list."""

    name: str
    size: int
    unit: str


def places(ports: Sequence[Port]) -> dict[str, slice]:
    """Return the place of each part of a vector by its name."""
    ends = [0, *accumulate(port.size for port in ports)]
    return {port.name: slice(*pair) for port, pair in zip(ports, pairwise(ends), strict=True)}


@dataclass(frozen=True)
class Listed:
    """An instruction list of the bundle.

    Attributes:
        text: the list, as `surctl.certcheck.instructions` reads it.
        vectors: ports of each vector that it reads or computes, by the name in the manifest.
        numbers: values of vectors (initial state, parameters), by the name in the manifest.
    """

    text: str
    vectors: Mapping[str, tuple[Port, ...]]
    numbers: Mapping[str, tuple[float, ...]]


@dataclass(frozen=True)
class Manifest:
    """The manifest of an exported controller, after its comparison with the exported files.

    Attributes:
        id: hash of the law, the ports of its vectors, its period, its precision, its gains and its initial state.
        real: floating-point precision of the exported code.
        period: control period [s].
        laws: two digests: of the law's instruction list, and of the instruction list of the same law with true obstacle
            positions as input.
        gains: values of the exported gains by name.
        vehicle: hash of the vehicle's parameters; empty if the export names no vehicle.
        claims: for each claim of the library about the exported gains, its hash by its name.
        wrong: one message for each entry of the manifest that is false.
        values: values of the vehicle's parameters by name.
        ranges: (least, largest) value, by name, of each vehicle parameter for which the vehicle file gives a range;
            None if the manifest states no ranges.
        gains_id: id of law and gains, which the C function `gains_id` returns for the gains that the robot uses.
        lists: the instruction lists by digest.
        extra: names of results of a compiler in the folder.
        fins: what the vehicle's fins do at the cruise speed, by name: `moment_nm`, and `side_per_m` if it is fixed;
            empty without fins.
        reference: references at the start of the replayed run of a system of the user's own, or None.
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
    lists: Mapping[str, Listed] = field(default_factory=dict)
    extra: tuple[str, ...] = ()
    fins: Mapping[str, float] = field(default_factory=dict)
    reference: tuple[float, ...] | None = None


def numbers_sha256(numbers: Sequence[float]) -> str:
    """Return the SHA-256 of a sequence of numbers; it changes with every bit of a number and with their order."""
    return hashlib.sha256("\n".join(float(value).hex() for value in numbers).encode()).hexdigest()


def ports_sha256(entry: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the names, sizes and units of the vectors of a list, from its entry in the manifest."""
    return hashlib.sha256(canonical({k: v for k, v in entry.items() if k not in ("sha256", *_NUMBERS)})).hexdigest()


def stated_sha256(claim: Mapping[str, Any]) -> str:
    """Return the SHA-256 of an inequality's statement, which covers every entry of the claim but the slack."""
    return hashlib.sha256(canonical({"claim": {k: v for k, v in claim.items() if k != "slack"}})).hexdigest()


def manifest_seal(manifest: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a manifest without its seal."""
    return hashlib.sha256(canonical({"manifest": {k: v for k, v in manifest.items() if k != "seal"}})).hexdigest()


def read_bundle(folder: Path) -> Manifest:
    """Read the manifest of a bundle and compare the bundle's files with it.

    Raises:
        InputError: the folder has no manifest, the file is not a manifest, or an older version wrote it.
    """
    path = folder / MANIFEST
    problems, names = _walked(folder)
    wrong = [f"{name} is {what}" for name, what in problems.items()]
    raw = read_bytes(path, LARGEST, remedy=_REMEDY)
    document = parse(raw, path, remedy=_REMEDY)
    if isinstance(document, dict) and "gains" in document and document.get("format_version") != FORMAT_VERSION:
        stated = str(document.get("format_version", "none"))[:20]
        problem = f"this version of surctl reads format version {FORMAT_VERSION} of a bundle only"
        raise InputError(problem, file=path, key="format_version", value=stated, remedy="export the controller again")
    try:
        if document["seal"] != manifest_seal(document):
            wrong.append("the manifest was altered: its seal does not match")
        files, source = document["sha256"], f"{_text(document['name'])}.c"
        wrong += [f"the manifest does not list {name}" for name in (source, LAW) if name not in files]
        texts, extra = dict[str, str](), []
        returned = f'return "{document["id"]}";'.encode()
        for name, stated in files.items():
            if not all(re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", part) for part in name.split("/")):
                raise ValueError(name)
            if name not in names:
                wrong += [] if name in problems else [f"{name} is missing"]
                continue
            body = read_bytes(folder / name, _LARGEST, remedy=_REMEDY)
            if hashlib.sha256(body).hexdigest() != stated:
                wrong.append(f"{name} was altered")
            elif name in document["lists"]:
                texts[name] = body.decode()
                if sum(map(len, texts.values())) > LARGEST:
                    raise InputError(f"has instruction lists of more than {LARGEST} bytes", file=folder, remedy=_REMEDY)
            elif name == source and returned not in body:
                wrong.append(f"{name} returns an id that is not the manifest's")
        for name in sorted(names - files.keys() - {MANIFEST}):
            if _compiled(folder / name):
                extra.append(name)
            else:
                wrong.append(f"{name} is not part of the export: remove it, or build in another folder")
        manifest = read_manifest(document, texts, path)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError):
        raise _no_manifest(path) from None
    return replace(manifest, wrong=(*wrong, *manifest.wrong), extra=tuple(extra))


def read_manifest(document: Any, texts: Mapping[str, str], path: Path | None = None) -> Manifest:
    """Read a manifest from plain data.

    Args:
        document: the manifest.
        texts: text of each instruction list by file name; one that is missing was already reported.
        path: the file, for error messages.

    Raises:
        InputError: the data are not a manifest.
    """
    try:
        law = document["law"]
        gains = {_text(row["name"]): _numbers(row["values"]) for row in document["gains"]["values"]}
        vehicle = document.get("vehicle") or {"sha256": "", "values": {}}
        values = {_text(name): _number(value) for name, value in vehicle["values"].items()}
        claims = {_text(name): _text(value) for name, value in document.get("claims", {}).items()}
        manifest = Manifest(
            _text(document["id"]), _text(document["real"]), _number(document["dt_s"]),
            (_text(law["sha256"]), _text(law["ground_truth_sha256"])), gains, _text(vehicle["sha256"]), claims, (),
            values, _ranges(vehicle.get("ranges")), _text(document["gains"]["id"]),
        )  # fmt: skip
        fins = {_text(name): _number(value) for name, value in vehicle.get("fins", {}).items()}
        reference = ((document.get("evidence") or {}).get("run") or {}).get("reference")
        reference = None if reference is None else _numbers(reference)
        numbers = [v for row in gains.values() for v in row]
        flat = numbers_sha256(numbers)
        ports = ports_sha256(document["lists"][LAW])
        parts = (manifest.laws[0], ports, manifest.period.hex(), manifest.real, _text(law["initial_state_sha256"]))
        wrong = [] if document["gains"]["sha256"] == flat else ["the stated hash of the gains is wrong"]
        if manifest.vehicle and manifest.vehicle != _vehicle_sha256(values, _text(vehicle.get("thrusters", ""))):
            wrong.append("the stated hash of the vehicle is wrong")
        if manifest.gains_id != _gains_id(parts, numbers, manifest.real):
            wrong.append("the stated id of law and gains is wrong")
        if manifest.id != hashlib.sha256("\n".join((*parts, flat)).encode()).hexdigest():
            wrong.append("the id does not match law, ports, period, precision, gains and initial state")
        lists: dict[str, Listed] = {}
        count = 0
        for name, entry in document["lists"].items():
            vectors = {key: tuple(map(_port, rows)) for key, rows in entry.items() if key not in ("sha256", *_NUMBERS)}
            count += sum(port.size for ports in vectors.values() for port in ports)
            alike = any(len({port.name for port in ports}) < len(ports) for ports in vectors.values())
            if alike or count > _LONGEST:  # one number may stand for all entries of a port
                raise ValueError(name)
            listed = Listed(texts.get(name, ""), vectors, _values(entry, vectors))
            if name in texts and digest(listed.text) != entry["sha256"]:
                wrong.append(f"the stated digest of {name} is wrong")
            lists[_text(entry["sha256"])] = listed
        if manifest.laws[0] != document["lists"][LAW]["sha256"]:
            wrong.append(f"the digest of the law is not that of {LAW}")
        exported = lists[document["lists"][LAW]["sha256"]]
        if [(p.name, p.size) for p in exported.vectors["gains"]] != [(n, len(v)) for n, v in gains.items()]:
            wrong.append(f"the gains are not those of {LAW}")
        if numbers_sha256(exported.numbers["initial_state"]) != parts[4]:
            wrong.append("the stated hash of the initial state is wrong")
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError):
        raise _no_manifest(path) from None
    return replace(manifest, wrong=tuple(wrong), lists=lists, fins=fins, reference=reference)


def _no_manifest(path: Path | None) -> InputError:
    remedy = "export the controller again"
    return InputError("is not the manifest of an export, or an older version wrote it", file=path, remedy=remedy)


def _walked(folder: Path) -> tuple[dict[str, str], set[str]]:
    """Return what each entry of the folder is that is not a regular file, and the names of the files."""
    problems, names = dict[str, str](), set[str]()
    try:
        for count, (name, entry) in enumerate(_entries(folder, "", 0)):
            if count >= _MOST:
                raise InputError(f"has more than {_MOST} files", file=folder, remedy=_REMEDY)
            if entry.is_symlink():
                problems[name] = "a link"
            elif entry.is_file(follow_symlinks=False):
                names.add(name)
            elif not entry.is_dir(follow_symlinks=False):
                problems[name] = "not a regular file"
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=folder, remedy=_REMEDY) from None
    return problems, names


def _entries(folder: Path, before: str, depth: int) -> Iterator[tuple[str, os.DirEntry[str]]]:
    if depth > _DEEPEST:
        raise InputError(f"has more than {_DEEPEST} folders inside one another", file=folder, remedy=_REMEDY)
    with os.scandir(folder) as entries:
        for entry in sorted(entries, key=lambda one: one.name):
            yield f"{before}{entry.name}", entry
            if entry.is_dir(follow_symlinks=False):
                yield from _entries(folder / entry.name, f"{before}{entry.name}/", depth + 1)


def _compiled(path: Path) -> bool:
    if path.suffix:
        return path.suffix in _OBJECTS
    with path.open("rb") as file:
        return file.read(4).startswith(_PROGRAMS)


def _number(value: Any) -> float:
    if isinstance(value, bool) or not math.isfinite(value):  # of a text: TypeError
        raise TypeError(value)
    return float(value)


def _numbers(values: Any) -> tuple[float, ...]:
    if not isinstance(values, list | tuple):
        raise TypeError(values)
    return tuple(map(_number, values))


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(value)
    return value


def _values(entry: Mapping[str, Any], vectors: Mapping[str, Sequence[Port]]) -> dict[str, tuple[float, ...]]:
    return {
        name: tuple(n for row, port in zip(entry[name], vectors[of], strict=True) for n in _row(row, port.size))
        for name, of in _NUMBERS.items() if name in entry
    }  # fmt: skip


def _row(row: Any, size: int) -> tuple[float, ...]:
    values = _numbers(row) if isinstance(row, list) else (_number(row),) * size  # one number for all
    if len(values) != size:
        raise ValueError("a port has another number of values")
    return values


def _port(text: str) -> Port:
    match = re.fullmatch(r"(\w+)\[(\d{1,7})\] (.+)", text, re.ASCII)
    if match is None:
        raise ValueError(text)
    return Port(match[1], int(match[2]), match[3])


def _ranges(ranges: Any) -> dict[str, tuple[float, float]] | None:
    if ranges is None:
        return None
    ends = {_text(name): (_number(low), _number(high)) for name, (low, high) in ranges.items()}
    if not all(low <= high for low, high in ends.values()):
        raise ValueError("the lower end of a range exceeds its upper end")
    return ends


def _vehicle_sha256(values: Mapping[str, float], thrusters: str) -> str:
    return hashlib.sha256((json.dumps(values, sort_keys=True) + thrusters).encode()).hexdigest()


def _gains_id(parts: Sequence[str], numbers: Sequence[float], real: str) -> str:
    """Return the id that the C function `gains_id` computes: the CRC-32 of the gains as `gains_save` stores them."""
    key = hashlib.sha256("\n".join(parts).encode()).digest()[:8]
    letter, width = {"float64": ("d", 8), "float32": ("f", 4)}[real]
    stored = (
        b"SURG" + struct.pack("<HHI", 1, width, len(numbers)) + key + struct.pack(f"<{len(numbers)}{letter}", *numbers)
    )
    return f"{zlib.crc32(stored):08x}"
