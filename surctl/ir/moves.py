"""Moves: long pieces of a program's inputs that the program copies to its outputs unchanged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from surctl.ir.numbering import Numbering
from surctl.ir.program import Instruction, Program, drop_dead

__all__ = ["Move", "copy_loop", "entry", "handed_on", "move_lines", "only_moves", "rearranged", "remaining"]

_FEW = 8  # largest number of pieces of a program of moves that is written inline at its call
_LEAST = 8  # from this many entries on, one call that copies is shorter than one line for each entry
_LEAST_LOOP = 4  # from this many entries on, one loop that copies is shorter than one line for each entry


@dataclass(frozen=True)
class Move:
    """Copy of entries `start`, `start` + `step`, … of an input to entries `to`, `to` + `to_step`, … of an output."""

    output: int
    to: int
    input: int
    start: int
    count: int
    to_step: int = 1
    step: int = 1

    @property
    def entries(self) -> range:
        """Return the indices of the entries in the output."""
        return range(self.to, self.to + self.to_step * self.count, self.to_step)


def rearranged(name: str, inputs: Mapping[str, int], outputs: Mapping[str, Sequence[tuple[str, int, int]]]) -> Program:
    """Return a program that copies pieces of its inputs; it is built much faster than from a CasADi function.

    Args:
        name: name of the program.
        inputs: number of entries of each input.
        outputs: for each output, its pieces in order: name of the input, first entry, entry after the last.

    Raises:
        InputError: a piece is not inside its input.

    Example:
        >>> from surctl.ir import rearranged, replay
        >>> swapped = rearranged("swapped", {"x": 3}, {"y": [("x", 2, 3), ("x", 0, 2)]})
        >>> replay(swapped, [1.0, 2.0, 3.0])[0].tolist()
        [3.0, 1.0, 2.0]
    """
    code, which = Numbering(), {array: k for k, array in enumerate(inputs)}
    refs = [
        tuple([code.add("input", (which[array], entry)) for array, first, end in pieces for entry in range(first, end)])
        for pieces in outputs.values()
    ]
    sizes = tuple((output, len(entries)) for output, entries in zip(outputs, refs, strict=True))
    return Program(name, tuple(inputs.items()), sizes, tuple(code.instructions), tuple(refs))


def handed_on(program: Program, *, strided: bool = False) -> tuple[Move, ...]:
    """Return the moves of at least 8 entries, in output order; with `strided`, of at least 4 entries and any step."""
    return tuple(
        move
        for output in range(len(program.outputs))
        for move in (_strided(program, output) if strided else _of(program, output))
    )


def only_moves(program: Program) -> tuple[Move, ...]:
    """Return the moves, in output order, of a program that is only a few moves; return () for any other program."""
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


def _strided(program: Program, output: int) -> Iterator[Move]:
    """Yield the longest possible moves to an output, with step 1 in the input or in the output."""
    loads = {
        at: i.args
        for at, ref in enumerate(program.output_refs[output])
        if (i := program.instructions[ref]).op == "input"
    }
    where: dict[tuple[int, ...], list[int]] = {}
    for at, args in loads.items():
        where.setdefault(args, []).append(at)
    free = set(loads)
    for at in loads:
        if at not in free:
            continue
        which, start = loads[at]
        steps = {(1, loads[at + 1][1] - start)} if at + 1 in free and loads[at + 1][0] == which else set()
        steps |= {(other - at, 1) for other in where.get((which, start + 1), ()) if other > at and other in free}
        best = Move(output, at, which, start, 1)
        for to_step, step in sorted(steps):
            count = 1
            while at + to_step * count in free and loads[at + to_step * count] == (which, start + step * count):
                count += 1
            if count > best.count:
                best = Move(output, at, which, start, count, to_step, step)
        if best.count >= _LEAST_LOOP:
            free -= set(best.entries)
            yield best


def remaining(
    program: Program, moves: Sequence[Move]
) -> tuple[tuple[Instruction, ...], tuple[tuple[int, int, int], ...]]:
    """Return the program without the moves: instructions, and (output, entry, list position) of each other value."""
    moved = {(m.output, e) for m in moves for e in m.entries}
    stored = [(k, e) for k, refs in enumerate(program.output_refs) for e in range(len(refs)) if (k, e) not in moved]
    refs: list[tuple[int, ...]] = [(program.output_refs[k][e],) for k, e in stored]
    instructions, positions = drop_dead(list(program.instructions), refs)
    return instructions, tuple((k, e, ref) for (k, e), (ref,) in zip(stored, positions, strict=True))


def move_lines(moves: Sequence[Move]) -> list[str]:
    """Return the C99 lines of the moves, for outputs that do not alias inputs."""
    return [
        copy_loop(entry(f"out{m.output}", m.to, m.to_step), entry(f"in{m.input}", m.start, m.step), m.count)
        for m in moves
    ]


def entry(array: str, first: int, step: int = 1) -> str:
    """Return the start of the C text of an array entry; the caller appends the loop counter and the closing bracket."""
    return "".join([array, "[", f"{first} + " if first else "", f"{step} * " if step != 1 else ""])


def copy_loop(to: str, source: str, count: int) -> str:
    """Return a C99 loop that copies `count` numbers; `to` and `source` are texts returned by `entry`.

    The comment in the loop is for Frama-C, which regards an array as fully written only after it has unrolled the loop.
    """
    return f"    /*@ loop unroll {count}; */\n    for (int k = 0; k < {count}; ++k) {{ {to}k] = {source}k]; }}"
