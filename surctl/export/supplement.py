"""What an application adds to a bundle; ageing of the state after missed samples, restarts; gains, README, statuses."""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.bundle import numbers_sha256, ports_sha256
from surctl.export.contract import Exportable, commands, telemetry_ports
from surctl.ir import Block, Layout, Real
from surctl.system import Plant

# Wiring of an exported law, for the README of its bundle: what is known of its inputs


Vector = NDArray[np.float64]

RESTART = 10
"""Number of older samples, after the first, whose numbers must rise before the counter counts as started again."""

_MEMORY = 0.15
"""[s] Longest gap between two accepted steps after which estimates from the last steps still describe the present."""


def longest_gap(dt: float) -> int:
    """Return the largest number of periods between two accepted steps after which short memories are kept."""
    return max(1, int(_MEMORY / dt + 1e-9))


def aged(law: Exportable, x: Vector, periods: int, *, real: Real) -> Vector:
    """Return the state (nx,) `periods` after the last accepted step, as the exported C computes it before the law.

    A part of the state with the rule `age` grows by the missed periods, up to its initial value, which is the largest
    age. A part with the rule `anew` returns to its initial value after more than `longest_gap` periods.
    """
    number = np.dtype(real).type
    out, start = np.array(x, dtype=float), np.asarray(law.initial_state(), dtype=real).astype(float)
    more = number(periods - 1) * number(law.dt)
    for port in law.state:
        part = law.state.slice(port.name)
        if port.gap == "age":
            out[part] = np.minimum(out[part].astype(real) + more, start[part].astype(real))
        elif port.gap == "anew" and periods > longest_gap(law.dt):
            out[part] = start[part]
    return out


def forgotten(law: Exportable) -> str:
    """Return the names of the parts of the state that begin anew after a long gap."""
    return ", ".join(port.name for port in law.state if port.gap == "anew")


def aged_runs(law: Exportable, text: Callable[[float], str]) -> list[tuple[int, int, str]]:
    """Return (first index, end, C text of the largest age) of the entries of the state that grow in a gap."""
    return list(_runs(law, "age", text))


def forgotten_runs(law: Exportable, text: Callable[[float], str]) -> list[tuple[int, int, str]]:
    """Return (first index, end, C text of the initial value) of the entries that begin anew after a long gap."""
    return list(_runs(law, "anew", text))


def _runs(law: Exportable, rule: str, text: Callable[[float], str]) -> Iterator[tuple[int, int, str]]:
    start = law.initial_state()
    rules = [port.gap for port in law.state for _ in range(port.size)]
    entries = ((k, text(float(start[k]))) for k in range(law.state.size) if rules[k] == rule)
    for value, group in groupby(enumerate(entries), key=lambda item: (item[1][0] - item[0], item[1][1])):
        indices = [k for _, (k, _) in group]
        yield indices[0], indices[-1] + 1, value[1]


def wiring_values(law: Exportable) -> dict[str, Any]:
    """Return the values of the template of the wiring section, for a controller of which no more is known."""
    return {
        "wiring": "wiring.md.j2",
        "equipment": None,
        "vehicle": None,
        "thrusters": (),
        "ages": [port.name for port in law.state if port.gap == "age"],
        "restart_samples": RESTART,
        "gap_s": f"{longest_gap(law.dt) * law.dt:.3g}",
        "kept_periods": longest_gap(law.dt),
        "flag_names": [port.name for port in law.inputs if port.name == "fresh" or port.name.endswith("_fresh")],
        "own_age": False,
        "arriving": False,
        "stalling": [],
        "listening": False,
        "coasting": (),
        "own_known": False,
        "fed": False,
        "rows": [],
        "safe_periods": max(1, round(1.0 / law.dt)),
        "input_defaults": {port.name: np.asarray(port.default).tolist() for port in law.inputs if np.any(port.default)},
    }


# Storage of gains in the bytes of the exported C: key of the law, head, CRC-32, and the id of law and gains


_VERSION = 1
_KEY = 8  # bytes


def law_lines(law: Exportable, real: Real) -> list[str]:
    """Return what the id of a law is a hash of: digests of its list, ports and initial state, period, precision."""
    digests = law.block.digest(), ports_sha256(law_list(law).entry())
    return [*digests, float(law.dt).hex(), real, numbers_sha256(law.initial_state().tolist())]


def stored_gains(law: Exportable, gains: NDArray[np.float64], real: Real) -> bytes:
    """Return the bytes in which the exported `gains_save` stores gains (np,); every number is little-endian."""
    body = _head(law, real) + np.asarray(gains, dtype=real).astype(np.dtype(real).newbyteorder("<")).tobytes()
    return body + struct.pack("<I", zlib.crc32(body))


def gains_id(law: Exportable, gains: NDArray[np.float64], real: Real) -> str:
    """Return the id of law and gains that the exported `gains_id` computes, as 8 hexadecimal digits."""
    return f"{struct.unpack('<I', stored_gains(law, gains, real)[-4:])[0]:08x}"


