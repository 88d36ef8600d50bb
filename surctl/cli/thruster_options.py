"""Failures of thrusters on the command line: `--fault thruster:NAME[:START[:DURATION]]`."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from surctl.marine.simulation import ThrusterFault

__all__ = ["FORM", "parse_thruster_fault", "split_faults"]

FORM = "thruster:NAME[:START[:DURATION]]"
_KIND = "thruster:"


def split_faults(texts: Sequence[str], *, refused: str | None = None) -> tuple[tuple[str, ...], list[ThrusterFault]]:
    """Return the texts of sensor faults, and the thruster faults.

    `refused` says why a command accepts no thruster faults; None: it accepts them.

    Raises:
        InputError: a thruster fault cannot be read, or `refused` is given and there is one.
    """
    from surctl.errors import InputError

    mine = [text for text in texts if text.startswith(_KIND)]
    if mine and refused is not None:
        raise InputError("is not for this command", key="--fault", value=mine[0], remedy=refused)
    return tuple(text for text in texts if text not in mine), [parse_thruster_fault(text) for text in mine]


def parse_thruster_fault(text: str) -> ThrusterFault:
    """Return the fault written as thruster:NAME[:START[:DURATION]], times in s.

    Raises:
        InputError: a part is missing, superfluous, not a number or out of range.
    """
    from surctl.errors import InputError
    from surctl.marine.simulation import ThrusterFault

    name, *times = text.removeprefix(_KIND).split(":")
    numbers = []
    for part in times:
        try:
            numbers.append(float(part))
        except ValueError:
            numbers.append(-inf)
    start = numbers[0] if numbers else 0.0
    duration = numbers[1] if len(numbers) > 1 else inf
    good = name and len(numbers) <= 2 and isfinite(start) and start >= 0 and duration > 0
    if not good:
        raise InputError("is not a thruster fault", key="--fault", value=text, remedy=f"write {FORM}, times in s")
    return ThrusterFault(name, start, duration)
