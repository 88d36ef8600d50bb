"""What an application adds to the bundle of its controller: files, texts, instruction lists, manifest entries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.export.contract import Exportable, commands, telemetry_ports
from surctl.ir import Block, Layout, Real
from surctl.system import Plant

__all__ = ["LAW", "Listed", "PlantLists", "Supplement", "law_list"]

Vector = NDArray[np.float64]

LAW = "law.txt"
"""File of a bundle with the instruction list of the exported law; its SHA-256 is the digest of the law."""


@dataclass(frozen=True, eq=False)
class Listed:
    """An instruction list as a file of a bundle.

    Attributes:
        block: the program or routine.
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
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Action, Controller
        >>> class Licence(Supplement):
        ...     @property
        ...     def files(self):
        ...         return {"NOTICE.txt": "Pump controller of plant 7.\\n"}
        >>> level = Layout((Port("level", (1,), "m", "measured"),))
        >>> drive = Layout((Port("drive", (1,), "V", "of the pump"),))
        >>> pump = Controller("pump", 0.1, level, drive, lambda x, u, p: Action(-2.0 * u["level"]))
        >>> bundle = build_bundle(pump, {}, supplement=Licence())
        >>> bundle.files["NOTICE.txt"]
        'Pump controller of plant 7.\\n'
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
    """The instruction lists of the plant that a controller was designed for, with its parameters (np,).

    Example:
        >>> import numpy as np
        >>> from surctl.export.bundle import build_bundle
        >>> from surctl.export.supplement import PlantLists
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Controller, Plant
        >>> level, flow = Port("level", (1,), "m", "of the water"), Port("flow", (1,), "m/s", "inflow over the area")
        >>> tank = Plant("tank", Layout((level,)), Layout((flow,)), lambda x, f, d, p: f["flow"] - 0.1 * x["level"])
        >>> law = Controller("held", 0.1, tank.state, tank.inputs, lambda x, u, p: -u["level"])
        >>> bundle = build_bundle(law, {}, supplement=PlantLists(tank, np.zeros(0)))
        >>> [name for name in bundle.files if name.startswith(("law", "plant"))]
        ['law.txt', 'plant.txt', 'plant_measured.txt']
    """

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
