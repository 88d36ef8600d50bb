"""The exported controller as files, complete or not at all: manifest with its seal, id of law and gains."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl import __version__
from surctl.certcheck.bundle import FORMAT_VERSION, manifest_seal, numbers_sha256
from surctl.errors import InputError, writing
from surctl.export.contract import DATA, FILES, Exportable, checked_name, commands, is_robot_law
from surctl.export.envelope import Envelope, anywhere, self_test_vectors
from surctl.export.guard_text import range_text
from surctl.export.precision import in_precision, rounded
from surctl.export.rendering import render_files
from surctl.export.supplement import LAW, Supplement, gains_id, law_lines, law_list
from surctl.ir import Layout, Real

_MANIFEST = "manifest.json"

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Bundle:
    """The exported files of a controller, as text; building the same law twice gives the same bytes.

    Attributes:
        name: prefix of files and C symbols.
        id: SHA-256 of what the controller computes (see `law_id`).
        files: text of each file by its name, such as `link.c` or `ros2/package.xml`, in the order of writing; the
            manifest is last.
        real: precision of every number in the C text.
        envelope: ranges and rates of change that the input check (guard) of the exported C accepts.
        binaries: bytes of further files by name, such as an FMU.
        fed: gains that code of the bundle writes itself while it runs, such as the waypoints of its mission.
    """

    name: str
    id: str
    files: Mapping[str, str]
    real: Real = "float64"
    envelope: Envelope | None = None
    binaries: Mapping[str, bytes] = field(default_factory=dict)
    fed: tuple[str, ...] = ()

    @property
    def selftest(self) -> str:
        """Return the name of the C file with the self-test; a program without self-test does not need this file."""
        return f"{self.name}_selftest.c"

    @property
    def sources(self) -> tuple[str, ...]:
        """Return the names of the controller's C files, without the self-test."""
        begins = (f"{self.name}.", f"{self.name}_")
        others = {self.selftest, *(f"{file}.c" for file in FILES)}
        return tuple(
            file for file in self.files if file.startswith(begins) and file.endswith(".c") and file not in others
        )

    @property
    def mission_rows(self) -> int:
        """Return how many waypoints the mission in the bundle has; 0: there is no mission."""
        text = self.files.get(DATA, "")
        return int(text.partition("_waypoints[")[2].partition("]")[0] or 0)

    @property
    def headers(self) -> tuple[str, ...]:
        """Return the names of the public headers and of the header that only the controller's C files include."""
        names = (f"{self.name}.h", f"{self.name}_gains.h", f"{self.name}_internal.h")
        return tuple(name for name in names if name in self.files)


@dataclass(frozen=True)
class ExportedFile:
    """An exported file on disk and the SHA-256 of its bytes."""

    path: Path
    sha256: str


def build_bundle(
    law: Exportable,
    gains: Mapping[str, NDArray[np.float64]],
    *,
    name: str | None = None,
    real: Real = "float64",
    envelope: Envelope | None = None,
    supplement: Supplement | None = None,
) -> Bundle:
    """Return the C bundle of a controller, as `surctl.marine.export.build_bundle`, with what an application adds to it.

    Raises:
        InputError: as there, or an addition does not belong to this controller.
    """
    prefix = checked_name(law, name)
    if real == "float32" and law.block.libm:
        problem = f"uses {', '.join(sorted(law.block.libm))} of the C math library, whose results depend on the machine"
        remedy = "replace these functions by exact operations (surctl.ir.without_libm)"
        raise InputError(problem, key=f"{prefix}.block", remedy=remedy)
    p = _gain_vector(law.gains, gains)
    added = supplement or Supplement()
    within = (envelope or anywhere(law)).fitted(law, real)
    identity = law_id(law, p, real=real)
    tests = self_test_vectors(in_precision(law, real, within), rounded(p, real), within)
    files = render_files(law, p, within, name=prefix, identity=identity, tests=tests, real=real, supplement=added)
    lists = {LAW: law_list(law), **added.lists(law)}
    files |= added.files | {file: listed.block.text() for file, listed in lists.items()}
    _check_gains(law, rounded(p, real), within)
    table = _manifest(law, prefix, identity, real, within) | law_entries(law, p, real=real) | added.entries(law, p)
    table["lists"] = {file: listed.entry() for file, listed in lists.items()}
    added.check(table, files)
    files["manifest.json"] = manifest_with(table, files, proof={"status": "not tried"})
    return Bundle(prefix, identity, MappingProxyType(files), real, within, fed=added.fed(law))


def _check_gains(law: Exportable, p: Vector, within: Envelope) -> None:
    wrong = np.flatnonzero(~((p >= within.gains[:, 0]) & (p <= within.gains[:, 1])))
    if wrong.size:
        at = int(wrong[0])
        port = next(port for port in law.gains if at < law.gains.slice(port.name).stop)
        problem = f"is outside the range that the guard accepts, {range_text(within.gains[at : at + 1])}"
        remedy = "change the gain, or widen the range of the envelope"
        raise InputError(problem, key=port.name, value=float(p[at]), remedy=remedy)
    for low, high in within.orders:
        if p[low] > p[high]:
            port = next(port for port in law.gains if high < law.gains.slice(port.name).stop)
            remedy = "change the gain, or remove this order from the envelope"
            raise InputError(f"must not be below {float(p[low])!r}", key=port.name, value=float(p[high]), remedy=remedy)


def _gain_vector(layout: Layout, gains: Mapping[str, NDArray[np.float64]]) -> Vector:
    """Return all gains in one vector (np,); InputError for an unknown gain, a wrong size or a non-finite value."""
    p = layout.pack(gains)
    for port in layout:
        if not np.all(np.isfinite(p[layout.slice(port.name)])):
            raise InputError("holds a number that is not finite", key=port.name, remedy="give a finite gain")
    return p


