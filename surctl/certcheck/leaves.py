"""The numbers and texts of a claim, each of which must be bound to the exported controller.

A claim is a tree of data. Its leaves are numbers, texts, truth values, nulls and empty containers. A comparison takes a
leaf by its path, and so marks it; a leaf that nothing takes is unbound. So a new entry of a claim cannot be forgotten.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

__all__ = ["Leaves"]

Path = tuple[str | int, ...]


class Leaves:
    """A claim whose entries are taken by path.

    Example:
        >>> from surctl.certcheck.leaves import Leaves
        >>> leaves = Leaves({"law": {"k1": 0.3, "mass": [95.0, 96.0]}, "rate": 0.1})
        >>> leaves.take("law", "k1"), leaves.take("law", "mass", 0)
        (0.3, 95.0)
        >>> leaves.left()
        ['law.mass[1] = 96.0', 'rate = 0.1']
    """

    def __init__(self, claim: Mapping[str, Any]) -> None:
        self._claim = claim
        self._bound: set[Path] = set()

    def take(self, *path: str | int) -> Any:
        """Return the entry at a path, and mark all its leaves as bound; KeyError or IndexError if there is none."""
        value: Any = self._claim
        for step in path:
            value = value[step]
        self._bound.add(path)
        return value

    def left(self) -> list[str]:
        """Return path and value of each leaf that was not taken."""
        return [f"{_name(path)} = {value!r}" for path, value in self._leaves((), self._claim)]

    def _leaves(self, path: Path, value: Any) -> Iterator[tuple[Path, Any]]:
        if path in self._bound:
            return
        if isinstance(value, dict | list) and value:
            for step, entry in value.items() if isinstance(value, dict) else enumerate(value):
                yield from self._leaves((*path, step), entry)
        else:
            yield path, value


def _name(path: Path) -> str:
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path).removeprefix(".")
