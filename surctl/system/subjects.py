"""Systems by name: FILE.py:FUNCTION in the user's folder, or subject:NAME of an installed package."""

from __future__ import annotations

import contextlib
import hashlib
import sys
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from surctl.errors import InputError, nearest
from surctl.own_code import is_own, label, object_of, pinned
from surctl.system.loop import System

SUBJECTS = "surctl.subjects"
"""Group of entry points under which a package registers functions that return a `System`."""

_PREFIX = "subject:"


@dataclass(frozen=True)
class LoadedSystem:
    """A system, the text from which another process loads it, its name without folder, and the hash of its file."""

    system: System
    reference: str
    label: str
    sha256: str


def is_subject(word: str) -> bool:
    """Return whether a word names a system: FILE.py:FUNCTION or subject:NAME."""
    return is_own(word) or word.startswith(_PREFIX)


def load_subject(word: str, *, key: str = "system") -> LoadedSystem:
    """Return the system that a word names; what its code prints goes to stderr.

    Args:
        word: FILE.py:FUNCTION, or subject:NAME for a function that an installed package registers as NAME, an entry
            point of the group `SUBJECTS`. The function takes no argument and returns a `System`.
    """
    if word.startswith(_PREFIX):
        return _registered(word.removeprefix(_PREFIX), key)
    reference = pinned(word, key=key)
    return LoadedSystem(
        object_of(reference, System, key=key), reference, label(reference), reference.rpartition("#")[2]
    )


def registered_subjects() -> dict[str, str]:
    """Return the function MODULE:FUNCTION of each registered system by name."""
    return {entry.name: entry.value for entry in sorted(entry_points(group=SUBJECTS))}


@cache
def _registered(name: str, key: str) -> LoadedSystem:
    entries = {entry.value: entry for entry in entry_points(group=SUBJECTS, name=name)}
    if not entries:
        known = registered_subjects()
        remedy = nearest(name, known) if known else f"install one with an entry point in the group {SUBJECTS}"
        raise InputError("no installed package registers it", key=key, value=name, remedy=remedy)
    if len(entries) > 1:
        remedy = "uninstall one of the packages"
        raise InputError(f"is registered twice, as {' and '.join(sorted(entries))}", key=key, value=name, remedy=remedy)
    [entry] = entries.values()
    system = _built(entry, key)
    file = Path(getattr(sys.modules[entry.module], "__file__", None) or "")
    text = file.read_bytes() if file.is_file() else entry.value.encode()
    return LoadedSystem(system, f"{_PREFIX}{name}", f"{_PREFIX}{name}", hashlib.sha256(text).hexdigest())


def _built(entry: EntryPoint, key: str) -> System:
    try:
        with contextlib.redirect_stdout(sys.stderr):  # what the package prints must not stand in a command's JSON
            system = entry.load()()
    except (Exception, SystemExit) as error:
        text = " ".join(f"{entry.value} fails with {type(error).__name__}: {error}".split())
        raise InputError(text, key=key, value=entry.name, remedy="correct the package") from error
    if not isinstance(system, System):
        problem = f"{entry.value} returns {type(system).__name__}, not System"
        raise InputError(problem, key=key, value=entry.name, remedy="return a surctl System")
    return system
