"""C text that accesses the numbers of a layout (a list of named arrays, the ports): declarators, members, loops."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from surctl.ir import Layout, Port

__all__ = ["entries", "field", "starts", "transfers"]


def starts(layout: Layout) -> list[tuple[Port, int]]:
    """Return the ports that are not empty, with the index of their first entry in the flat vector."""
    return [(port, layout.slice(port.name).start) for port in layout if port.size]


def field(port: Port) -> str:
    """Return the C declarator of a port: a scalar for one entry, else an array of the port's shape, row by row."""
    return port.name if port.size == 1 else port.name + "".join(f"[{n}]" for n in port.shape)


def entries(ports: Layout | Sequence[Port], base: int = 0) -> list[tuple[str, int]]:
    """Return (C member access, flat index) of every number in layout order; the index starts at `base`."""
    members: list[str] = []
    for port in ports:
        if port.size == 1:
            members.append(port.name)
            continue
        indices = itertools.product(*(range(n) for n in port.shape))
        members += [port.name + "".join(f"[{i}]" for i in index) for index in indices]
    return [(member, base + at) for at, member in enumerate(members)]


def transfers(ports: Layout | Sequence[Port], base: int = 0) -> list[tuple[str, str, str]]:
    """Return C loops over every number of the ports in layout order, one loop for each port.

    Returns:
        (loop header, C member access, C text of the flat index) of each port. The loop header is empty for a single
        number, and otherwise leaves one brace open. The index starts at `base`.
    """
    items, at = [], base
    for port in ports:
        if port.size == 1:
            items.append(("", port.name, str(at)))
        elif port.size:
            items.append(_loops(port, at))
        at += port.size
    return items


def _loops(port: Port, at: int) -> tuple[str, str, str]:
    names = [f"k{d}" if len(port.shape) > 1 else "k" for d in range(len(port.shape))]
    loops = " ".join(f"for (int {k} = 0; {k} < {n}; ++{k})" for k, n in zip(names, port.shape, strict=True))
    strides = [math.prod(port.shape[d + 1 :]) for d in range(len(port.shape))]
    terms = [k if stride == 1 else f"{stride} * {k}" for k, stride in zip(names, strides, strict=True)]
    member = port.name + "".join(f"[{k}]" for k in names)
    return f"{loops} {{ ", member, " + ".join([str(at)] * bool(at) + terms)
