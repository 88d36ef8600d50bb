"""Numbers of runs by name: gains, plant parameters, references, start, seeds; ranges and their corners."""

from __future__ import annotations

import hashlib
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, nearest
from surctl.ir import Layout, Port
from surctl.system.loop import System
from surctl.system.parts import entry_units
from surctl.units import as_numbers, as_range

Array = NDArray[np.float64]
_NAME = re.compile(r"(?:(?P<group>\w+)\.)?(?P<port>\w+)(?:\[(?P<entry>\d+)\])?")
_NAMED = 4  # largest number of entries that a message names
_SEED = Layout((Port("seed", (1,), "1", "of the noise"),))
_MOST_RANGES = 6  # uncertain numbers, which have 64 corners


@dataclass(frozen=True)
class RunNumbers:
    """Numbers of n runs; row k of each array is run k.

    Attributes:
        start, plant, reference, disturbance, gains: start states, parameters, references, disturbances, gains.
        blocks: parameters of all sampled blocks, one after another.
        seed: (n,) seeds of the noise.
    """

    start: Array
    plant: Array
    reference: Array
    disturbance: Array
    gains: Array
    blocks: Array
    seed: Array

    @property
    def count(self) -> int:
        """Return the number of runs."""
        return len(self.start)

    def digest(self) -> str:
        """Return the SHA-256 of all numbers."""
        digest = hashlib.sha256()
        for one in fields(self):
            digest.update(getattr(self, one.name).tobytes())
        return digest.hexdigest()


def run_numbers(system: System, values: Mapping[str, ArrayLike] | None) -> RunNumbers:
    """Return the numbers of all runs from the given values; a part (port) without a value has its default.

    Args:
        values: values by the name of a gain (`k`), or by `plant.NAME`, `reference.NAME`, `disturbance.NAME`,
            `start.NAME`, `BLOCK.NAME` for a parameter of a sampled block, or `seed` for the noise; with `[i]`, the name
            denotes one entry of a port. A scalar holds for every run and entry; an array (n,) has one number for each
            run (for a port with one entry); an array (n, size) has one row for each run.
    """
    values = {} if values is None else values
    if not isinstance(cast("object", values), Mapping):
        raise InputError("is not a dict of numbers by name", key="values", value=values, remedy='write {"k": 2.0}')
    layouts = _layouts(system)
    placed: list[tuple[str, slice, Array]] = []
    count = 1
    for name, value in values.items():
        group, place = _place(name, layouts)
        array = as_numbers(value, key=name)
        if not np.isfinite(array).all():
            raise InputError("is not finite", key=name, remedy="give finite numbers")
        size = place.stop - place.start
        if array.ndim == 1 and size > 1:
            problem = f"has {len(array)} numbers, which are either one run or one number for each run"
            raise InputError(problem, key=name, remedy=f"give shape (1, {size}) for one run, (n, {size}) for n runs")
        if array.ndim > 2 or (array.ndim == 2 and array.shape[1] != size):
            raise InputError(f"has shape {array.shape}", key=name, remedy=f"give a number, (n,) or (n, {size})")
        if array.ndim:
            if not len(array):
                raise InputError("is empty", key=name, remedy="give a number for each run")
            if len(array) not in (1, count) and count != 1:
                raise InputError(f"is for {len(array)} runs, others for {count}", key=name, remedy="give one length")
            count = max(count, len(array))
        placed.append((group, place, array if array.ndim == 2 else array.reshape(-1, 1)))
    tables = {group: np.tile(layout.pack(), (count, 1)) for group, layout in layouts.items()}
    for group, place, array in placed:
        tables[group][:, place] = array
    blocks = np.hstack([np.zeros((count, 0)), *(tables[block.name] for block in system.blocks.all)])
    seed = _checked_seeds(tables["seed"][:, 0]) if system.blocks.noise else np.zeros(count)
    start, plant, reference = tables["start"], tables["plant"], tables["reference"]
    return RunNumbers(start, plant, reference, tables["disturbance"], tables["gains"], blocks, seed)


def _checked_seeds(seeds: Array) -> Array:
    wrong = (seeds != np.floor(seeds)) | (seeds < 0) | (seeds > 2**53)
    if wrong.any():
        remedy = "give whole numbers from 0 to 2^53"
        raise InputError("is not a seed", key="seed", value=float(seeds[wrong][0]), remedy=remedy)
    return seeds