def gains_values(law: Exportable, real: Real) -> dict[str, Any]:
    """Return the values of the template of the C file that stores gains."""
    head = _head(law, real)
    return {
        "gains_head": ", ".join(f"0x{byte:02x}U" for byte in head),
        "gains_bytes": len(head) + law.gains.size * np.dtype(real).itemsize + 4,
    }


def _head(law: Exportable, real: Real) -> bytes:
    width = np.dtype(real).itemsize
    # start of the SHA-256 of the lines of the law's id, without that of the gains
    key = hashlib.sha256("\n".join(law_lines(law, real)).encode()).digest()[:_KEY]
    return b"SURG" + struct.pack("<HHI", _VERSION, width, law.gains.size) + key


LAW = "law.txt"
"""File of a bundle with the instruction list of the exported law; its SHA-256 is the digest of the law."""


@dataclass(frozen=True, eq=False)
class Listed:
    """An instruction list as a file of a bundle.

    Attributes:
        vectors: layout of each vector that it reads or computes, by the name in the manifest.
        numbers: values by the name in the manifest: the name of the vector whose values they are, and these.
    """

    block: Block
    vectors: Mapping[str, Layout]
    numbers: Mapping[str, tuple[str, Vector]] = field(default_factory=dict)

    def entry(self) -> dict[str, Any]:
        """Return the entry of the manifest: the digest, and for each vector its ports or its values."""
        ports = {
            name: [f"{port.name}[{port.size}] {port.unit}" for port in layout] for name, layout in self.vectors.items()
        }
        values = {name: _short(self.vectors[of], vector) for name, (of, vector) in self.numbers.items()}
        return {"sha256": self.block.digest(), **ports, **values}


def _short(layout: Layout, vector: Vector) -> list[float | list[float]]:
    # for each port one number, if all its entries are equal: a map has thousands
    rows = [vector[layout.slice(port.name)].tolist() for port in layout]
    return [row[0] if row and all(entry.hex() == row[0].hex() for entry in row) else row for row in rows]


def law_list(law: Exportable) -> Listed:
    """Return the instruction list of a law: command, next state, status and telemetry from state, inputs and gains."""
    vectors = {"state": law.state, "inputs": law.inputs, "gains": law.gains}
    results = {"commands": Layout(commands(law)), "telemetry": Layout(telemetry_ports(law))}
    return Listed(law.block, vectors | results, {"initial_state": ("state", law.initial_state())})


class Supplement:
    """Additions to a bundle. This class adds nothing; an application derives a class and overrides what it adds.

    Example:
        >>> from surctl.export import Supplement
        >>> from surctl.export.bundle import build_bundle
        >>> from surctl.testing import cart_system
        >>> class Licence(Supplement):
        ...     @property
        ...     def files(self):
        ...         return {"NOTICE.txt": "Brake of cart 7"}
        >>> build_bundle(cart_system().controller, {"k": 1.0}, supplement=Licence()).files["NOTICE.txt"]
        'Brake of cart 7'
    """

    @property
    def files(self) -> dict[str, str]:
        """Return the texts of further files by name, such as certificates."""
        return {}

    def fed(self, law: Exportable) -> tuple[str, ...]:
        """Return the names of gains that code of the bundle writes itself while it runs."""
        del law
        return ()

    def templates(self, law: Exportable) -> dict[str, str]:
        """Return the names of templates in `surctl/export/templates`, by the name of the C file that each makes."""
        del law
        return {}

    def values(self, law: Exportable, real: Real) -> dict[str, Any]:
        """Return values of the templates; they replace those of the core, see `wiring_values`."""
        del law, real
        return {}

    def entries(self, law: Exportable, p: Vector) -> dict[str, Any]:
        """Return further entries of the manifest; p (np,) are the gains."""
        del law, p
        return {}

    def lists(self, law: Exportable) -> dict[str, Listed]:
        """Return further instruction lists by file name, beside that of the law."""
        del law
        return {}

    def check(self, manifest: Mapping[str, Any], files: Mapping[str, str]) -> None:
        """Raise InputError if an addition does not belong to the controller of this manifest and these files."""


_PLANT, _MEASURED = "plant.txt", "plant_measured.txt"


@dataclass(frozen=True, eq=False)
class PlantLists(Supplement):
    """The instruction lists of the plant that a controller was designed for, with its parameters (np,)."""

    plant: Plant
    parameters: Vector

    def lists(self, law: Exportable) -> dict[str, Listed]:
        """Return the lists of x' from x, f, d and p, and of y from x, d and p."""
        del law
        plant = self.plant
        vectors = {"state": plant.state, "inputs": plant.inputs, "disturbances": plant.disturbances}
        flow = Listed(
            plant.block, vectors | {"parameters": plant.parameters}, {"values": ("parameters", self.parameters)}
        )
        return {_PLANT: flow, _MEASURED: Listed(plant.measured, {"outputs": plant.measurements})}
