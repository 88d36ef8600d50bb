"""Origin of a bundle: vehicle, claims and sensors in its manifest; which certificates belong to its law."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import PATIENCE, check_document
from surctl.certcheck.belonging import compare
from surctl.certcheck.bundle import Manifest, read_manifest, stated_sha256
from surctl.certcheck.document import Rejected, read
from surctl.errors import InputError, NotApplicable, UnsupportedOperation
from surctl.export.bundle import gain_rows, law_entries, law_entry, law_id
from surctl.export.contract import Exportable
from surctl.export.supplement import LAW, Listed, law_list
from surctl.ir import Real
from surctl.marine.control import AVOIDANCE, BARRIER, PATH_FOLLOWING, Law, build_law, law_options, law_source
from surctl.marine.guidance import AvoidanceForm
from surctl.marine.sensing import Equipment
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.library import applicable_claims
from surctl.marine.verification.region.steering import side_per_moment
from surctl.verification import Claim
from surctl.verification.formula import text_of
from surctl.verification.proving import statement_of

Vector = NDArray[np.float64]

_CERTIFIED = "certified_law.txt"
"""File of a bundle with the instruction list of the law that certificates are about, if it is not the exported one."""

_AVOIDANCE: Mapping[str, AvoidanceForm] = {
    "v2-printed": "consistent",
    "v2-static": "consistent",
    "v2-obstacle": "consistent",
    "v2-clockwise": "printed",
    "clearance-printed": "printed",
    "clearance-corrected": "corrected",
}
"""Form of the avoidance law (20) that each of these claims is about; only law `paper` uses (20)."""


@dataclass(frozen=True)
class Origin:
    """Origin of an exported controller: its vehicle, its law without perception, and its certificates.

    Attributes:
        vehicle: vehicle model that the controller is designed for.
        ground_truth: the exported law without perception; the certificates are about this law.
        certificates: certificates by their file name in the bundle.
        equipment: sensors that the law assumes, for the wiring section of the README; None if they are not known.
    """

    vehicle: Vehicle
    ground_truth: Law
    certificates: Mapping[str, Mapping[str, Any]] | None = None
    equipment: Equipment | None = None

    def lists(self, law: Exportable) -> dict[str, Listed]:
        """Return the instruction list of the law that certificates are about, unless it is that of the exported law."""
        exported = self.ground_truth.block.digest() == law.block.digest()
        return {} if exported else {_CERTIFIED: law_list(self.ground_truth)}

    @property
    def files(self) -> dict[str, str]:
        """Return the text of the certificates by file name."""
        return {
            name: json.dumps(document, ensure_ascii=False, indent=1) + "\n"
            for name, document in sorted((self.certificates or {}).items())
        }


def origin_of(
    law: Law,
    vehicle: Vehicle,
    certificates: Mapping[str, Mapping[str, Any]] | None = None,
    *,
    equipment: Equipment | None = None,
) -> Origin:
    """Return the origin of a law that controls a vehicle."""
    law = law.base or law  # claims are about the command, before the allocation to thrusters
    ground_truth = law
    if "samples" in law.inputs:
        ground_truth = build_law(law.ref, dt=law.dt, fallback=law.fallback, **law_options(law))
    return Origin(vehicle, ground_truth, certificates, equipment)


def load_certificates(paths: Sequence[Path]) -> dict[str, Mapping[str, Any]]:
    """Read certificates, and return each certificate by the file name that it gets in a bundle."""
    certificates: dict[str, Mapping[str, Any]] = {}
    for path in paths:
        document = _read(path)
        checked = check_document(document, time_limit=PATIENCE)
        if not checked.accepted:
            raise InputError(f"is rejected: {checked.reason}", file=path, remedy="prove it again: surctl verify")
        name = f"certificate-{re.sub(r'[^A-Za-z0-9_-]', '-', path.stem)}.json"
        if name in certificates:
            raise InputError(
                "has the same name in the bundle as another certificate", file=path, remedy="rename one of them"
            )
        certificates[name] = document
    return certificates


def _read(path: Path) -> dict[str, Any]:
    try:
        return read(path)
    except Rejected as reason:
        raise InputError(f"is rejected: {reason}", file=path, remedy="prove it again: surctl verify") from None


def manifest_of(law: Exportable, p: Vector, origin: Origin, *, real: Real = "float64") -> Manifest:
    """Return what the manifest of an export of this law will state, as the checker reads it."""
    lists = {LAW: law_list(law), **origin.lists(law)}
    frame = {"name": "", "id": law_id(law, p, real=real), "dt_s": law.dt, "real": real}
    entries = law_entries(law, p, real=real) | origin_entries(law, p, origin)
    stated = {"lists": {file: listed.entry() for file, listed in lists.items()}}
    return read_manifest(frame | entries | stated, {file: listed.block.text() for file, listed in lists.items()})


def origin_entries(law: Exportable, p: Vector, origin: Origin) -> dict[str, Any]:
    """Return the manifest's entries for vehicle, claims and sensors, and the entry of a law with its ground truth."""
    rows = gain_rows(law, p)
    vehicle = origin.vehicle
    values = {name: parameter.value for name, parameter in vehicle.parameters.items()}
    ranges = {name: list(p.range) for name, p in vehicle.parameters.items() if p.range is not None}
    entries: dict[str, Any] = {
        "law": law_entry(law, origin.ground_truth.block.digest()),
        "vehicle": {"name": vehicle.name, "values": values, "ranges": ranges, "sha256": vehicle.digest()},
        "claims": _claims(rows, origin),
    }
    if vehicle.actuators is not None:
        entries["vehicle"]["thrusters"] = vehicle.actuators.text()
        if vehicle.actuators.fins and "cruise" in law.gains:
            cruise = float(p[law.gains.slice("cruise")][0])
            entries["vehicle"]["fins"] = fins = {"moment_nm": float(vehicle.at_speed(cruise).thrust_limit[3])}
            with contextlib.suppress(NotApplicable):  # fins at several places have no fixed share
                fins["side_per_m"] = side_per_moment(vehicle)
    if origin.equipment is not None:
        assumed = {"floor_m": origin.equipment.floor, "search_limit_s": origin.equipment.search_limit}
        entries["sensors"] = {key: value for key, value in assumed.items() if value is not None}
    return entries