def law_id(law: Exportable, gains: Vector, *, real: Real = "float64") -> str:
    """Return one SHA-256 of the law's instruction list, ports, period, precision, exact initial state and exact gains.

    The instruction list, the names, sizes and units of its ports, the initial state and the gains are first hashed
    separately. If two controllers differ, these hashes show in which part.
    """
    lines = [*law_lines(law, real), numbers_sha256(gains.tolist())]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def gain_rows(law: Exportable, p: Vector) -> list[dict[str, Any]]:
    """Return name and values of each gain, as the manifest states them."""
    return [{"name": port.name, "values": p[law.gains.slice(port.name)].tolist()} for port in law.gains]


def law_entry(law: Exportable, ground_truth: str) -> dict[str, str]:
    """Return the manifest's entry of a law; `ground_truth` is the digest of the law that certificates are about."""
    return {
        "sha256": law.block.digest(),
        "ground_truth_sha256": ground_truth,
        "initial_state_sha256": numbers_sha256(law.initial_state().tolist()),
    }


def law_entries(law: Exportable, p: Vector, *, real: Real = "float64") -> dict[str, Any]:
    """Return the manifest's entries of law and gains."""
    rows = gain_rows(law, p)
    return {
        "law": law_entry(law, law.block.digest()),
        "gains": {"values": rows, "sha256": numbers_sha256(p.tolist()), "id": gains_id(law, p, real)},
    }


def _manifest(law: Exportable, name: str, identity: str, real: Real, within: Envelope) -> dict[str, Any]:
    boxes = {
        "state": (law.state, within.state),
        "input": (law.inputs, within.inputs),
        "gains": (law.gains, within.gains),
    }
    return {
        "name": name,
        "id": identity,
        "surctl": __version__,
        "dt_s": float(law.dt),
        "real": real,
        "operations_at_most": int(law.block.operations),  # of the law in one step, if every loop runs to its end
        **({} if is_robot_law(law) else {"commands": {port.name: port.unit for port in commands(law)}}),
        "ranges": {
            struct: {port.name: range_text(box[layout.slice(port.name)]) for port in layout if port.size}
            for struct, (layout, box) in boxes.items()
        },
    }


def manifest_with(
    table: Mapping[str, object],
    files: Mapping[str, str],
    *,
    proof: Mapping[str, object],
    binaries: Mapping[str, bytes] | None = None,
) -> str:
    """Return the text of the manifest `table`, with the hashes of all files, the outcome of the proof and a seal."""
    contents = {file: text.encode() for file, text in files.items()} | dict(binaries or {})
    hashes = {file: hashlib.sha256(data).hexdigest() for file, data in contents.items()}
    full = {"format_version": FORMAT_VERSION, **table, "proof": proof, "sha256": hashes}
    return json.dumps({**full, "seal": manifest_seal(full)}, indent=2, sort_keys=True) + "\n"


def write_bundle(bundle: Bundle, directory: Path | str) -> list[ExportedFile]:
    """Write the files of the bundle to a folder; no file is ever half-written.

    All files are first written to a sibling folder. If `directory` does not exist, the sibling folder is renamed to
    `directory`. If `directory` exists, its manifest is removed first, then the unaltered files of an older bundle that
    the new one lacks; each file is replaced by a rename, the new manifest last; other files stay unchanged. So a folder
    with a manifest is complete at any time.

    Raises:
        InputError: the folder cannot be written.

    Example:
        >>> from surctl.export import write_bundle
        >>> from surctl.export.bundle import build_bundle
        >>> from surctl.testing import cart_system
        >>> written = write_bundle(build_bundle(cart_system().controller, {"k": 1.0}), "brake")
        >>> sorted(file.path.name for file in written)[-2:], len(written[0].sha256)
        (['target_link.c', 'target_start.c'], 64)
    """
    target = Path(directory)
    staging = target.parent / f".{target.name}.{os.getpid()}.tmp"
    contents = {**{name: text.encode() for name, text in bundle.files.items()}, **bundle.binaries}
    try:
        with writing(target):
            staging.mkdir(parents=True)
            for name, data in contents.items():
                (staging / name).parent.mkdir(parents=True, exist_ok=True)
                (staging / name).write_bytes(data)
            _publish(bundle, staging, target)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return [ExportedFile(target / name, hashlib.sha256(data).hexdigest()) for name, data in contents.items()]


def check_folder(directory: Path | str) -> None:
    """Raise the InputError of `write_bundle` if a bundle cannot be written to this folder; leave nothing behind."""
    target = Path(directory)
    staging = target.parent / f".{target.name}.{os.getpid()}.tmp"
    try:
        with writing(target):
            staging.mkdir(parents=True)
            if target.exists():
                (target / staging.name).mkdir()
                (target / staging.name).rmdir()
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _publish(bundle: Bundle, staging: Path, target: Path) -> None:
    if not target.exists():
        staging.rename(target)
        return
    older = dict[str, str]()
    with suppress(OSError, ValueError, LookupError, TypeError):
        older = dict(json.loads((target / _MANIFEST).read_text(encoding="utf-8"))["sha256"])
    (target / _MANIFEST).unlink(missing_ok=True)
    for name in older.keys() - bundle.files.keys() - bundle.binaries.keys():
        inside = target in (target / name).parents and ".." not in name and (target / name).is_file()
        if inside and hashlib.sha256((target / name).read_bytes()).hexdigest() == older[name]:
            (target / name).unlink()
    for name in (*bundle.binaries, *(name for name in bundle.files if name != _MANIFEST), _MANIFEST):
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        (staging / name).replace(target / name)
