"""Differential evolution over ranges in batches; journal for a resume, lock of the folder, best gains so far."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surctl.files import write_file
from surctl.store import ChunkStore

Array = NDArray[np.float64]

_STORE = "tune.chunks"


@dataclass(frozen=True)
class SearchRange:
    """A searched number and its range low … high, which includes both ends; a range above 0 has a log scale."""

    name: str
    low: float
    high: float

    @property
    def log(self) -> bool:
        """Whether the search uses a log scale."""
        return self.low > 0

    def clip(self, value: float) -> float:
        """Clip a value to the range."""
        return min(max(value, self.low), self.high)

    def place(self, unit: Array) -> Array:
        """Convert shares 0 … 1 of the range, on its scale, to values."""
        share = np.asarray(unit, dtype=float)
        at = self.low * (self.high / self.low) ** share if self.log else self.low + (self.high - self.low) * share
        return np.clip(at, self.low, self.high)

    def unit(self, values: Array) -> Array:
        """Convert values to shares of the range, limited to 0 … 1; the inverse of `place`."""
        at = np.asarray(values, dtype=float)
        share = np.log(at / self.low) / np.log(self.high / self.low) if self.log else at - self.low
        return np.clip(share if self.log else share / (self.high - self.low), 0.0, 1.0)


class Journal:
    """The finished batches of searches in a folder; only one process at a time can hold it.

    Args:
        folder: output folder of a tuning; None keeps the batches in memory.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self._memory: dict[str, dict[int, Array]] = {}

    @contextmanager
    def held(self) -> Iterator[None]:
        """Lock the folder inside the `with` statement; InputError if it cannot be written, or is in use."""
        with nullcontext() if self.folder is None else ChunkStore(self.folder / _STORE, "").open():
            yield

    def batches(self, request: str, *, width: int) -> Batches:
        """Return the batches of the search with a request (a text), which have rows of `width` numbers."""
        store = self._store(request)
        if store is not None:
            store.folder.mkdir(parents=True, exist_ok=True)
        return Batches(width, store, self._memory.setdefault(request, {}))

    def note_best(self, name: str, text: str) -> None:
        """Write the best gains so far as text to a file in the folder; InputError if it cannot be written."""
        if self.folder is not None:
            write_file(self.folder / name, text)

    def _store(self, request: str) -> ChunkStore | None:
        digest = hashlib.sha256(request.encode()).hexdigest()
        return None if self.folder is None else ChunkStore(self.folder / _STORE / digest[:16], digest)


@dataclass
class Batches:
    """The batches of one search, in the order of their evaluation: rows of a set of numbers and its results.

    Attributes:
        width: numbers in a row.
        store: the stored batches; None without a folder.
        memory: tables of the request in this process, by the index of the batch.
        tables: the tables (rows, width) so far.
    """

    width: int
    store: ChunkStore | None
    memory: dict[int, Array]
    tables: list[Array] = field(default_factory=list)

    def known(self, count: int, after: int = 0) -> Array | None:
        """Return the stored table of the next batch, with `count` rows, or of one `after` it; None if there is none."""
        index, shape = len(self.tables) + after, (count, self.width)
        if self.store is None:
            return self.memory.get(index)
        if not self.store.has(index, shape):
            return None
        return np.column_stack([self.store.column(index, shape, k) for k in range(self.width)])

    def add(self, table: Array, *, restored: bool = False) -> None:
        """Add the table of the next batch, and store it unless it is `restored`; InputError if the disk is full."""
        if not restored and self.store is not None:
            self.store.write(len(self.tables), table)
        elif not restored:
            self.memory[len(self.tables)] = table
        self.tables.append(table)

    def evaluated(self, sets: Array, evaluate: Callable[[Array], Array]) -> Array:
        """Return the rows (n, width) of the next batch of sets (n, d): the stored ones, or those of `evaluate`."""
        table = self.known(len(sets))
        restored = table is not None and np.array_equal(table[:, : sets.shape[1]], sets)
        if table is None or not restored:
            table = np.column_stack([sets, evaluate(sets)])
        self.add(table, restored=restored)
        return table


def evolve(
    value: Callable[[Array], Array],
    ranges: Sequence[SearchRange],
    *,
    size: int,
    batches: int,
    seed: int,
    first: Sequence[Sequence[float]] = (),
) -> None:
    """Minimise a function of sets of numbers by scipy's differential evolution, whose generations are the batches.

    The proposals of a batch depend on the seed and on the values of the batches before, but not on their number.

    Args:
        value: function from sets (n, numbers) to values (n,); smaller is better.
        ranges: the numbers.
        size: about the number of sets in a batch, at least 5.
        batches: number of batches.
        seed: seed of the proposals.
        first: sets with which the first batch begins; the others of this batch fill the ranges evenly.
    """
    from scipy.optimize import differential_evolution

    count = len(ranges)
    begun = [list(one) for one in first[:size]]
    start: Array | str = "latinhypercube"
    if begun:
        from scipy.stats import qmc  # takes half a second to import

        own = np.column_stack([r.unit(column) for r, column in zip(ranges, np.array(begun).T, strict=True)])
        start = np.vstack([own, qmc.LatinHypercube(count, rng=seed).random(size - len(begun))])

    def of(points: Array) -> Array:
        nonlocal begun
        sets = np.column_stack([r.place(share) for r, share in zip(ranges, points, strict=True)])
        sets[: len(begun)] = begun or sets[:0]  # exactly, not by way of its share of the range
        begun = []
        return value(sets)

    differential_evolution(
        of, [(0.0, 1.0)] * count, init=start, popsize=max(1, round(size / count)), maxiter=max(0, batches - 1),
        seed=seed, polish=False, vectorized=True, updating="deferred", tol=0,
    )  # fmt: skip
