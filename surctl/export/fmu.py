"""Export of a controller as a functional mock-up unit (FMI 2.0 or 3.0, co-simulation), built from the bundle's C files.

Standards: FMI 2.0.4 (2022) and FMI 3.0.2 (2024) of the Modelica Association. Existing libraries put a language
interpreter into the unit, so this module writes the model description and the C functions itself. The tests validate
the units with fmpy.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import shutil
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.export.bundle import Bundle, ExportedFile
from surctl.export.contract import DATA, MISSION_FILES, Exportable
from surctl.export.fmu_description import build_description, description_2, description_3
from surctl.export.rendering import render_unit
from surctl.ir import compile_program

__all__ = ["unit_sources", "write_fmu"]

Vector = NDArray[np.float64]

_PLATFORMS: Mapping[int, Mapping[tuple[str, str], tuple[str, str]]] = MappingProxyType(
    {
        2: {
            ("Linux", "x86_64"): ("linux64", ".so"),
            ("Darwin", "x86_64"): ("darwin64", ".dylib"),
            ("Windows", "AMD64"): ("win64", ".dll"),
        },
        3: {
            ("Linux", "x86_64"): ("x86_64-linux", ".so"),
            ("Linux", "aarch64"): ("aarch64-linux", ".so"),
            ("Darwin", "x86_64"): ("x86_64-darwin", ".dylib"),
            ("Darwin", "arm64"): ("aarch64-darwin", ".dylib"),
            ("Windows", "AMD64"): ("x86_64-windows", ".dll"),
        },
    }
)
_WINDOWS = "x86_64-w64-mingw32-gcc"
_REPRODUCIBLE = ("-shared", "-fvisibility=hidden", "-s")
_PE = ("-Wl,--no-insert-timestamp", "-Wl,--image-base,0x180000000")  # the default base depends on the library's path
_DATE = (1980, 1, 1, 0, 0, 0)  # fixed date: the same bundle gives the same bytes on every day


def write_fmu(law: Exportable, bundle: Bundle, gains: Vector, directory: Path | str, *, fmi: int = 2) -> ExportedFile:
    """Compile the bundle for this machine, and write the result with its C sources as the FMU `<name>.fmu`.

    Inputs and outputs are the fields of the C structs, gains are tunable parameters, and `status` is an integer output.
    A step of the controller happens at every multiple of its period; a communication step may have any length. Before
    the first step, the outputs are those of a step with the present inputs. The whole state can be saved and restored.
    If `x86_64-w64-mingw32-gcc` is installed, the unit contains a library for Windows too. If the bundle has a mission,
    the unit feeds the controller with it.

    Args:
        law: the control law.
        bundle: the bundle that was exported from this law.
        gains: tuned gains (np,), as in the bundle.
        directory: output folder; the folder is created if it does not exist.
        fmi: version of the standard, 2 (FMI 2.0) or 3 (FMI 3.0).

    Returns:
        The written file; an incomplete file never appears.

    Raises:
        ToolMissing: there is no C compiler.
        InputError: this version of FMI has no name for this machine, or the folder cannot be written.

    Example:
        >>> from zipfile import ZipFile
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.export import build_bundle
        >>> from surctl.export import write_fmu
        >>> from surctl.marine.simulation import law_numbers, load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission, vehicle, gains = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
        >>> law, p = build_law("closed_form"), law_numbers(mission, gains, vehicle)
        >>> file = write_fmu(law, build_bundle(law, law.gains.unpack(p)), p, "fmu")
        >>> file.path.name, ZipFile(file.path).namelist()[0]
        ('surctl_closed_form.fmu', 'modelDescription.xml')
    """
    machine = (platform.system(), platform.machine())
    if machine not in _PLATFORMS[fmi]:
        raise InputError(
            f"has no name in FMI {fmi}.0",
            key="target",
            value=" ".join(machine),
            remedy="export c99 here, or export the FMU on Linux and compile its sources for this machine",
        )
    fed = bundle.fed if bundle.mission_rows else ()
    sources = unit_sources(law, bundle, fmi=fmi)
    compiled = [file for file in sources if file.endswith(".c")]
    if fmi == 3:
        members = {
            "modelDescription.xml": description_3(law, bundle, gains, fed=fed),
            "sources/buildDescription.xml": build_description(bundle.name, compiled),
        }
    else:
        members = {"modelDescription.xml": description_2(law, bundle, gains, compiled, fed=fed)}
    members |= _compiled(bundle.name, sources, machine, fmi=fmi)
    members |= {f"sources/{file}": text.encode() for file, text in sources.items()}
    return _write(Path(directory), f"{bundle.name}.fmu", members)


def unit_sources(law: Exportable, bundle: Bundle, *, fmi: int = 2) -> dict[str, str]:
    """Return the C files of a unit by name: its interface, and the controller's files."""
    storage = (f"{bundle.name}_gains.c", f"{bundle.name}_gains.h")  # the simulator holds the gains
    rows = bundle.mission_rows
    unit = render_unit(law, name=bundle.name, identity=bundle.id, real=bundle.real, fmi=fmi, rows=rows)
    files = [file for file in (*bundle.sources, *bundle.headers) if file not in storage]
    return unit | {file: bundle.files[file] for file in (*files, *((*MISSION_FILES, DATA) if rows else ()))}


def _compiled(name: str, sources: Mapping[str, str], machine: tuple[str, str], *, fmi: int) -> dict[str, bytes]:
    # the shared library of this machine, and that of Windows if its compiler is installed
    place, ending = _PLATFORMS[fmi][machine]
    linked = ("-Wl,--build-id=none",) if ending == ".so" else ()
    builds: list[tuple[str, str, str | None, tuple[str, ...]]] = [
        (place, ending, None, (*_REPRODUCIBLE, "-fPIC", *linked))
    ]
    windows = shutil.which(_WINDOWS)
    if windows is not None:
        place, ending = _PLATFORMS[fmi]["Windows", "AMD64"]
        builds.append((place, ending, windows, (*_REPRODUCIBLE, "-static-libgcc", *_PE)))
    libraries = {}
    with tempfile.TemporaryDirectory(prefix="surctl-fmu-") as scratch:
        for file, text in sources.items():
            (Path(scratch) / file).write_bytes(text.encode())
        code = [Path(scratch) / file for file in sources if file.endswith(".c")]
        for place, ending, compiler, flags in builds:
            library = Path(scratch) / f"{name}{ending}"
            own = f"-DFMI{fmi}_OVERRIDE_FUNCTION_PREFIX"
            compile_program(code, library, flags=(own, *flags), compiler=compiler)
            libraries[f"binaries/{place}/{name}{ending}"] = library.read_bytes()
    return libraries


def _write(folder: Path, name: str, members: dict[str, bytes]) -> ExportedFile:
    target, staged = folder / name, folder / f".{name}.{os.getpid()}.tmp"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # uncompressed, because versions of zlib write different bytes
        with zipfile.ZipFile(staged, "w", zipfile.ZIP_STORED) as archive:
            for member, data in members.items():
                entry = zipfile.ZipInfo(member, _DATE)
                entry.create_system, entry.external_attr = 3, 0o644 << 16
                archive.writestr(entry, data)
        digest = hashlib.sha256(staged.read_bytes()).hexdigest()
        staged.replace(target)
    except OSError as error:
        raise InputError(
            f"cannot be written ({error.strerror})", file=target, remedy="choose a folder that you may write to"
        ) from None
    finally:
        with contextlib.suppress(OSError):
            staged.unlink()
    return ExportedFile(target, digest)
