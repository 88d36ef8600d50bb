"""Export of a controller as a functional mock-up unit (FMI 2.0, co-simulation), built from the C files of the bundle.

Standard: FMI 2.0.4 (Modelica Association, 2022). Existing libraries put a language interpreter into the unit, so this
module writes the model description and the C functions itself. The tests validate the units with fmpy.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import os
import platform
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from surctl import __version__
from surctl.errors import InputError
from surctl.export.bundle import Bundle, ExportedFile
from surctl.export.contract import Exportable, is_robot_law, status_table
from surctl.export.rendering import render_unit
from surctl.ir import Layout, compile_program

__all__ = ["write_fmu"]

Vector = NDArray[np.float64]

_PLATFORMS = {("Linux", "x86_64"): ("linux64", ".so"), ("Darwin", "x86_64"): ("darwin64", ".dylib")}
_REPRODUCIBLE = ("-shared", "-fPIC", "-fvisibility=hidden", "-s")
_DATE = (1980, 1, 1, 0, 0, 0)  # fixed date: the same bundle gives the same bytes on every day


def write_fmu(law: Exportable, bundle: Bundle, gains: Vector, directory: Path | str) -> ExportedFile:
    """Compile the bundle for this machine, and write the result with its C sources as the FMU `<name>.fmu`.

    Inputs and outputs are the fields of the C structs, gains are tunable parameters, and `status` is an integer output.
    Every communication step is one step of the controller. The controller's state is not visible from outside.

    Args:
        law: the control law.
        bundle: the bundle that was exported from this law.
        gains: tuned gains (np,), as in the bundle.
        directory: output folder; the folder is created if it does not exist.

    Returns:
        The written file; an incomplete file never appears.

    Raises:
        ToolMissing: there is no C compiler.
        InputError: FMI 2.0 has no name for this machine, or the folder cannot be written.

    Example:
        >>> from zipfile import ZipFile
        >>> from surctl.control import build_law, load_gains
        >>> from surctl.export import build_bundle, write_fmu
        >>> from surctl.simulation import law_numbers, load_scenario
        >>> from surctl.vehicle import load_vehicle
        >>> mission, vehicle, gains = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
        >>> law, p = build_law("closed_form"), law_numbers(mission, gains, vehicle)
        >>> file = write_fmu(law, build_bundle(law, law.gains.unpack(p)), p, "fmu")
        >>> file.path.name, ZipFile(file.path).namelist()[0]
        ('surctl_closed_form.fmu', 'modelDescription.xml')
    """
    machine = (platform.system(), platform.machine())
    if machine not in _PLATFORMS:
        raise InputError(
            "has no name in FMI 2.0",
            key="target",
            value=" ".join(machine),
            remedy="export c99 here, or export the FMU on Linux and compile its sources for this machine",
        )
    place, ending = _PLATFORMS[machine]
    name = bundle.name
    unit = render_unit(law, name=name, identity=bundle.id, real=bundle.real)
    storage = (f"{name}_gains.c", f"{name}_gains.h")  # the simulator holds the gains
    files = [file for file in (*bundle.sources, *bundle.headers) if file not in storage]
    sources = {"fmu.c": unit, **{file: bundle.files[file] for file in files}}
    compiled = [file for file in sources if file.endswith(".c")]
    with tempfile.TemporaryDirectory(prefix="surctl-fmu-") as scratch:
        for file, text in sources.items():
            (Path(scratch) / file).write_bytes(text.encode())
        library = Path(scratch) / f"{name}{ending}"
        linked = ("-Wl,--build-id=none",) if ending == ".so" else ()
        compile_program([Path(scratch) / file for file in compiled], library, flags=(*_REPRODUCIBLE, *linked))
        binary = library.read_bytes()
    members = {
        "modelDescription.xml": _description(law, bundle, gains, compiled),
        f"binaries/{place}/{name}{ending}": binary,
        **{f"sources/{file}": text.encode() for file, text in sources.items()},
    }
    return _write(Path(directory), f"{name}.fmu", members)


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


_ROBOT = "Controller of a small underwater robot. SI units, radians; frames ENU (world) and FLU (body)."


def _description(law: Exportable, bundle: Bundle, gains: Vector, sources: Sequence[str]) -> bytes:
    # modelDescription.xml
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=bundle.name,
        guid=bundle.id,
        description=_ROBOT if is_robot_law(law) else "Controller. SI units, radians.",
        generationTool=f"surctl {__version__}",
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    unit = ElementTree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=bundle.name,
        canHandleVariableCommunicationStepSize="false",
        canNotUseMemoryManagementFunctions="false",
    )
    listed = ElementTree.SubElement(unit, "SourceFiles")
    for file in sources:
        ElementTree.SubElement(listed, "File", name=file)
    logs = ElementTree.SubElement(root, "LogCategories")
    ElementTree.SubElement(logs, "Category", name="logStatusWarning")
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(float(law.dt)))
    variables = ElementTree.SubElement(root, "ModelVariables")
    count = 0
    kinds = (
        (law.inputs, law.inputs.pack(), {"causality": "input", "variability": "discrete"}),
        (law.gains, gains, {"causality": "parameter", "variability": "tunable", "initial": "exact"}),
        (law.outputs, None, {"causality": "output", "variability": "discrete", "initial": "calculated"}),
    )
    for layout, starts, kind in kinds:
        for k, (name, said) in enumerate(_members(layout)):
            scalar = ElementTree.SubElement(
                variables, "ScalarVariable", {"name": name, "valueReference": str(count), "description": said, **kind}
            )
            value = {} if starts is None else {"start": repr(float(np.float64(starts[k])))}
            ElementTree.SubElement(scalar, "Real", value)
            count += 1
    codes = "; ".join(f"{code}: {meaning}" for _, code, meaning in status_table(law))
    scalar = ElementTree.SubElement(
        variables,
        "ScalarVariable",
        name="status",
        valueReference="0",
        description=codes,
        causality="output",
        variability="discrete",
        initial="calculated",
    )
    ElementTree.SubElement(scalar, "Integer")
    structure = ElementTree.SubElement(root, "ModelStructure")
    first = law.inputs.size + law.gains.size + 1
    for kind_of in ("Outputs", "InitialUnknowns"):
        listed = ElementTree.SubElement(structure, kind_of)
        for index in range(first, count + 2):
            ElementTree.SubElement(listed, "Unknown", index=str(index))
    ElementTree.indent(root)
    text: str = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()


def _members(layout: Layout) -> Iterator[tuple[str, str]]:
    # (name, description); indices start at 1, as FMI requires
    for port in layout:
        said = f"[{port.unit}] {port.meaning}"
        if port.size == 1:
            yield port.name, said
            continue
        for index in itertools.product(*(range(1, n + 1) for n in port.shape)):
            yield f"{port.name}[{','.join(map(str, index))}]", said
