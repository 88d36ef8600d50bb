"""Numbers that take seconds to compute, stored on disk by their arguments and by the source code that computed them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

from surctl.errors import SurctlError
from surctl.ir import cached_bytes, source_digest
from surctl.vehicle import Vehicle

__all__ = ["HashedVehicle", "stored_numbers"]


class HashedVehicle:
    """A vehicle that compares by name and parameters, as a key of a cache."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle, self.key = vehicle, (vehicle.name, vehicle.digest())

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, HashedVehicle) and self.key == other.key


def stored_numbers(key: tuple[object, ...], compute: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return the numbers of `key`, from the cache on disk if a process with this source code stored them.

    Args:
        key: everything on which the numbers depend beside the source code, with an exact `repr`.
        compute: returns the numbers as JSON can hold them; its exceptions are passed on.
    """
    try:
        sources = source_digest("surctl")
    except SurctlError:  # the source code is missing or changed since the import, so it cannot identify the numbers
        return compute()
    text = f"{sources}\0{version('scipy')}\0{key!r}"
    stored = cached_bytes(hashlib.sha256(text.encode()).hexdigest(), ".json", lambda: json.dumps(compute()).encode())
    numbers: dict[str, Any] = json.loads(stored)
    return numbers
