"""What a program only hands on: long pieces of its inputs that stand in its outputs as they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from surctl.ir.program import Instruction, Program, drop_dead

__all__ = ["Move", "copy_loop", "entry", "handed_on", "move_lines", "only_moves", "remaining"]

_FEW = 8  # pieces up to which a program of nothing but moves is written where it is called
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


def only_moves(program: Program) -> tuple[Move, ...]:
    """All of it as a few pieces, in the order of the outputs; nothing if it does anything else, or if they are many."""
    if any(i.op != "input" for i in program.instructions) or not all(program.output_refs):
        return ()
    moves = tuple(move for output in range(len(program.outputs)) for move in _of(program, output, 1))
    return moves if len(moves) <= _FEW else ()


def _of(program: Program, output: int, least: int = _LEAST) -> Iterator[Move]:
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
            if count >= least:
                yield Move(output, at, first.args[0], first.args[1], count)
        at += count


def remaining(
    program: Program, moves: Sequence[Move]
) -> tuple[tuple[Instruction, ...], tuple[tuple[int, int, int], ...]]:
    """What is left to do beside the moves: the instructions, and (output, entry, position of its value) in order."""
    moved = {(m.output, e) for m in moves for e in range(m.to, m.to + m.count)}
    stored = [(k, e) for k, refs in enumerate(program.output_refs) for e in range(len(refs)) if (k, e) not in moved]
    refs: list[tuple[int, ...]] = [(program.output_refs[k][e],) for k, e in stored]
    instructions, kept = drop_dead(list(program.instructions), refs)
    return instructions, tuple((k, e, ref) for (k, e), (ref,) in zip(stored, kept, strict=True))


def move_lines(moves: Sequence[Move]) -> list[str]:
    """C99 of the moves, for outputs that are no inputs."""
    return [copy_loop(entry(f"out{m.output}", m.to), entry(f"in{m.input}", m.start), m.count) for m in moves]


def entry(array: str, first: int) -> str:
    """C text of an entry's beginning, to which the counter and ] are added."""
    return f"{array}[{first} + " if first else f"{array}["


def copy_loop(to: str, source: str, count: int) -> str:
    """C99 that copies `count` numbers from one `entry` on to another.

    The comment is for Frama-C: to it an array that a loop fills is filled once the loop is unrolled.
    """
    return f"    /*@ loop unroll {count}; */\n    for (int k = 0; k < {count}; ++k) {{ {to}k] = {source}k]; }}"
