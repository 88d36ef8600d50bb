"""Storage of programs and routines as text, from which equal programs and routines (with equal digests) can be read.

The text is data; no part of it is executed. A text that is not exactly the text of a program or routine is refused.
"""

from __future__ import annotations

import gc
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import NoReturn

from surctl.errors import InputError, mistakes_in
from surctl.ir.procedure import Procedure
from surctl.ir.program import OPERATIONS, Instruction, Program
from surctl.ir.routine import Block, Call, Gather, Loop, Routine, Step, own_text

_ARITY = {name: operation.arity for name, operation in OPERATIONS.items()}
_DEEPEST = 50  # largest nesting depth of routines; recursion over deeper ones would exhaust Python's stack
_LARGEST = 10**7  # numbers in an array of a procedure
_MALFORMED = (IndexError, KeyError, OverflowError, ValueError)  # exceptions that reading a malformed line raises


def write_block(block: Block) -> str:
    """Return a program or routine as text that `read_block` can read: `block.text()`, then `block.digest()`."""
    text = f"{block.text()}\nsha256 {block.digest()}\n"
    if read_block(text) != block:
        raise InputError("has ambiguous names of arrays", key=block.name, remedy="rename its arrays")
    return text


def read_block(text: str) -> Block:
    """Return the program or routine that `write_block` wrote; an inner one that several steps call is one object."""
    body, mark, seal = text.rpartition("\nsha256 ")
    try:
        own = hashlib.sha256(body.encode()).hexdigest()
    except UnicodeEncodeError as error:
        _refuse("contains invalid Unicode", body.count("\n", 0, error.start) + 1)
    if not mark or seal != f"{own}\n" or not body.endswith("\n"):
        _refuse("is cut off or altered: its SHA-256 differs", text.count("\n") + 1, seal.strip())
    with _without_collection():
        block = _read(body)
    if block.text() != body:
        _refuse("contains a block that the last one does not run, or in the wrong order", 1)
    return block


@contextmanager
def _without_collection() -> Iterator[None]:
    # garbage collection would scan all programs and routines repeatedly while they are read
    searching = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if searching:
            gc.enable()


def _read(body: str) -> Block:
    """Return the last program or routine in the text."""
    blocks: dict[str, Block] = {}
    depths: dict[int, int] = {}
    first = 1
    for text in body[:-1].split("\n\n"):
        lines = text.split("\n")
        kind = lines[0].partition(" ")[0]
        block: Block
        if kind == "routine":
            block = _routine(lines, first, blocks)
        else:
            block = _procedure(lines, first) if kind == "procedure" else _program(lines, first)
        inner = [depths[id(s.block)] for s in getattr(block, "steps", ()) if not isinstance(s, Gather)]
        depths[id(block)] = 1 + max(inner, default=0)
        if depths[id(block)] > _DEEPEST:
            _refuse(f"has more than {_DEEPEST} nested blocks", first, lines[0])
        key = f"{block.name}:{block.digest()[:16]}"
        if key in blocks:
            _refuse("has the name and digest of another block", first, lines[0])
        blocks[key] = block
        first += len(lines) + 1
    return block


def _program(lines: Sequence[str], first: int) -> Program:
    # the first of these lines is line `first` of the text
    name = _name(lines, first, "program")
    inputs = _inputs(lines, first, "in{}")
    start = 1 + len(inputs)
    end = len(lines)
    while end > start and lines[end - 1].startswith("out"):
        end -= 1
    instructions, places = _instructions(lines[start:end], inputs, first + start)
    outputs: list[tuple[str, int]] = []
    references: list[tuple[int, ...]] = []
    for at, line in enumerate(lines[end:], first + end):
        try:
            which, output, *words = line.split(" ")
            _same(which, f"out{len(outputs)}")
            references.append(tuple([places[word] for word in words]))
        except _MALFORMED:
            _refuse("is not an output of this program", at, line)
        outputs.append((output, len(words)))
    program = Program(name, tuple(inputs), tuple(outputs), tuple(instructions), tuple(references))
    program.__dict__["_text"] = "\n".join([*lines, ""])  # only this text is read as this program
    return program


def _instructions(
    lines: Sequence[str], inputs: Sequence[tuple[str, int]], first: int
) -> tuple[list[Instruction], dict[str, int]]:
    # the loop must be fast, for tens of thousands of instructions
    instructions: list[Instruction] = []
    places: dict[str, int] = {}
    at = 0
    try:
        for at, line in enumerate(lines):
            words = line.split(" ")
            op = words[2]
            if op in _ARITY:
                if len(words) == 5:  # most instructions
                    args: tuple[int, ...] = (places[words[3]], places[words[4]])
                else:
                    args = tuple([places[word] for word in words[3:]])
                if len(args) != _ARITY[op]:
                    _refuse(f"{op} takes {_ARITY[op]} operands", first + at, line)
                instructions.append(Instruction(op, args))
            elif op == "const":
                value = float.fromhex(words[3])
                if len(words) != 4 or value != value or value.hex() != words[3]:
                    _refuse("is not a constant: a number as float.hex writes it", first + at, line)
                instructions.append(Instruction(op, (), value))
            else:
                instructions.append(_load(op, inputs))
                if len(words) != 3:
                    _refuse("is an input with an operand", first + at, line)
            name = words[0]
            if words[1] != "=" or name != f"v{at}":
                _refuse(f"does not assign v{at}", first + at, line)
            places[name] = at
    except _MALFORMED:
        _refuse("is not an instruction on earlier values", first + at, lines[at])
    return instructions, places


