"""Certificates with something altered, and sealed again as if nobody had."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from surctl.certcheck import seal

Way: TypeAlias = tuple[Any, ...]


def sealed(changed: dict[str, Any]) -> dict[str, Any]:
    """The altered document with the hash mended."""
    rest = {k: v for k, v in changed.items() if k not in ("format", "version", "kind", "claim", "sha256")}
    return seal(changed["kind"], changed["claim"], rest)


def numbers(value: Any, path: Way = ()) -> list[Way]:
    """Where its numbers stand."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    if isinstance(value, int | float) and not isinstance(value, bool):
        return [path]
    return [p for key, entry in items for p in numbers(entry, (*path, key))]


def value_of(whole: Any, path: Way) -> Any:
    """What stands there."""
    for key in path:
        whole = whole[key]
    return whole


def put(whole: dict[str, Any], path: Way, value: Any) -> dict[str, Any]:
    """The document itself, with that value there."""
    value_of(whole, path[:-1])[path[-1]] = value
    return whole


def altered(
    whole: dict[str, Any], parts: Sequence[str], rng: np.random.Generator, spreads: Sequence[float] = (0.1, 1.5)
) -> tuple[Way, dict[str, Any]]:
    """One number of these parts changed, a little, a lot, or in its sign: where, and the document, not sealed."""
    changed = copy.deepcopy(whole)
    paths = [(part, *path) for part in parts for path in numbers(changed[part])]
    path = paths[rng.integers(len(paths))]
    factor = rng.choice([*(np.exp(rng.normal(scale=spread)) for spread in spreads), -1.0])
    old = value_of(changed, path)
    return path, put(changed, path, float(old * factor) if old else float(rng.uniform(0, 1)))
