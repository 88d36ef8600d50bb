"""The exported controller as a set of files: header, source, SIL program, Makefile, README, manifest."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from surctl import __version__
from surctl.errors import InputError
from surctl.export.contract import Exportable, checked_name
from surctl.export.precision import in_precision
from surctl.export.rendering import render_files
from surctl.export.vectors import self_test_vectors
from surctl.ir import Layout, Real

__all__ = ["Bundle", "ExportedFile", "build_bundle", "gain_vector", "law_id", "write_bundle"]

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Bundle:
    """Everything that ships, as text; building it twice gives the same bytes.

    Attributes:
        name: prefix of files and C symbols.
        id: SHA-256 of what the controller computes (see `law_id`).
        files: text by file name, in the order of writing; the manifest is last.
        real: precision of every number in it.
    """

    name: str
    id: str
    files: Mapping[str, str]
    real: Real = "float64"


@dataclass(frozen=True)
class ExportedFile:
    """A file on disk and the SHA-256 of its bytes."""

    path: Path
    sha256: str


def build_bundle(
    law: Exportable, gains: Mapping[str, NDArray[np.float64]], *, name: str | None = None, real: Real = "float64"
) -> Bundle:
    """The bundle of a law with tuned gains.

    Args:
        law: the control law.
        gains: values by gain port; what is not named takes the port's default.
        name: prefix of files and C symbols instead of the law's own name.
        real: "float32" for a processor whose floating-point unit is single; every number is a float then.

    Raises:
        InputError: a name that C cannot use, an unknown or non-finite gain, a law unlike its layouts; in float32 also
            a law that uses the mathematical library.
    """
    prefix = checked_name(law, name)
    if real == "float32" and law.block.libm:
        raise InputError(
            f"uses {', '.join(sorted(law.block.libm))} of the mathematical library, whose floats differ by machine",
            key=f"{prefix}.block",
            remedy="write it with exact operations (surctl.ir.without_libm)",
        )
    p = gain_vector(law.gains, gains)
    identity = law_id(law, p, real=real)
    tests = self_test_vectors(in_precision(law, real), p)
    files = render_files(law, p, name=prefix, identity=identity, tests=tests, real=real)
    files["manifest.json"] = _manifest(law, prefix, identity, files, real)
    return Bundle(prefix, identity, MappingProxyType(files), real)


def gain_vector(layout: Layout, gains: Mapping[str, NDArray[np.float64]]) -> Vector:
    """Flat gain vector (np,); InputError for an unknown gain, a wrong size or a non-finite value."""
    p = layout.pack(gains)
    for port in layout:
        if not np.all(np.isfinite(p[layout.slice(port.name)])):
            raise InputError("holds a number that is not finite", key=port.name, remedy="give a finite gain")
    return p


def law_id(law: Exportable, gains: Vector, *, real: Real = "float64") -> str:
    """SHA-256 of the instruction list, gains, initial state, period, and precision, all to the last bit."""
    lines = [law.block.text(), float(law.dt).hex(), real]
    lines += [float(v).hex() for v in (*gains, *law.initial_state())]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def _manifest(law: Exportable, name: str, identity: str, files: Mapping[str, str], real: Real) -> str:
    table = {
        "name": name,
        "id": identity,
        "surctl": __version__,
        "dt_s": float(law.dt),
        "real": real,
        "sha256": {file: _sha256(text) for file, text in files.items()},
    }
    return json.dumps(table, indent=2, sort_keys=True) + "\n"


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def write_bundle(bundle: Bundle, directory: Path | str) -> list[ExportedFile]:
    """Write the bundle; the folder holds all of its files or none that is half-written.

    The files are first written to a sibling folder. A new `directory` appears by one rename; in one that
    exists each file is replaced by a rename, the manifest last, and other files are left alone.

    Raises:
        InputError: the folder cannot be written.
    """
    target = Path(directory)
    staging = target.parent / f".{target.name}.{os.getpid()}.tmp"
    try:
        _stage(bundle, staging)
        _publish(bundle, staging, target)
    except OSError as error:
        raise InputError(
            f"cannot be written ({error.strerror})",
            file=target,
            remedy="choose a folder that you may write to",
        ) from None
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return [ExportedFile(target / name, _sha256(text)) for name, text in bundle.files.items()]


def _stage(bundle: Bundle, staging: Path) -> None:
    staging.mkdir(parents=True)
    for name, text in bundle.files.items():
        (staging / name).write_bytes(text.encode())


def _publish(bundle: Bundle, staging: Path, target: Path) -> None:
    if not target.exists():
        staging.rename(target)
        return
    for name in bundle.files:
        (staging / name).replace(target / name)
