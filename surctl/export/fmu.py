"""Export as a functional mock-up unit (FMI 2.0 or 3.0): description of its variables, C sources, compiled libraries.

Standards: FMI 2.0.4 (2022) and FMI 3.0.2 (2024) of the Modelica Association. Existing libraries put a language
interpreter into the unit, so this module writes the model description and the C functions itself. The tests validate
the units with fmpy.
"""

from __future__ import annotations

import hashlib
import io
import itertools
import platform
import re
import shutil
import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl import __version__
from surctl.errors import InputError
from surctl.export.bundle import Bundle, ExportedFile
from surctl.export.contract import DATA, MISSION_FILES, Exportable, commands, is_robot_law, status_table
from surctl.export.envelope import Envelope, anywhere
from surctl.export.rendering import render_unit, templates
from surctl.files import write_file
from surctl.ir import Port
from surctl.ir.cache import compile_program, packaged_compiler

Vector = NDArray[np.float64]

_LIMIT = 1e37  # a range whose end is beyond this is that of the number type

_COMPONENTS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "eta": ("x", "y", "z", "psi"),
        "nu": ("u", "v", "w", "r"),
        "nu_reference": ("u", "v", "w", "r"),
        "tau": ("F_u", "F_v", "F_w", "F_r"),
        "fix": ("x", "y", "z"),
        "path_error": ("x_e", "y_e"),
        "contacts": ("x", "y", "radius", "vx", "vy", "valid"),
        "waypoints": ("x", "y"),
        "walls": ("x_min", "x_max", "y_min", "y_max"),
        "mass": ("surge", "sway", "heave", "yaw"),
        "linear_drag": ("Xu", "Yv", "Zw", "Nr"),
        "quadratic_drag": ("Xuu", "Yvv", "Zww", "Nrr"),
        "thrust_limit": ("surge", "sway", "heave", "yaw"),
        "stopping": (
            *("least mass", "largest mass", "largest thrust", "thrust lag"),
            *("largest linear drag", "largest quadratic drag"),
        ),
    }
)
_UNITS: Mapping[str, str] = MappingProxyType(
    {"contacts": "m, m, m, m/s, m/s, 1", "stopping": "kg, kg, N, s, N s/m, N s^2/m^2"}
)
_BASE: Mapping[str, Mapping[str, int]] = MappingProxyType(
    {
        **{unit: {unit: 1} for unit in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")},
        "1": {},
        "Hz": {"s": -1},
        "N": {"kg": 1, "m": 1, "s": -2},
        "Pa": {"kg": 1, "m": -1, "s": -2},
        "J": {"kg": 1, "m": 2, "s": -2},
        "W": {"kg": 1, "m": 2, "s": -3},
        "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    }
)


@dataclass(frozen=True)
class _Variable:
    """One number of a unit.

    Attributes:
        name, description: name with indices from 1, and what the number is.
        reference: value reference, which counts from 0.
        causality: "input", "parameter" or "output".
        unit: unit; empty if it is not known for this component.
        low, high, start: range, and value at the start; None if there is none.
    """

    name: str
    reference: int
    causality: str
    description: str
    unit: str
    low: float | None
    high: float | None
    start: float | None


def _variables(law: Exportable, within: Envelope, gains: Vector, *, fed: Sequence[str] = ()) -> list[_Variable]:
    """Return all numbers of a unit in the order of their value references.

    `within` are ranges of inputs, gains and commands, `gains` tuned gains (np,), and `fed` gains that the unit writes
    itself, from its mission.
    """
    outputs = np.full((law.outputs.size, 2), [-np.inf, np.inf])
    if within.commands is not None:
        outputs[: sum(port.size for port in commands(law))] = within.commands
    parts = (
        ("input", law.inputs, within.inputs, law.inputs.pack()),
        ("parameter", law.gains, within.gains, gains),
        ("output", law.outputs, outputs, None),
    )
    numbers: list[_Variable] = []
    for causality, layout, box, starts in parts:
        names = [member for port in layout for member in _members(port)]
        for k, (name, said, unit) in enumerate(names):
            low, high = (float(v) if abs(v) < _LIMIT else None for v in box[k])
            start = None if starts is None else float(starts[k])
            note = " (written by the unit from its mission)" if name.partition("[")[0] in fed else ""
            numbers.append(_Variable(name, len(numbers), causality, said + note, unit, low, high, start))
    return numbers


def _members(port: Port) -> Iterator[tuple[str, str, str]]:
    # (name, description, unit) of each number
    if port.size == 1:
        yield port.name, f"[{port.unit}] {port.meaning}", port.unit
        return
    last = port.shape[-1]
    units = _component_units(_UNITS.get(port.name, port.unit), last)
    labels = _COMPONENTS.get(port.name, ())
    for index in itertools.product(*(range(n) for n in port.shape)):
        at = index[-1]
        label = labels[at] if len(labels) == last else f"{at + 1} of {last}"
        row = f", row {', '.join(str(i + 1) for i in index[:-1])}" if len(index) > 1 else ""
        unit = units[at] if units else ""
        said = f"[{unit or port.unit}] {label}{row}: {port.meaning}"
        yield f"{port.name}[{','.join(str(i + 1) for i in index)}]", said, unit


def _component_units(text: str, count: int) -> list[str]:
    # one unit for each of the last axis's components, or none if the text does not say
    units = text.split(", ")
    if len(units) == 1:
        return units * count
    if len(units) == count:
        return units
    if len(units) == 2 and count == 4:  # three axes, and yaw
        return [units[0]] * 3 + [units[1]]
    return []


def _unit_exponents(text: str) -> dict[str, int] | None:
    """Return the exponents of the SI base units of a unit such as "N s^2/m^2", or None if it has others."""
    powers: dict[str, int] = {}
    for sign, part in zip(itertools.chain([1], itertools.repeat(-1)), text.split("/"), strict=False):
        for factor in part.strip("()").split():
            match = re.fullmatch(r"(\w+?)(?:\^(-?\d+))?", factor)
            base = _BASE.get(match.group(1)) if match else None
            if match is None or base is None:
                return None
            for name, power in base.items():
                powers[name] = powers.get(name, 0) + sign * int(match.group(2) or 1) * power
    return {name: power for name, power in powers.items() if power}


def description(
    law: Exportable, bundle: Bundle, gains: Vector, sources: Sequence[str], *, fmi: int, fed: Sequence[str] = ()
) -> bytes:
    """Return the file modelDescription.xml of FMI 2.0 or 3.0."""
    return _text(
        "modelDescription.xml",
        fmi=fmi,
        name=bundle.name,
        id=bundle.id,
        robot=is_robot_law(law),
        version=__version__,
        period=repr(float(law.dt)),
        sources=sources,
        numbers=_variables(law, bundle.envelope or anywhere(law), gains, fed=fed),
        exponents=_unit_exponents,
        codes="; ".join(f"{code}: {meaning}" for _, code, meaning in status_table(law)),
        outputs_from=law.inputs.size + law.gains.size,
    )


def _text(file: str, **values: Any) -> bytes:
    return templates().get_template(f"{file}.j2").render(values).encode()


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
    If `x86_64-w64-mingw32-gcc` or the package `ziglang` is installed, the unit contains a library for Windows too. If
    the bundle has a mission, the unit feeds the controller with it.

    Args:
        bundle: the bundle that was exported from this law.
        gains: tuned gains (np,), as in the bundle.
        fmi: version of the standard, 2 (FMI 2.0) or 3 (FMI 3.0).

    Raises:
        ToolMissing: there is no C compiler.
        InputError: this version of FMI has no name for this machine, or the folder cannot be written.

    Example:
        >>> from zipfile import ZipFile
        >>> from surctl.export import write_fmu
        >>> from surctl.export.bundle import build_bundle
        >>> from surctl.testing import cart_system
        >>> law = cart_system().controller
        >>> file = write_fmu(law, build_bundle(law, {"k": 1.0}), law.gains.pack(), "fmu")
        >>> file.path.name, ZipFile(file.path).namelist()[0]
        ('brake.fmu', 'modelDescription.xml')
    """
    machine = (platform.system(), platform.machine())
    if machine not in _PLATFORMS[fmi]:
        remedy = "export c99 here, or export the FMU on Linux and compile its sources for this machine"
        raise InputError(f"has no name in FMI {fmi}.0", key="target", value=" ".join(machine), remedy=remedy)
    fed = bundle.fed if bundle.mission_rows else ()
    sources = unit_sources(law, bundle, fmi=fmi)
    compiled = [file for file in sources if file.endswith(".c")]
    members = {"modelDescription.xml": description(law, bundle, gains, compiled, fmi=fmi, fed=fed)}
    if fmi == 3:
        members["sources/buildDescription.xml"] = _text("buildDescription.xml", name=bundle.name, sources=compiled)
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
    place, ending = _PLATFORMS[fmi]["Windows", "AMD64"]
    if shutil.which(_WINDOWS):
        builds.append((place, ending, _WINDOWS, (*_REPRODUCIBLE, "-static-libgcc", *_PE)))
    elif packaged := packaged_compiler():
        builds.append((place, ending, f"{packaged} -target x86_64-windows-gnu", _REPRODUCIBLE))
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
    held = io.BytesIO()
    # uncompressed, because versions of zlib write different bytes
    with zipfile.ZipFile(held, "w", zipfile.ZIP_STORED) as archive:
        for member, data in members.items():
            entry = zipfile.ZipInfo(member, _DATE)
            entry.create_system, entry.external_attr = 3, 0o644 << 16
            archive.writestr(entry, data)
    return ExportedFile(write_file(folder / name, held.getvalue()), hashlib.sha256(held.getvalue()).hexdigest())
