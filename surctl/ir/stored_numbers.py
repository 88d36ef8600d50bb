"""Numbers that take long to compute, stored on disk by their arguments and by the code that computed them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from importlib.metadata import version
from typing import Any

from surctl.errors import SurctlError
from surctl.ir.cache import cached_bytes
from surctl.ir.sources import source_digest

__all__ = ["stored_numbers"]


def stored_numbers(
    sources: Sequence[str], key: Sequence[object], compute: Callable[[], dict[str, Any]], *, suffix: str = ".json"
) -> dict[str, Any]:
    """Return the numbers of `key`, from the cache on disk if a process with the same source code stored them.

    Args:
        sources: packages or modules that contain the code, as in `source_digest`.
        key: everything on which the numbers depend beside the code, with an exact `repr`; arrays as `tobytes()`.
        compute: returns the numbers as JSON can hold them; its exceptions are passed on.
        suffix: suffix of the entry's file, with the dot.
    """
    try:
        digest = source_digest(*sources)
    except SurctlError:  # the source code is missing or changed since the import, so it cannot identify the numbers
        return compute()
    text = f"{digest}\0{version('scipy')}\0{tuple(key)!r}"
    stored = cached_bytes(hashlib.sha256(text.encode()).hexdigest(), suffix, lambda: json.dumps(compute()).encode())
    numbers: dict[str, Any] = json.loads(stored)
    return numbers