def _load(word: str, inputs: Sequence[tuple[str, int]]) -> Instruction:
    which, entry = map(int, word[2:-1].split("["))
    _same(word, f"in{which}[{entry}]")
    if not (0 <= which < len(inputs) and 0 <= entry < inputs[which][1]):
        raise ValueError
    return Instruction("input", (which, entry))


def _routine(lines: Sequence[str], first: int, blocks: Mapping[str, Block]) -> Routine:
    # `blocks` has the earlier programs and routines, by name and digest
    name = _name(lines, first, "routine")
    inputs = _inputs(lines[:-1], first, "in")
    steps: list[Step] = []
    for at, line in enumerate(lines[1 + len(inputs) : -1], first + 1 + len(inputs)):
        try:
            steps.append(_step(line.split(" "), blocks))
        except _MALFORMED:
            _refuse("is not a step, or runs a block that does not precede it", at, line)
    with mistakes_in(f"line {first}"):
        routine = Routine(name, tuple(inputs), tuple(steps), tuple(lines[-1].split(" ")[1:]))
    for at, (own, line) in enumerate(zip(own_text(routine).split("\n"), lines, strict=False), first):
        if own != line:
            _refuse(f"should be {own!r}", at, line)
    return routine


def _procedure(lines: Sequence[str], first: int) -> Procedure:
    name = _name(lines, first, "procedure")
    ports: dict[str, list[tuple[str, int]]] = {"in": [], "out": [], "size": []}
    memory: list[tuple[str, str, int]] = []
    at = 1
    while at < len(lines) and not lines[at].startswith("def "):
        try:
            kind, own, size = lines[at].split(" ")
            if kind in ports:
                ports[kind].append((own, int(size)))
            else:
                memory.append((own, kind, int(size)))
        except _MALFORMED:
            _refuse("is not an array of a procedure", first + at, lines[at])
        at += 1
    sizes = [size for table in ports.values() for _, size in table] + [size for _, _, size in memory]
    if not all(0 <= size <= _LARGEST for size in sizes):
        _refuse("has an array of impossible size", first, lines[0])
    inputs, outputs, constants = (tuple(each) for each in ports.values())
    with mistakes_in(f"line {first}"):
        procedure = Procedure(name, inputs, outputs, constants, tuple(memory), "\n".join(lines[at:]))
    if procedure.text() != "\n".join([*lines, ""]):
        _refuse("is not written as a procedure is written", first, lines[0])
    return procedure


def _step(words: list[str], blocks: Mapping[str, Block]) -> Step:
    # comparison with the routine's text later detects extra or misplaced words
    equals = words.index("=")
    results, kind, rest = _names(words[:equals]), words[equals + 1], words[equals + 2 :]
    if kind == "gather":
        return Gather(rest[0], rest[1], int(rest[3]), results[0], int(rest[5]))
    block = blocks[rest[0]]
    if kind == "call":
        return Call(block, _names(rest[1:]), results)
    count, index, until = int(rest[2]), bool(int(rest[4])), None if rest[6] == "None" else int(rest[6])
    lists: list[tuple[str, ...]] = []
    start = rest.index("carried")
    for mark in ("sliced", "fixed", "spread", "lanes"):
        end = rest.index(mark, start + 1)
        lists.append(_names(rest[start + 1 : end]))
        start = end
    carried, sliced, fixed, spread = lists
    return Loop(block, count, carried, results, sliced, fixed, index, until, spread, int(rest[start + 1]))


def _names(words: Sequence[str]) -> tuple[str, ...]:
    return tuple([word for word in words if word])


def _name(lines: Sequence[str], first: int, kind: str) -> str:
    head, _, name = lines[0].partition(" ")
    if head != kind or not name or " " in name:
        _refuse(f"is not the first line of a {kind}", first, lines[0])
    return name


def _inputs(lines: Sequence[str], first: int, mark: str) -> list[tuple[str, int]]:
    inputs: list[tuple[str, int]] = []
    for at, line in enumerate(lines[1:], first + 1):
        words = line.split(" ")
        if len(words) != 3 or words[0] != mark.format(len(inputs)):
            break
        try:
            size = int(words[2])
            _same(words[2], str(size))
        except ValueError:
            _refuse("is not the size of an input", at, line)
        if size < 0:
            _refuse("is not the size of an input", at, line)
        inputs.append((words[1], size))
    return inputs


def _same(word: str, own: str) -> None:
    if word != own:
        raise ValueError


def _refuse(problem: str, line: int, value: str | None = None) -> NoReturn:
    raise InputError(problem, key=f"line {line}", value=value)
