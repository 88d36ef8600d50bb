"""The instruction lists of a bundle: the text of law and plant as files, and the vectors that they compute with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.export.contract import Exportable, commands, telemetry_ports
from surctl.ir import Block, Layout

__all__ = ["LAW", "Listed", "law_list"]

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
