"""Reader and evaluator of the instruction lists that an export writes, for the law, and for the plant of a user.

A list is text. Its SHA-256 is the digest of the law, from which the export computes the id that the C source returns. A
text has blocks, separated by blank lines: a program is a sequence of assignments, a routine calls earlier blocks, once
or in loops. A block is named by its name and the first 16 hexadecimal digits of its digest, which are computed again.
Constants are hexadecimal floating-point numbers, so each is exact.

A list is evaluated in an algebra: `Numbers` computes in double precision, as the exported float64 code does, at many
points at once; `surctl.certcheck.derivation` derives expressions.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.patience import go_on
from surctl.certcheck.procedures import evaluator

__all__ = ["Block", "Numbers", "digest", "evaluate", "read_list"]

Array: TypeAlias = NDArray[Any]

_DEEPEST = 50  # most blocks inside one another
_LARGEST = 60_000  # most numbers of a block and of the blocks that it runs
_TEXT, _PROCEDURE = 2_000_000, 100_000  # longest list, and procedure in it [bytes]
_TABLE = 1_000_000  # most numbers of all points that are evaluated together
_LONGEST = 10**9  # most operations of one evaluation; its time is limited too

_OPERATIONS: Mapping[str, tuple[int, Callable[..., Any]]] = {
    "add": (2, np.add),
    "sub": (2, np.subtract),
    "mul": (2, np.multiply),
    "div": (2, np.divide),
    "fma": (3, lambda a, b, c: a * b + c),
    "neg": (1, np.negative),
    "inv": (1, lambda a: 1.0 / a),
    "sq": (1, np.square),
    "twice": (1, lambda a: a + a),
    "sqrt": (1, np.sqrt),
    "fabs": (1, np.abs),
    "floor": (1, np.floor),
    "fmin": (2, lambda a, b: np.where(b < a, b, a)),
    "fmax": (2, lambda a, b: np.where(a < b, b, a)),
    "lt": (2, np.less),
    "le": (2, np.less_equal),
    "eq": (2, np.equal),
    "ne": (2, np.not_equal),
    "and": (2, lambda a, b: (a != 0) & (b != 0)),
    "or": (2, lambda a, b: (a != 0) | (b != 0)),
    "not": (1, lambda a: a == 0),
    "if_else_zero": (2, lambda c, a: np.where(c != 0, a, 0.0)),
    "select": (3, lambda c, a, b: np.where(c != 0, a, b)),
    "sin": (1, np.sin),
    "cos": (1, np.cos),
    "atan2": (2, np.arctan2),
    "acos": (1, np.arccos),
    **{name: (1, getattr(np, name)) for name in ("tan", "exp", "log", "tanh")},
}
"""Number of operands and function of each operation; a comparison is 1 or 0, and a number is true if it is not 0."""


class Numbers:
    """Double precision; values are arrays of n points."""

    dtype: Any = np.float64

    def constant(self, value: float) -> Any:
        """Return a constant of a list."""
        return np.float64(value)

    def apply(self, op: str, operands: Sequence[Any]) -> Any:
        """Return the result of an operation."""
        value = _OPERATIONS[op][1](*operands)
        return value if value.dtype == np.float64 else value.astype(np.float64)

    def truth(self, values: Array) -> NDArray[np.bool_]:
        """Return where values are not 0."""
        return np.asarray(values != 0)

    def places(self, values: Array, last: int) -> NDArray[np.intp]:
        """Return values rounded down to places from 0 to `last`; that of NaN is 0."""
        return np.where(values >= 1, np.where(values < last, values, last), 0).astype(np.intp)

    def procedure(self, run: Callable[[Sequence[Array]], list[Array]], vectors: Sequence[Array]) -> list[Array]:
        """Return the outputs of a procedure."""
        return run(vectors)


@dataclass(frozen=True, eq=False)
class Block:
    """A program or routine of a list.

    Attributes:
        name: its name.
        inputs, outputs: number of entries of each vector that it reads and computes.
        operations: largest number of operations of one evaluation.
        depth: number of blocks inside one another.
        size: largest number of numbers that it holds at a time, with the blocks that it runs.
        texts: text of each block that it runs, in the order of the list; its own is last.
        run: computes the outputs from the inputs, each an array (entries, n) for n points, in an algebra.
    """

    name: str
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    operations: int
    depth: int
    size: int
    texts: tuple[str, ...]
    run: Callable[[Sequence[Array], Numbers], list[Array]]

    @property
    def key(self) -> str:
        """Return the word by which a routine names the block."""
        return f"{self.name}:{digest(_joined(self.texts))[:16]}"


def digest(text: str) -> str:
    """Return the digest of a list."""
    return hashlib.sha256(text.encode()).hexdigest()


def read_list(text: str) -> Block:
    """Return the last block of a list; raise Rejected unless the text is a list that the checker can evaluate."""
    blocks: dict[str, Block] = {}
    try:
        if len(text) > _TEXT:
            raise ValueError(f"it has more than {_TEXT} characters")
        for part in text.removesuffix("\n").split("\n\n"):
            go_on()
            lines = part.split("\n")
            kind = lines[0].partition(" ")[0]
            block = _routine(lines, blocks) if kind == "routine" else _KINDS.get(kind, _program)(lines)
            blocks[block.key] = block
            if block.size > _LARGEST:
                raise ValueError(f"it holds more than {_LARGEST} numbers")
        if _joined(block.texts) != text:
            raise ValueError("a block is not run, or is in the wrong place")
    except (ValueError, IndexError, KeyError, OverflowError, SyntaxError, RecursionError, MemoryError) as error:
        problem = str(error) or "it is nested too deeply"  # which may take the memory of Python's parser
        raise Rejected(f"not an instruction list: {problem}") from None
    return block


def evaluate(block: Block, *vectors: Array) -> list[Array]:
    """Return the outputs (entries, n) of a block from its inputs (entries, n); raise Rejected for wrong sizes."""
    if tuple(len(vector) for vector in vectors) != block.inputs:
        raise Rejected(f"{block.name} takes vectors of {block.inputs} entries")
    (points,) = {v.shape[1] for v in vectors} or {1}
    part = max(1, _TABLE // max(1, block.size))
    with np.errstate(all="ignore"):
        pieces = [block.run([v[:, k : k + part] for v in vectors], _NUMBERS) for k in range(0, points, part)]
    return [np.hstack(piece) for piece in zip(*pieces, strict=True)]


_NUMBERS = Numbers()


def _joined(texts: Sequence[str]) -> str:
    return "\n".join(texts)


def _program(lines: Sequence[str]) -> Block:
    name = _head(lines[0], "program")
    names, sizes, at = _inputs(lines, "in{}")
    del names
    steps: list[tuple[str, tuple[int, ...]]] = []
    constants: dict[int, float] = {}
    loads: dict[int, tuple[int, int]] = {}
    known: dict[str, int] = {}
    while at < len(lines) and lines[at].startswith("v"):
        number = len(known)
        target, equals, op, *words = lines[at].split(" ")
        if (target, equals) != (f"v{number}", "="):
            raise ValueError(lines[at])
        if op == "const":
            constants[number] = _constant(*words)
        elif op in _OPERATIONS:
            if len(words) != _OPERATIONS[op][0]:
                raise ValueError(lines[at])
            steps.append((op, (number, *(known[word] for word in words))))
        else:
            loads[number] = _load(op, sizes)
            if words:
                raise ValueError(lines[at])
        known[target] = number
        at += 1
    outputs: list[tuple[int, ...]] = []
    for line in lines[at:]:
        mark, _, *words = line.split(" ")
        if mark != f"out{len(outputs)}":
            raise ValueError(line)
        outputs.append(tuple(known[word] for word in words))
    count = len(known)

    def run(vectors: Sequence[Array], algebra: Numbers) -> list[Array]:
        go_on()
        values: list[Any] = [0.0] * count
        for number, value in constants.items():
            values[number] = algebra.constant(value)
        for number, (vector, entry) in loads.items():
            values[number] = vectors[vector][entry]
        for op, (number, *operands) in steps:
            values[number] = algebra.apply(op, [values[k] for k in operands])
        points = max([vector.shape[1] for vector in vectors], default=1)
        return [_stacked([values[k] for k in places], points, algebra) for places in outputs]

    text = "\n".join([*lines, ""])
    return Block(name, sizes, tuple(map(len, outputs)), len(steps), 1, count, (text,), run)


def _procedure(lines: Sequence[str]) -> Block:
    name = _head(lines[0], "procedure")
    if sum(map(len, lines)) > _PROCEDURE:
        raise ValueError(f"{name} has more than {_PROCEDURE} characters")
    tables: dict[str, list[tuple[str, int]]] = {"in": [], "out": [], "size": []}
    memory: list[tuple[str, str, int]] = []
    at = 1
    while not lines[at].startswith("def "):
        kind, own, text = lines[at].split(" ")
        if kind in tables:
            tables[kind].append((own, _whole(text, 0, _LARGEST)))
        elif kind in ("real", "whole"):
            memory.append((own, kind, _whole(text, 0, _LARGEST)))
        else:
            raise ValueError(lines[at])
        at += 1
    ports = (tables["in"], tables["out"])
    run, operations = evaluator("\n".join(lines[at:]), dict(tables["size"]), memory, ports)
    inputs, outputs = (tuple(size for _, size in table) for table in ports)
    if operations > _LONGEST:
        raise ValueError(f"{name} is too large")
    size = sum(inputs) + sum(outputs) + sum(size for *_, size in memory)
    text = "\n".join([*lines, ""])
    return Block(name, inputs, outputs, operations, 1, size, (text,), lambda v, algebra: algebra.procedure(run, v))


_KINDS: Mapping[str, Callable[[Sequence[str]], Block]] = {"procedure": _procedure}


def _stacked(entries: Sequence[Any], points: int, algebra: Numbers) -> Array:
    table = np.empty((len(entries), points), dtype=algebra.dtype)
    for k, entry in enumerate(entries):
        table[k] = entry
    return table


def _constant(word: str) -> float:
    value = float.fromhex(word)
    if value != value or value.hex() != word:
        raise ValueError(word)
    return value


def _load(word: str, sizes: Sequence[int]) -> tuple[int, int]:
    match = re.fullmatch(r"in([0-9]{1,6})\[([0-9]{1,6})\]", word)
    if match is None:
        raise ValueError(word)
    vector, entry = int(match[1]), int(match[2])
    if not (vector < len(sizes) and entry < sizes[vector]):
        raise ValueError(word)
    return vector, entry


def _head(line: str, kind: str) -> str:
    word, _, name = line.partition(" ")
    if word != kind or not re.fullmatch(r"\w{1,200}", name):
        raise ValueError(line)
    return name


def _inputs(lines: Sequence[str], mark: str) -> tuple[list[str], tuple[int, ...], int]:
    """Return names and sizes of the inputs, and the number of the line after them."""
    names: list[str] = []
    sizes: list[int] = []
    for line in lines[1:]:
        words = line.split(" ")
        if len(words) != 3 or words[0] != mark.format(len(names)):
            break
        names.append(words[1])
        sizes.append(_whole(words[2], 0, _LARGEST))
    return names, tuple(sizes), 1 + len(names)


def _whole(word: str, least: int, most: int) -> int:
    if not re.fullmatch("[0-9]{1,7}", word) or not least <= int(word) <= most:
        raise ValueError(word)
    return int(word)


_Scope: TypeAlias = dict[str, Array]
_Step: TypeAlias = Callable[[_Scope, Numbers], None]


def _routine(lines: Sequence[str], blocks: Mapping[str, Block]) -> Block:
    name = _head(lines[0], "routine")
    names, inputs, at = _inputs(lines, "in")
    sizes = dict(zip(names, inputs, strict=True))
    last, *results = lines[-1].split(" ")
    if last != "out" or len(sizes) != len(names):
        raise ValueError(lines[-1])
    steps: list[_Step] = []
    texts: dict[str, None] = {}
    operations, depth, inner = 0, 1, 0
    for line in lines[at:-1]:
        words = line.split(" ")
        equals = words.index("=")
        targets, kind, rest = [w for w in words[:equals] if w], words[equals + 1], words[equals + 2 :]
        if kind == "gather":
            step, shapes = _gather(rest, sizes, targets)
        else:
            block = blocks[rest[0]]
            texts |= dict.fromkeys(block.texts)
            depth, inner = max(depth, 1 + block.depth), max(inner, block.size)
            step, shapes, turns = (_call if kind == "call" else _loop)(block, rest, sizes, targets)
            operations += turns * block.operations
        if set(targets) & sizes.keys():
            raise ValueError(line)
        sizes |= dict(zip(targets, shapes, strict=True))
        steps.append(step)
    if depth > _DEEPEST or operations > _LONGEST:
        raise ValueError(f"{name} is too large")

    def run(vectors: Sequence[Array], algebra: Numbers) -> list[Array]:
        scope = dict(zip(names, vectors, strict=True))
        for step in steps:
            step(scope, algebra)
        return [scope[result] for result in results]

    text = "\n".join([*lines, ""])
    outputs = tuple(sizes[result] for result in results)
    size = sum(sizes.values()) + inner
    return Block(name, inputs, outputs, operations, depth, size, (*(t for t in texts if t != text), text), run)


def _gather(words: Sequence[str], sizes: Mapping[str, int], targets: Sequence[str]) -> tuple[_Step, list[int]]:
    source, index, width_word, width_text, lanes_word, lanes_text = words
    width, lanes = _whole(width_text, 1, _LARGEST), _whole(lanes_text, 1, 64)
    if (width_word, lanes_word) != ("width", "lanes") or sizes[index] != 1 or sizes[source] % (width * lanes):
        raise ValueError(" ".join(words))
    pieces, (target,) = sizes[source] // width, targets

    def step(scope: _Scope, algebra: Numbers) -> None:
        groups = scope[source].reshape(-1, width, lanes, scope[source].shape[1])
        table = groups.swapaxes(1, 2).reshape(pieces, width, -1)
        at = algebra.places(scope[index][0], pieces - 1)
        points = max(table.shape[2], len(at))
        at, table = np.broadcast_to(at, points), np.broadcast_to(table, (pieces, width, points))
        scope[target] = table[at, :, np.arange(points)].T

    return step, [width]


def _call(
    block: Block, words: Sequence[str], sizes: Mapping[str, int], targets: Sequence[str]
) -> tuple[_Step, list[int], int]:
    arguments = [word for word in words[1:] if word]
    if tuple(sizes[name] for name in arguments) != block.inputs:
        raise ValueError(" ".join(words))

    def step(scope: _Scope, algebra: Numbers) -> None:
        scope.update(zip(targets, block.run([scope[name] for name in arguments], algebra), strict=True))

    return step, list(block.outputs), 1


def _loop(
    block: Block, words: Sequence[str], sizes: Mapping[str, int], targets: Sequence[str]
) -> tuple[_Step, list[int], int]:
    marks = ("count", "index", "until", "carried", "sliced", "fixed", "spread", "lanes")
    places = [words.index(marks[0])]
    for mark in marks[1:]:
        places.append(words.index(mark, places[-1] + 1))
    parts = [[w for w in words[a + 1 : b] if w] for a, b in zip(places, [*places[1:], len(words)], strict=True)]
    (count_text,), (index_text,), (until_text,), carried, sliced, fixed, spread, (lanes_text,) = parts
    count, lanes = _whole(count_text, 1, _LARGEST), _whole(lanes_text, 1, 64)
    index = bool(_whole(index_text, 0, 1))
    until = None if until_text == "None" else _whole(until_text, 0, len(carried) - 1)
    turns = count * lanes
    cut = [*[1] * index, *(sizes[n] // lanes for n in carried), *(sizes[n] // turns for n in (*sliced, *spread))]
    whole = all(sizes[n] % lanes == 0 for n in carried) and all(sizes[n] % turns == 0 for n in (*sliced, *spread))
    if not whole or (*cut, *(sizes[n] for n in fixed)) != block.inputs:
        raise ValueError(" ".join(words))
    state = tuple(sizes[n] // lanes for n in carried)
    if block.outputs[: len(state)] != state or (until is not None and (lanes > 1 or block.outputs[len(state) :])):
        raise ValueError(" ".join(words))
    if until is not None and state[until] != 1:
        raise ValueError(" ".join(words))
    stacked = block.outputs[len(state) :]
    order = [*carried, *sliced, *spread, *fixed]

    def step(scope: _Scope, algebra: Numbers) -> None:
        points = max([scope[name].shape[1] for name in order], default=1)
        now = [_by_lane(np.broadcast_to(scope[name], (sizes[name], points)), lanes) for name in carried]
        pieces = [scope[name].reshape(count, -1, lanes, scope[name].shape[1]) for name in sliced]
        apart = [scope[name].reshape(count, lanes, -1, scope[name].shape[1]) for name in spread]
        rows: list[list[Array]] = [[] for _ in stacked]
        for turn in range(count):
            running = None if until is None else ~algebra.truth(now[until][0, 0])
            if running is not None and not np.any(running):
                break
            results = []
            for lane in range(lanes):
                number = [np.full((1, points), algebra.constant(turn * lanes + lane))] if index else []
                arguments = [*number, *(part[:, lane] for part in now), *(part[turn][:, lane] for part in pieces)]
                arguments += [part[turn][lane] for part in apart] + [scope[name] for name in fixed]
                results.append(block.run(arguments, algebra))
            fresh = [np.stack([result[k] for result in results], axis=1) for k in range(len(block.outputs))]
            carried_on = fresh[: len(state)]
            now = (
                carried_on
                if running is None
                else [np.where(running, a, b) for a, b in zip(carried_on, now, strict=True)]
            )
            for row, part in zip(rows, fresh[len(state) :], strict=True):
                row.append(part.reshape(-1, part.shape[2]))
        ends = [part.reshape(-1, part.shape[2]) for part in now]
        scope.update(zip(targets, [*ends, *(np.concatenate(row) for row in rows)], strict=True))

    return step, [*(size * lanes for size in state), *(size * turns for size in stacked)], turns


def _by_lane(array: Array, lanes: int) -> Array:
    # (entries · lanes, n), stored entry by entry, → (entries, lanes, n)
    return array.reshape(-1, lanes, array.shape[1])