def every_combination(*groups: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """Return the numbers of runs for every combination of the rows of groups; the rows of the first group vary slowest.

    Args:
        groups: numbers by name, as in `run_numbers`: scalars, (n,) or (n, size); the arrays of a group with more than
            one row have equal n.

    Raises:
        InputError: a name is in two groups, or the arrays of a group have different lengths.

    Example:
        >>> from surctl.system import every_combination
        >>> runs = every_combination({"k": [1.0, 2.0]}, {"start.x": [0.1, 0.2, 0.3], "plant.mass": 5.0})
        >>> runs["k"].tolist(), runs["start.x"].tolist(), float(runs["plant.mass"])
        ([1.0, 1.0, 1.0, 2.0, 2.0, 2.0], [0.1, 0.2, 0.3, 0.1, 0.2, 0.3], 5.0)
    """
    combined: dict[str, Array] = {}
    count = 1
    for group in groups:
        if not isinstance(cast("object", group), Mapping):
            raise InputError("is not a dict of numbers by name", key="values", value=group, remedy='write {"k": 2.0}')
        arrays = {name: as_numbers(value, key=name) for name, value in group.items()}
        rows = max((len(array) for array in arrays.values() if array.ndim), default=1)
        combined = {name: np.repeat(array, rows, axis=0) if array.ndim else array for name, array in combined.items()}
        for name, array in arrays.items():
            if name in combined:
                raise InputError("is in two groups", key=name, remedy="give it once")
            if array.ndim and len(array) not in (1, rows):
                raise InputError(f"has {len(array)} rows, others {rows}", key=name, remedy="give one length")
            whole = np.broadcast_to(array, (rows, *array.shape[1:])) if array.ndim else array
            combined[name] = np.concatenate([whole] * count) if array.ndim else array
        count *= rows
    return combined


def check_scalar(system: System, name: str) -> None:
    """Raise InputError if a name does not denote a scalar of the system; for a vector, it lists the entries."""
    size = len(_named(system, name)[0])
    if size > 1:
        entries = ", ".join(f"{name}[{k}]" for k in range(min(size, _NAMED))) + ", …" * (size > _NAMED)
        raise InputError(f"has {size} entries", key=name, remedy=f"name one: {entries}")


def checked_ranges(
    system: System, ranges: Mapping[str, tuple[float, float]], *, key: str = "ranges."
) -> dict[str, tuple[float, float]]:
    """Return the ranges of uncertain numbers, lower and upper bound by name as in `run_numbers`, after a check."""
    checked = {}
    for name, ends in ranges.items():
        check_scalar(system, name)
        checked[name] = as_range(ends, key=f"{key}{name}")
    if len(checked) > _MOST_RANGES:
        remedy = f"keep the {_MOST_RANGES} that matter most"
        raise InputError(f"are {len(checked)}: every corner is judged", key=key.rstrip("."), remedy=remedy)
    for name, (low, high) in checked.items():
        if not low <= (nominal := default_of(system, name)) <= high:
            text = f"{key}{name} = {(low, high)}: leaves out the nominal value, {nominal:g} {unit_of(system, name)}"
            warnings.warn(
                f"{text}, for which the nominal margins are; widen the range, or change the value", stacklevel=2
            )
    return checked


def default_of(system: System, name: str) -> float:
    """Return the system's own value of a single number, which has a name as in `run_numbers`."""
    return float(_named(system, name)[1][0])


def unit_of(system: System, name: str) -> str:
    """Return the unit of a single number of the system, which has a name as in `run_numbers`."""
    return _named(system, name)[0][0]


def place_of(system: System, name: str) -> tuple[str, slice]:
    """Return the group of a name (`gains`, `plant`, `reference`, `disturbance`, `start`) and its place there."""
    return _place(name, _layouts(system))


def _named(system: System, name: str) -> tuple[list[str], Array]:
    # units and own values of the entries that the name denotes
    layouts = _layouts(system)
    group, place = _place(name, layouts)
    return entry_units(layouts[group])[place], layouts[group].pack()[place]


def _layouts(system: System) -> dict[str, Layout]:
    return {
        "gains": system.controller.gains, "plant": system.plant.parameters, "reference": system.references,
        "disturbance": system.plant.disturbances, "start": system.plant.state,
        **{block.name: block.parameters for block in system.blocks.all},
        **({"seed": _SEED} if system.blocks.noise else {}),
    }  # fmt: skip


def _place(name: str, layouts: Mapping[str, Layout]) -> tuple[str, slice]:
    parts = _NAME.fullmatch(name) if isinstance(cast("object", name), str) else None
    group = "gains" if parts is None or parts["group"] is None else parts["group"]
    if name == "seed" and name in layouts:
        group = name
    if parts is None or group not in layouts or parts["port"] not in layouts[group]:
        known = [
            port.name if key in ("gains", "seed") else f"{key}.{port.name}"
            for key, layout in layouts.items()
            for port in layout
        ]
        raise InputError("no such number of the system", key=str(name), remedy=nearest(name, known))
    where = layouts[group].slice(parts["port"])
    if parts["entry"] is None:
        return group, where
    entry, size = int(parts["entry"]), where.stop - where.start
    if entry >= size:
        raise InputError(f"has {size} entries", key=name, remedy=f"count from 0 to {size - 1}")
    return group, slice(where.start + entry, where.start + entry + 1)