def check_belonging(manifest: Mapping[str, Any], files: Mapping[str, str], origin: Origin) -> None:
    """Raise InputError with the differences if a certificate is not about the controller of the manifest."""
    read_back = read_manifest(manifest, files)
    speeds = [f"--{name} {read_back.gains[name][0]:g}" for name in ("cruise", "cap") if name in read_back.gains]
    command = " ".join(["surctl verify", *speeds, "--gains FILE --vehicle FILE"])
    for name, document in (origin.certificates or {}).items():
        comparison = compare(document, read_back)
        if not comparison.belongs:
            problem = f"is not about this controller: {'; '.join((*comparison.differs, *comparison.unbound))}"
            remedy = f"prove the claim for these speeds, these gains and this vehicle: {command}"
            raise InputError(problem, key=name.removeprefix("certificate-"), remedy=remedy)


def fitting_certificates(paths: Sequence[Path], law: Law, vehicle: Vehicle, p: Vector) -> list[Path]:
    """Return the certificates that concern this law with these parameters; only these can be exported with the law.

    Their proofs are not checked here, but at the export.
    """
    manifest = manifest_of(law, p, origin_of(law, vehicle))
    return [path for path in paths if compare(_read(path), manifest).belongs]


def _claims(rows: Sequence[Mapping[str, Any]], origin: Origin) -> dict[str, str]:
    # hashes of the library's claims about parts of this law, for its gains, cruise speed and speed cap
    values = {row["name"]: row["values"][0] for row in rows if len(row["values"]) == 1}
    if "cruise" in values:
        values["speed"] = values["cruise"]
    if "cap" in values:
        values["speed_max"] = values["cap"]
    for name in law_source(origin.ground_truth.ref).gains:  # a gain of one's own may have the name of another number
        values.pop(name, None)
    hashes: dict[str, str] = {}
    library, _ = applicable_claims(values, vehicle=origin.vehicle)
    for claim in library:
        if not _has_part(origin.ground_truth, claim.name):
            continue
        with contextlib.suppress(InputError, UnsupportedOperation):
            hashes[claim.name] = stated_sha256(_stated(claim))
    return hashes


def _has_part(law: Law, claim: str) -> bool:
    """Return whether the law contains what the claim is about: path following, avoidance, or the barrier."""
    parts = law_source(law.ref).parts
    if claim in _AVOIDANCE:
        return AVOIDANCE in parts and law.avoidance == _AVOIDANCE[claim]
    if claim.startswith("braking-"):
        return BARRIER in parts and law.barrier == "inertia"
    return PATH_FOLLOWING in parts and law.guidance == "los"


def _stated(claim: Claim) -> dict[str, Any]:
    # the form in which a certificate contains the statement, but for the slack
    left, right, *constraints = (text_of(part) for part in statement_of(claim).parts)
    ranges = [
        {"name": v.name, "unit": v.unit, "lower": float(v.lower), "upper": float(v.upper)} for v in claim.variables
    ]
    sides = {"left": left, "right": right, "constraints": constraints}
    return {"name": claim.name, "statement": claim.statement, "unit": claim.unit, "variables": ranges, **sides}
