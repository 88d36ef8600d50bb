"""Whether a certificate belongs to an exported controller: the same law, vehicle and gains.

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
from surctl.certcheck.region_claim import read_claim
from surctl.errors import InputError

__all__ = ["Belonging", "Manifest", "compare", "numbers_sha256", "read_bundle", "stated_sha256"]

MANIFEST = "manifest.json"
_STATED = ("variables", "left", "right", "constraints")
_ROUNDING = "rounding: what is proved holds for real numbers, the bundle computes in {}"
_TOLD_TRUTH = "senses: it is about the law that is told true positions, the bundle senses for itself"
_KINEMATIC = "dynamics, sampling and sensing: it is an inequality about the loop of its variables, in their ranges"


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
    """

    id: str
    real: str
    period: float
    laws: tuple[str, str]
    gains: Mapping[str, Sequence[float]]
    vehicle: str
    claims: Mapping[str, str]
    wrong: tuple[str, ...]


@dataclass(frozen=True)
class Belonging:
    """Whether a certificate is about this controller.

    Attributes:
        differs: what is not the same; empty when it belongs.
        excludes: what the certificate leaves out of the controller that flies.
    """

    differs: tuple[str, ...]
    excludes: tuple[str, ...]

    @property
    def belongs(self) -> bool:
        """Whether nothing differs."""
        return not self.differs

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {"belongs": self.belongs, "differs": list(self.differs), "excludes": list(self.excludes)}


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
        told = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", file=path, remedy="give the folder of an export"
        ) from None
    except (UnicodeDecodeError, ValueError, RecursionError):
        raise InputError("is not JSON", file=path, remedy="give the folder of an export") from None
    return read_manifest(told, folder)


def read_manifest(told: Any, folder: Path | None = None) -> Manifest:
    """The manifest as data; without a folder its files are not looked at.

    Raises:
        InputError: it is none.
    """
    try:
        law, files = told["law"], told["sha256"]
        gains = {str(row["name"]): tuple(float(v) for v in row["values"]) for row in told["gains"]["values"]}
        vehicle = told.get("vehicle") or {"sha256": "", "values": {}}
        values = {str(name): float(value) for name, value in vehicle["values"].items()}
        manifest = Manifest(
            str(told["id"]),
            str(told["real"]),
            float(told["dt_s"]),
            (str(law["sha256"]), str(law["told_truth_sha256"])),
            gains,
            str(vehicle["sha256"]),
            {str(name): str(text) for name, text in told.get("claims", {}).items()},
            (),
        )
        flat = numbers_sha256([v for row in gains.values() for v in row])
        parts = (manifest.laws[0], manifest.period.hex(), manifest.real, flat, str(law["initial_state_sha256"]))
        wrong = [] if told["gains"]["sha256"] == flat else ["the hash of the gains is not theirs"]
        if manifest.vehicle and manifest.vehicle != _vehicle_sha256(values):
            wrong.append("the hash of the vehicle is not that of its numbers")
        if manifest.id != hashlib.sha256("\n".join(parts).encode()).hexdigest():
            wrong.append("the id is not that of law, period, precision, gains and initial state")
        if folder is not None:
            wrong += _files(folder, files, f"{told['name']}.c", manifest.id)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        raise InputError(
            "is no manifest of an export, or of an older one",
            file=None if folder is None else folder / MANIFEST,
            remedy="export the controller again",
        ) from None
    return Manifest(**{**vars(manifest), "wrong": tuple(wrong)})


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


def compare(document: Mapping[str, Any], manifest: Manifest) -> Belonging:
    """Whether a certificate that was accepted is about the controller of a manifest.

    Args:
        document: the certificate.
        manifest: of the bundle.
    """
    if document.get("kind") == "region":
        return _region(document["claim"], manifest)
    claim = document["claim"]
    name = claim.get("name")
    excludes = (_KINEMATIC, _ROUNDING.format(manifest.real))
    wanted = manifest.claims.get(name)
    if wanted is None:
        return Belonging(
            (*manifest.wrong, f"claim {name!r} is about no part of the exported law that its manifest names"), excludes
        )
    if wanted != stated_sha256(claim):
        return Belonging(
            (*manifest.wrong, f"claim {name!r} for the bundle's gains, vehicle and cruise is another one"), excludes
        )
    return Belonging(manifest.wrong, excludes)


def _region(claim: Mapping[str, Any], manifest: Manifest) -> Belonging:
    read_claim(claim)  # every number is one
    law, differs = claim["law"], list(manifest.wrong)
    if claim["sha256_law"] not in manifest.laws:
        differs.append(f"law: {claim['sha256_law'][:12]} certified, {manifest.laws[0][:12]} exported")
    if not manifest.vehicle:
        differs.append("vehicle: the bundle names none")
    elif claim["sha256_vehicle"] != manifest.vehicle:
        differs.append(f"vehicle: {claim['sha256_vehicle'][:12]} certified, {manifest.vehicle[:12]} exported")
    pairs = [(name, law[name], 0) for name in ("k1", "lookahead", "k_v", "k_i", "wait", "cruise", "cap")]
    for port, key in (("mass", "mass_kg"), ("linear_drag", "linear_drag"), ("quadratic_drag", "quadratic_drag")):
        pairs += [(port, law[key], axis) for axis in (0, 1)]
    for port, wanted, at in pairs:
        have = manifest.gains.get(port, ())
        if len(have) <= at or have[at] != wanted:
            differs.append(f"{port}[{at}]: {wanted!r} certified, {have[at] if len(have) > at else 'none'!r} exported")
    limits = manifest.gains.get("thrust_limit", ())[:2]
    if len(limits) < 2 or min(limits) < claim["vehicle"]["thrust_n"]:
        differs.append(f"thrust_limit: at least {claim['vehicle']['thrust_n']!r} N certified, {limits!r} exported")
    excludes = [*claim["excludes"], _ROUNDING.format(manifest.real)]
    if law["period_s"] not in (0, manifest.period):
        differs.append(f"period: {law['period_s']!r} s certified, {manifest.period!r} s exported")
    if law["period_s"] == 0:
        excludes.append("sampling: commands that are held for a period")
    if claim["vehicle"]["lag_s"] == [0, 0]:
        excludes.append("lag of the thrusters")
    if claim["sha256_law"] == manifest.laws[1] != manifest.laws[0]:
        excludes.append(_TOLD_TRUTH)
    return Belonging(tuple(differs), tuple(excludes))
