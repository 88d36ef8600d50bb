"""Claims as dataclasses: each attribute states where a claim has it, and how it is read; numbers are exact decimals."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, field, fields
from fractions import Fraction
from functools import partial
from typing import Any, TypeVar

from surctl.certcheck.document import Rejected, record

__all__ = [
    "Pair", "choice", "number", "ordered", "placed", "read_fields", "read_top", "row", "two", "written", "zero",
]  # fmt: skip

Pair = tuple[Fraction, Fraction]
Claim = TypeVar("Claim")

_LARGEST = 10**9
_MOST_NUMBERS = 12  # in a row


def placed(place: str, read: Callable[..., Any], *, default: Any = MISSING, **how: Any) -> Any:
    """Return the field of a dataclass that a claim has at `place` ("group.key", or "key").

    Args:
        place: where it is.
        read: the reader, a function of the value and of the place in words.
        default: value of an object that is not read.
        **how: further arguments of the reader.
    """
    return field(default=default, metadata={"place": place, "read": partial(read, **how)})


def _places(cls: type) -> Iterator[tuple[str, str, str, Callable[[Any, str], Any]]]:
    """Yield attribute, group, key and reader of each attribute that has a place."""
    for one in fields(cls):
        if "place" in one.metadata:
            group, _, key = one.metadata["place"].rpartition(".")
            yield one.name, group, key, one.metadata["read"]


def read_fields(cls: type[Claim], claim: Mapping[str, Any], where: str = "claim", **others: Any) -> Claim:
    """Return an object of the dataclass with the entries of a claim; `others` are attributes without a place.

    Raises:
        Rejected: a group has other keys than those of the dataclass, or an entry cannot be read.
    """
    places, values = list(_places(cls)), dict[str, Any]()
    groups = {group: [key for _, own, key, _ in places if own == group] for _, group, _, _ in places}
    for group, keys in groups.items():
        record(claim[group] if group else claim, keys, f"{where}.{group}" if group else where)
    for name, group, key, read in places:
        path = ".".join(filter(None, (where, group, key)))
        values[name] = read((claim[group] if group else claim)[key], path)
    return cls(**values, **others)


def written(cls: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return plain data that `read_fields` reads as these values, by attribute."""
    whole: dict[str, Any] = {}
    for name, group, key, _ in _places(cls):
        (whole.setdefault(group, {}) if group else whole)[key] = _plain(values[name])
    return whole


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(entry) for entry in value]
    return float(value) if isinstance(value, Fraction) else value


def number(value: Any, where: str, *, least: Fraction | int = 0, above: bool = False) -> Fraction:
    """Return the printed decimal of a number; raise Rejected if the number is < least (≤ least with `above`)."""
    whole = type(value) is int and abs(value) <= _LARGEST
    if not whole and not (type(value) is float and math.isfinite(value)):
        raise Rejected(f"{where} must be a finite number of at most {_LARGEST}")
    exact = Fraction(repr(value))
    if exact < least or (above and exact == least):
        raise Rejected(f"{where} must be {'above' if above else 'at least'} {least}, not {value!r}")
    if abs(exact) > _LARGEST or (exact and abs(exact) < Fraction(1, 10**18)):
        raise Rejected(f"{where} is too large or too close to 0: {value!r}")
    return exact


def two(value: Any, where: str, *, least: Fraction | int = 0, above: bool = False) -> Pair:
    """Return two numbers, see `number`."""
    if not isinstance(value, list) or len(value) != 2:
        raise Rejected(f"{where} must have two entries")
    first, second = (number(entry, where, least=least, above=above) for entry in value)
    return first, second


def ordered(value: Any, where: str, *, above: bool = False) -> Pair:
    """Return the least and the largest value of a range, see `number`."""
    low, high = two(value, where, above=above)
    if low > high:
        raise Rejected(f"{where}: the least value exceeds the largest")
    return low, high


def row(value: Any, where: str) -> tuple[Fraction, ...]:
    """Return a list of numbers."""
    if not isinstance(value, list) or not 1 <= len(value) <= _MOST_NUMBERS:
        raise Rejected(f"{where} must be a list of 1 to {_MOST_NUMBERS} numbers")
    return tuple(number(entry, where) for entry in value)


def zero(value: Any, where: str) -> Fraction:
    """Return the gain of integral action, which must be 0."""
    if number(value, where):
        raise Rejected(f"{where} must be 0: the certified loop has no integral action")
    return Fraction(0)


def choice(value: Any, where: str, *, of: Sequence[str]) -> str:
    """Return one of some words."""
    if value not in of:
        raise Rejected(f"{where} must be {' or '.join(of)}")
    return str(value)


def read_top(claim: Any, system: str, groups: Sequence[str], texts: str, stated: Sequence[str]) -> Mapping[str, Any]:
    """Return the entries of a claim about this system.

    Args:
        claim: the claim.
        system: name of the system.
        groups: further keys.
        texts: key of the texts that a certificate repeats word for word.
        stated: these texts.

    Raises:
        Rejected: keys, system, texts or digests are not as expected.
    """
    top = record(claim, ("system", texts, *groups, "sha256_vehicle", "sha256_law"), "claim")
    if top["system"] != system:
        raise Rejected(f"claim.system {top['system']!r} is not known; known: {system}")
    if top[texts] != list(stated):
        raise Rejected(f"claim.{texts} differs from the text that this checker expects")
    for key in ("sha256_vehicle", "sha256_law"):
        if not isinstance(top[key], str) or not re.fullmatch("[0-9a-f]{64}", top[key]):
            raise Rejected(f"claim.{key} is not a SHA-256")
    return top
