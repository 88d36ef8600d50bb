"""Names of the previous release that have changed; this release accepts the old names with a warning."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

__all__ = ["OldName", "current_arguments", "current_table"]

_OPTIONS = MappingProxyType({"--ladder": "--fallback"})
_LAWS = MappingProxyType({"lean": "closed_form"})
_PARAMETERS = MappingProxyType({"scenario.reach": "scenario.arrival_radius"})
_KEYS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {"scenario": {"reach_m": "arrival_m"}, "study": {"flights": "runs"}, "run": {"drawn": "draw"}}
)
_VALUES: Mapping[str, Mapping[str, str]] = MappingProxyType({"law": _LAWS, "stopped_because": {"halted": "standstill"}})


class OldName(UserWarning):
    """A command or file uses a name that the next release no longer accepts."""


def current_table(table: Mapping[str, Any], *, file: object) -> dict[str, Any]:
    """Return the table of a file with old keys and values replaced by the current names.

    Warns:
        OldName: a key or value has a new name.

    Example:
        >>> import warnings
        >>> from surctl.renamed import current_table
        >>> with warnings.catch_warnings(record=True) as caught:
        ...     warnings.simplefilter("always")
        ...     table = current_table({"kind": "scenario", "reach_m": 0.1}, file="pool.toml")
        >>> table
        {'kind': 'scenario', 'arrival_m': 0.1}
        >>> print(caught[0].message)
        pool.toml: reach_m is now arrival_m; surctl 0.2 will refuse the old name
    """
    keys = _KEYS.get(str(table.get("kind")), {})
    result: dict[str, Any] = {}
    for key, value in table.items():
        name = keys.get(key, key)
        if name != key and name in table:
            name = key  # the table has both names: the model rejects the old one
        elif name != key:
            _warn(f"{file}: {key}", name)
        known = _VALUES.get(name, {})
        if isinstance(value, str) and value in known:
            _warn(f"{file}: {name} = {value!r}", repr(known[value]))
            value = known[value]
        result[name] = value
    return result


def current_arguments(arguments: Sequence[str]) -> list[str]:
    """Return the arguments of a command with the current names of options, laws and parameters.

    Warns:
        OldName: an option, law or parameter has a new name.

    Example:
        >>> import warnings
        >>> from surctl.renamed import current_arguments
        >>> with warnings.catch_warnings(record=True) as caught:
        ...     warnings.simplefilter("always")
        ...     print(current_arguments(["export", "--law", "lean", "--ladder=bounded"]))
        ['export', '--law', 'closed_form', '--fallback=bounded']
    """
    result = list[str]()
    for argument in arguments:
        before, equals, after = argument.partition("=")
        if before in _OPTIONS or before in _PARAMETERS:
            name = _OPTIONS.get(before) or _PARAMETERS[before]
            _warn(before, name)
            argument = f"{name}{equals}{after}"
        elif before == "--law" and after in _LAWS:
            _warn(argument, f"--law={_LAWS[after]}")
            argument = f"--law={_LAWS[after]}"
        elif result[-1:] == ["--law"] and argument in _LAWS:
            _warn(f"--law {argument}", f"--law {_LAWS[argument]}")
            argument = _LAWS[argument]
        result.append(argument)
    return result


def _warn(old: str, new: str) -> None:
    warnings.warn(f"{old} is now {new}; surctl 0.2 will refuse the old name", OldName, stacklevel=3)
