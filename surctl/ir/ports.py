"""Ports: named parts of a flat vector with unit, default and rule for gaps; values by name, wrong names and sizes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias, cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.units import as_numbers, is_number

Gap: TypeAlias = Literal["keep", "age", "anew"]


@dataclass(frozen=True)
class Port:
    """A named part of a flat vector, with its shape, unit, meaning and default value.

    Attributes:
        name: name that is a valid C identifier.
        shape: (n,) for a vector, or (rows, columns) for a matrix that is stored row by row.
        unit: SI unit as text without brackets, "1" if dimensionless.
        meaning: description, with the frame.
        default: value of all numbers of the part if the caller supplies none, or a list with a value for each.
        gap: what the exported step does with this part of a controller's state after periods without a step: `keep` it,
            let it grow as an `age` [s] up to its default, or begin `anew` with the default after a long gap.
    """

    name: str
    shape: tuple[int, ...]
    unit: str
    meaning: str
    default: float = 0.0
    gap: Gap = "keep"

    def __post_init__(self) -> None:
        """Raise InputError, which names the part, if an attribute has the wrong type or the default is not finite."""
        key = f"port {self.name}"
        for attribute in ("name", "unit", "meaning"):
            if not isinstance(value := getattr(self, attribute), str):
                raise InputError("is not a text", key=f"{key}.{attribute}", value=value, remedy="write it in quotes")
        shape: object = self.shape
        sizes = shape if isinstance(shape, tuple) else ()
        if len(sizes) not in (1, 2) or any(isinstance(n, bool) or not isinstance(n, int) or n < 0 for n in sizes):
            remedy = "write (n,) for a vector, (rows, columns) for a matrix"
            raise InputError("is not a shape", key=f"{key}.shape", value=self.shape, remedy=remedy)
        default: object = self.default
        if isinstance(default, list | tuple) and np.shape(default) == (self.size,):
            default = np.array(default)
            object.__setattr__(self, "default", default)
        entries = default.tolist() if isinstance(default, np.ndarray) and default.shape == (self.size,) else [default]
        if not all(map(is_number, entries)):
            remedy = "give one finite number, which all entries get, or a list with one for each"
            raise InputError("is not a finite number", key=f"{key}.default", value=default, remedy=remedy)

    @cached_property
    def size(self) -> int:
        """Return how many numbers the port contains."""
        return math.prod(self.shape)


class _Named(dict[str, ca.SX]):
    """Parts by name; an unknown name raises an InputError that suggests a similar name."""

    def __missing__(self, name: object) -> ca.SX:
        raise InputError("no such name here", key=str(name), remedy=nearest(str(name), self))


class Layout:
    """An ordered set of ports, stored one after another in one flat vector (row by row inside a port)."""

    def __init__(self, ports: Iterable[Port] | Port) -> None:
        if isinstance(ports, Port):
            raise InputError("is one port", key=f"port {ports.name}", remedy="write Layout((port,))")
        try:
            self.ports: tuple[Port, ...] = tuple(ports)
        except TypeError:
            raise InputError("is no list of ports", key="Layout", value=ports, remedy="write Layout((port,))") from None
        for port in self.ports:
            if not isinstance(cast("object", port), Port):
                raise InputError("is no Port", key="Layout", value=port, remedy="give surctl.ir.Port(...)")
        names = [p.name for p in self.ports]
        for name in names:
            if names.count(name) > 1:
                raise InputError("is the name of two ports", key=name, remedy="rename one of them")
        self._by_name = {p.name: p for p in self.ports}
        self._slices: dict[str, slice] = {}
        at = 0
        for port in self.ports:
            self._slices[port.name] = slice(at, at + port.size)
            at += port.size
        self.size = at
        self._defaults = np.concatenate([np.full(p.size, p.default, dtype=float) for p in self.ports] or [np.zeros(0)])

    def __iter__(self) -> Iterator[Port]:
        return iter(self.ports)

    def __contains__(self, name: object) -> bool:
        return name in self._slices

    def slice(self, name: str) -> slice:
        """Return the index range of the port in the flat vector."""
        self.port(name)
        return self._slices[name]

    def port(self, name: str) -> Port:
        """Return the port with this name; an unknown name raises an InputError that suggests a similar name."""
        if name in self._by_name:
            return self._by_name[name]
        raise InputError("no such field", key=name, remedy=nearest(name, self._slices))

    def pack(self, values: Mapping[str, object] | None = None) -> NDArray[np.float64]:
        """Return a flat vector from values by port name; a port without a value gets its default."""
        flat = self._defaults.copy()
        values = {} if values is None else values
        if not isinstance(cast("object", values), Mapping):
            raise InputError("is not a dict of values by name", key="values", value=values, remedy='write {"k": 2.0}')
        for name, value in values.items():
            port = self.port(name)
            array = as_numbers(value, key=name)
            if array.size != port.size:
                raise InputError(
                    f"has {array.size} numbers, expected shape {port.shape}", key=name, remedy=port.meaning
                )
            flat[self._slices[name]] = array.reshape(-1)
        return flat

    def unpack(self, flat: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Return the arrays of a flat vector by port name; the arrays are views."""
        return {p.name: flat[self._slices[p.name]].reshape(p.shape) for p in self.ports}

    def symbols(self, prefix: str = "") -> tuple[ca.SX, dict[str, ca.SX]]:
        """Return a flat SX symbol and its parts by port name; each part has the port's shape (vectors are columns)."""
        flat = ca.SX.sym(prefix or "x", self.size)
        return flat, self.split(flat)

    def split(self, flat: ca.SX) -> dict[str, ca.SX]:
        """Return the parts of a flat SX vector by port name; each part has the port's shape (vectors are columns)."""
        parts: dict[str, ca.SX] = _Named()
        for port in self.ports:
            block = flat[self.slice(port.name)]
            parts[port.name] = ca.reshape(block, port.shape[1], port.shape[0]).T if len(port.shape) == 2 else block
        return parts

    def join(self, parts: Mapping[str, ca.SX]) -> ca.SX:
        """Return a flat SX vector from parts by port name; every port needs a part."""
        blocks = []
        for port in self.ports:
            block = ca.SX(parts[port.name])
            if len(port.shape) == 2:
                block = block.T
            if block.numel() != port.size:
                raise InputError(f"has {block.numel()} entries, expected {port.size}", key=port.name)
            blocks.append(ca.reshape(block, -1, 1))
        return ca.vertcat(*blocks)
