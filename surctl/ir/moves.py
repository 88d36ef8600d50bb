"""What a program only hands on: long pieces of its inputs that stand in its outputs as they are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from surctl.ir.program import Program

__all__ = ["Move", "handed_on"]

_LEAST = 32  # entries, from which on one call that copies is shorter than a line an entry


@dataclass(frozen=True)
class Move:
    """Entries `to` … `to` + `count` − 1 of an output are entries from `start` on of an input."""

    output: int
    to: int
    input: int
    start: int
    count: int


def handed_on(program: Program) -> tuple[Move, ...]:
    """Every piece of at least 32 entries, in the order of the outputs."""
    return tuple(move for output in range(len(program.outputs)) for move in _of(program, output))


def _of(program: Program, output: int) -> Iterator[Move]:
    refs, at = program.output_refs[output], 0
    while at < len(refs):
        count = 1
        first = program.instructions[refs[at]]
        if first.op == "input":
            while at + count < len(refs):
                following = program.instructions[refs[at + count]]
                if following.op != "input" or following.args != (first.args[0], first.args[1] + count):
                    break
                count += 1
            if count >= _LEAST:
                yield Move(output, at, first.args[0], first.args[1], count)
        at += count
