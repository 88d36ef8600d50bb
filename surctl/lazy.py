"""Packages whose names load their modules at first use, so that a command imports only what it needs."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

__all__ = ["LazyPackage", "load_at_first_use"]


class LazyPackage(ModuleType):
    """A package that imports the module of a public name when the name is first used; see `load_at_first_use`.

    Example:
        >>> import surctl.tuning
        >>> surctl.tuning.Axis.__module__  # imports this module only
        'surctl.tuning.design'
    """

    _homes: Mapping[str, tuple[str, str]]
    _cached: bool

    def __getattr__(self, name: str) -> Any:
        """Import the module that defines a public name, and return the name's value.

        Raises:
            AttributeError: the package has no such name.
        """
        home = self.__dict__.get("_homes", {}).get(name)
        if home is None:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        module, attribute = home
        value = getattr(import_module(module), attribute)
        if self._cached:
            self.__dict__[name] = value
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute, but let no module hide the public name that it shares, as `sweep.sweep` does."""
        if not (isinstance(value, ModuleType) and name in self._homes):
            super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        """Return the names of the package, those not loaded yet included."""
        return sorted({*super().__dir__(), *self._homes})


_IMPORT = re.compile(r"^ +from (\S+) import (?:\(([^)]*)\).*|(.*))$", re.MULTILINE)


def load_at_first_use(package: str, *, cache: bool = True) -> None:
    """Make a package or module load each of its names when the name is used.

    These are the names that it imports under `TYPE_CHECKING`, for type checkers, also under another name (`as`).

    Args:
        package: full name of the package, its `__name__`.
        cache: whether a value is stored; else each use finds what the name then means where it is defined.

    Example:
        >>> import surctl.tuning
        >>> type(surctl.tuning).__name__, "tune_system" in dir(surctl.tuning)
        ('LazyPackage', True)
    """
    module = sys.modules[package]
    source = Path(str(module.__file__)).read_text(encoding="utf-8")
    homes = module.__dict__["_homes"] = {}
    for home, listed, alone in _IMPORT.findall(source):
        for name in filter(None, map(str.strip, (listed or alone).split(","))):
            attribute, _, shown = name.partition(" as ")
            homes[shown or attribute] = home, attribute
    module.__dict__["_cached"] = cache
    module.__class__ = LazyPackage
