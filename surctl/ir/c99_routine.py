"""Writer of a routine as C99: functions and `for` loops; division of a large law into several C files."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from textwrap import indent
from types import MappingProxyType

from surctl.ir.c99 import C_TYPE, Real, broken, c_literal, copy_loop, entry, handed_on, identifier, signature
from surctl.ir.c99_procedure import emit_procedure
from surctl.ir.c99_program import Feed, emit_lanes, emit_program, inline_helpers, own_helpers, preamble
from surctl.ir.places import Overlaps, Places, inlined, overlapping, reads
from surctl.ir.procedure import Procedure
from surctl.ir.program import LEAVES, Program
from surctl.ir.routine import Block, Call, Gather, Loop, Routine, Step, nested

_FEW = 8  # largest number of values that a compiler keeps in registers
_LARGE = 32  # from this many values on, a routine's own arrays should not stay on the stack of its caller
_APART = """#if defined(__GNUC__)
#define APART __attribute__((noinline)) /* its arrays leave the stack when it ends */
#else
#define APART
#endif
"""
_HEAD = re.compile(r"^(?:APART )?(void \w+\([^)]*\))\n\{", re.MULTILINE)
_GENERATED = re.compile(r"[sftr]\d+|(?:pack|later)\d+|out_[nr]\d+")  # generated names
_TARGET = re.compile(r"\b\w+\[[^\]]*\] = ")


def emit_block(block: Block, *, symbol: str, real: Real = "float64", vectors: bool = False) -> str:
    """Return C99 for a program or routine and for all programs and routines that it calls, callees first.

    The last function is `static void <symbol>(const double *in0, …, double *out0, …)`. For a routine, no output may
    overlap an input or another output, because the C code may write outputs before it has read all inputs. (The code of
    a single program reads all inputs first, see `emit_program`.) Programs or routines with equal text become one C
    function. `memory` returns the size of the arrays along the deepest chain of calls.

    Args:
        symbol: name of the last function, and prefix of the other names; a file can contain only one such text.
        vectors: whether loops of procedures compute several entries at once, where the compiler is GCC.
    """
    writer = Writer(identifier(symbol), real, vectors=vectors)
    writer.write(block)
    part = writer.parts.get("", _Part())
    return "\n".join([preamble(part.programs, real), *part.chunks])


def _with_function(block: Block) -> set[str]:
    """Return the digests of the programs and routines that need a C function; blocks with equal text share one."""
    routines = [inner for inner in nested(block).values() if isinstance(inner, Routine)]
    steps = [step for routine in routines for step in routine.steps if not isinstance(step, Gather)]
    return {
        s.block.digest()
        for s in steps
        if (isinstance(s, Call) and not inlined(s)) or (isinstance(s, Loop) and s.lanes == 1)
    }


def run_alone(block: Block) -> set[str]:
    """Return the digests of the programs and routines that are not only called by loops over SIMD lanes."""
    routines = [inner for inner in nested(block).values() if isinstance(inner, Routine)]
    steps = [step for routine in routines for step in routine.steps if not isinstance(step, Gather)]
    return {step.block.digest() for step in steps if isinstance(step, Call) or step.lanes == 1}


@dataclass
class _Part:
    """The C functions of one file, callees first, and the programs among the blocks that these functions compute."""

    functions: list[str] = field(default_factory=list)
    programs: list[Program] = field(default_factory=list)

    @property
    def chunks(self) -> list[str]:
        """Return the C functions, preceded by the macro that they need besides `preamble`."""
        apart = any("\nAPART " in text for text in self.functions)
        return [*[_APART] * apart, *self.functions]


class Writer:
    """Collects the C functions of a program or routine by file, and the name of each function by its key (`_key_of`).

    Args:
        files: name of the file of each function, by the function's key; a function without an entry is written to file
            "".
        shared: keys of the functions that are called from another file; these are not static.
    """

    def __init__(
        self,
        symbol: str,
        real: Real,
        *,
        vectors: bool = False,
        files: Mapping[str, str] = MappingProxyType({}),
        shared: Collection[str] = (),
    ) -> None:
        self.symbol, self.real, self.kind, self.vectors = symbol, real, C_TYPE[real], vectors
        self.files, self.shared = files, shared
        self.overlapping: Overlaps = {}
        self.named: dict[str, str] = {}
        self.parts: dict[str, _Part] = {}
        self.prototypes: list[str] = []

    def write(self, block: Block) -> None:
        """Write a program or routine and all programs and routines that it calls, callees first."""
        self.overlapping = overlapping(block)
        alone = _with_function(block)
        for inner in nested(block).values():
            if isinstance(inner, Routine):
                for step in inner.steps:
                    if isinstance(step, Loop) and step.lanes > 1:
                        self._lanes(step)
            if inner is block or not isinstance(inner, Program) or inner.digest() in alone:
                self._block(inner, last=inner is block)

    def _block(self, block: Block, *, last: bool) -> None:
        key = block.digest()
        if key in self.named:
            return
        name = self.symbol if last else self._name(key, block.name)
        self.named[key] = name
        if isinstance(block, Program):
            self._add(key, self._program(block, name, last=last), block)
        elif isinstance(block, Procedure):
            self._add(key, emit_procedure(block, symbol=name, real=self.real, vectors=self.vectors))
        else:
            self._add(key, _routine(block, name, self))

    def _name(self, key: str, name: str) -> str:
        return free_name(f"{self.symbol}_{name}", self.named)

    def _add(self, key: str, text: str, program: Program | None = None) -> None:
        part = self.parts.setdefault(self.files.get(key, ""), _Part())
        if key in self.shared:
            text = text.replace("static void ", "void ", 1)
            self.prototypes += [f"{prototype};" for prototype in _HEAD.findall(text)]
        part.functions.append(text)
        part.programs += [] if program is None else [program]

    def _program(self, program: Program, name: str, *, last: bool) -> str:
        apart = not last and program.digest() not in self.overlapping
        moves = handed_on(program, strided=True) if apart else ()
        return emit_program(program, symbol=name, real=self.real, moves=moves, apart=apart)

    def _lanes(self, loop: Loop) -> None:
        key = _key_of(loop)
        if key in self.named or not isinstance(loop.block, Program):
            return
        self.named[key] = self._name(key, f"{loop.block.name}_{loop.lanes}")
        text = emit_lanes(loop.block, symbol=self.named[key], lanes=loop.lanes, feeds=_feeds(loop), real=self.real)
        self._add(key, text, loop.block)


def _feeds(loop: Loop) -> tuple[Feed, ...]:
    own: list[Feed] = ["lanes"] * (loop.index + len(loop.carried) + len(loop.sliced))
    return tuple(own + ["spread"] * len(loop.spread) + ["shared"] * len(loop.fixed))


def _key_of(step: Call | Loop) -> str:
    """Return the key of the C function that a step calls: the block's digest and, for SIMD lanes, the input layouts."""
    if isinstance(step, Call) or step.lanes == 1:
        return step.block.digest()
    loop = step
    return f"{loop.block.digest()} {loop.lanes} {' '.join(_feeds(loop))}"


def free_name(base: str, named: Mapping[str, str]) -> str:
    """Return a C identifier for the name, with a number at the end if the identifier is already used."""
    name, at = base, 2
    while name in named.values():
        name, at = f"{base}_{at}", at + 1
    return identifier(name)


def _routine(routine: Routine, symbol: str, writer: Writer) -> str:
    overlaps = writer.overlapping.get(routine.digest(), frozenset())
    places = Places(routine, overlaps)
    sizes = routine.sizes()
    # local arrays are numbered, so that no unchecked external name enters the C text
    pointers = {place: f"a{k}" for k, place in reversed(list(enumerate(places.of.values()))) if place[1]}
    local = {name: pointers.get(place, place[0]) for name, place in places.of.items()}
    named = [(f"in{k}", name) for k, (name, _) in enumerate(routine.inputs)]
    named += [(f"out{k}", name) for k, name in enumerate(routine.results)]
    said = [f"{argument}: {name}" for argument, name in named if identifier(name) and not _GENERATED.fullmatch(name)]
    said += [f"out{k} may be in{j}" for k, j in sorted(overlaps)]
    starts, shared = places.pool
    apart = "APART " if shared >= _LARGE and symbol != writer.symbol else ""
    read_sizes = [sizes[name] for name, _ in routine.inputs]
    written_sizes = [sizes[name] for name in routine.results]
    lines = broken("/* ", said, " */", indent="   ") if said else []
    lines += [*signature(f"{apart}static void {symbol}", read_sizes, written_sizes, writer.kind), "{"]
    own = [f"{array}[{size}]" for array, size in places.own.items()]
    lines += _declared(writer.kind, [f"pool[{shared}]"] if starts else own)
    lines += _declared(writer.kind, [f"*const {array} = {_at('pool', start)}" for array, start in starts.items()])
    for from_input in (True, False):
        kind = f"const {writer.kind}" if from_input else writer.kind
        chosen = [(p, name) for p, name in pointers.items() if p[0].startswith("in") == from_input]
        lines += _declared(kind, [f"*const {name} = {base} + {start}" for (base, start), name in chosen])
    body: list[str] = []
    for step in routine.steps:
        body += (
            _moved(step, places) if inlined(step) else _step(step, sizes, local, writer, _stays(step, places, overlaps))
        )
    for k, j in sorted(overlaps):  # a loop passes a carried array as input and as output, and needs no copy
        copied = _copy(f"out{k}", f"in{j}", sizes[routine.results[k]])
        if sizes[routine.results[k]] > _FEW and copied in body:
            body[body.index(copied)] = f"    if (out{k} != in{j}) {{\n{indent(copied, '    ')}\n    }}"
    body += [_copy(f"held{k}", local[routine.results[k]], sizes[routine.results[k]]) for k in places.held]
    for k, name in enumerate(routine.results):
        source = f"held{k}" if k in places.held else local[name]
        body += [_copy(f"out{k}", source, sizes[name])] if source != f"out{k}" else []
    text = "\n".join([*body, *(base for base, _ in pointers)])
    used, read = (set(re.findall(r"\w+", t)) for t in (text, _TARGET.sub("", text)))
    lines += [f"    (void){name};" for name in places.own if name not in read]  # compilers warn about unread arrays
    others = [*(f"in{k}" for k in range(len(routine.inputs))), *pointers.values()]
    lines += [f"    (void){name};" for name in others if name not in used]
    return "\n".join([*lines, *body, "}"]) + "\n"


def _declared(kind: str, each: list[str]) -> list[str]:
    return broken(f"    {kind} ", each, ";", indent=" " * 8) if each else []


def _at(array: str, start: int) -> str:
    return f"{array} + {start}" if start else array


def _moved(step: Step, places: Places) -> list[str]:
    """Return C lines for a call that only moves data: the copies for which source and destination differ."""
    lines = []
    for move in inlined(step):
        assert isinstance(step, Call)
        (to, first), (source, start) = places.of[step.results[move.output]], places.of[step.args[move.input]]
        there, here = (to, first + move.to), (source, start + move.start)
        if there != here:
            lines.append(_copy(entry(*there), entry(*here), move.count))
    return lines


def _copy(to: str, source: str, size: int) -> str:
    # `to` and `source` name an array, or the start of an entry in an array
    to, source = (text if "[" in text else f"{text}[" for text in (to, source))
    if size <= _FEW:
        return "    " + " ".join(f"{to}{k}] = {source}{k}];" for k in range(size))
    return copy_loop(to, source, size)


def _stays(step: Step, places: Places, overlaps: Collection[tuple[int, int]]) -> dict[str, str]:
    """Return, by result name, the initial values that a loop of at most one iteration returns if it does not run.

    No copy is needed for these values. The result must be a separate local array, because arrays that share memory with
    the result would also move.
    """
    if not isinstance(step, Loop) or step.count > 1 or step.until is None:
        return {}
    occupied = [place[0] for place in places.of.values()]
    # a call that only moves data copies from the array itself, not through a pointer
    moved = {name for other in places.routine.steps if inlined(other) for name in reads(other)}
    read = {name for other in places.routine.steps for name in reads(other)}
    safe = {f"in{k}" for k in range(len(places.routine.inputs))} - {f"in{j}" for _, j in overlaps}
    return {
        result: name
        for k, (name, result) in enumerate(zip(step.carried, step.results, strict=False))
        if k != step.until
        and places.of[name][0] in safe
        and result in read - moved
        and places.own.get(places.of[result][0], 0) > _FEW
        and occupied.count(places.of[result][0]) == 1
    }


def _step(
    step: Step, sizes: Mapping[str, int], local: dict[str, str], writer: Writer, stays: Mapping[str, str]
) -> list[str]:
    if isinstance(step, Gather):
        return _gather(step, sizes[step.source] // step.width, local, writer)
    if isinstance(step, Call):
        function = writer.named[step.block.digest()]
        return broken(f"    {function}(", [local[name] for name in (*step.args, *step.results)], ");", indent=" " * 8)
    return _loop(step, sizes, local, writer, stays)


def _gather(step: Gather, count: int, local: Mapping[str, str], writer: Writer) -> list[str]:
    index, source = f"{local[step.index]}[0]", local[step.source]
    none, one, last = (c_literal(value, writer.real) for value in (0.0, 1.0, count - 1.0))
    # compared before the cast: a NaN or a number outside the range of int cannot be cast
    lines = [
        "    {",
        f"        const {writer.kind} held = ({index} >= {one}) ? (({index} < {last}) ? {index} : {last}) : {none};",
        "        const unsigned at = (unsigned)(int)held;",
    ]
    if step.lanes == 1:
        lines.append(f"        const {writer.kind} *piece = {source} + {step.width}U * at;")
    else:
        block = f"{step.width * step.lanes}U * (at / {step.lanes}U) + at % {step.lanes}U"
        lines.append(f"        const {writer.kind} *piece = {source} + {block};")
    parts = [f"{local[step.result]}[{k}] = piece[{k * step.lanes}];" for k in range(step.width)]
    return [*lines, f"        {' '.join(parts)}", "    }"]


def _loop(
    loop: Loop, sizes: Mapping[str, int], local: dict[str, str], writer: Writer, stays: Mapping[str, str]
) -> list[str]:
    # results in `stays` are later read through a pointer, which replaces their entry in `local`
    state = len(loop.carried)
    function = writer.named[_key_of(loop)]
    results = [local[name] for name in loop.results]
    begun = [
        local[name] if result in stays else at
        for name, result, at in zip(loop.carried, loop.results, results, strict=False)
    ]
    pairs = zip(loop.carried, begun, strict=True)
    lines = [_copy(result, local[name], sizes[name]) for name, result in pairs if result != local[name]]
    now = {result: f"{local[result]}_now" for result in stays}
    lines += [f"    const {writer.kind} *{now[result]} = {local[name]};" for result, name in stays.items()]
    runs = "" if loop.until is None else f"({results[loop.until]}[0] == {c_literal(0.0, writer.real)})"
    if stays:  # Frama-C then treats the two cases separately: in one of them the array is not written
        chosen = f"{next(iter(now.values()))}_runs"
        lines += [f"    const int {chosen} = {runs};", f"    /*@ split {chosen}; */"]
        runs = chosen
    within = f"(i < {loop.count}) && {runs}" if runs else f"i < {loop.count}"
    lines.append(f"    for (int i = 0; {within}; ++i) {{")
    if loop.index:
        first = f"({writer.kind})i" if loop.lanes == 1 else f"({writer.kind})({loop.lanes} * i)"
        ranks = [first if k == 0 else f"{first} + {c_literal(float(k), writer.real)}" for k in range(loop.lanes)]
        lines.append(f"        const {writer.kind} turn[{loop.lanes}] = {{{', '.join(ranks)}}};")
    arguments = ["turn"] * loop.index + begun
    arguments += [_part(local[name], sizes[name] // loop.count) for name in (*loop.sliced, *loop.spread)]
    arguments += [local[name] for name in loop.fixed]
    arguments += results[:state]
    arguments += [_part(local[name], sizes[name] // loop.count) for name in loop.results[state:]]
    lines += broken(f"        {function}(", arguments, ");", indent=" " * 12)
    lines += [f"        {now[result]} = {local[result]};" for result in stays]
    local |= now
    return [*lines, "    }"]


def _part(array: str, width: int) -> str:
    return f"{array} + {width} * i"


# Writer of C99 in several files; a large function is in one file with the functions that only this function calls


_LEAST, _MOST = 16_000, 64_000  # smallest size of a separate file, and size beyond which a file is split [characters]


@dataclass(frozen=True)
class Parts:
    """C text of a program or routine, divided into several files.

    Attributes:
        files: C text of each file, by the name of the file's main function; the file of the last function has the name
            "".
        prototypes: C text that every file needs before its own: prototypes of the functions that are called from
            another file, and small inline functions.
    """

    files: Mapping[str, str]
    prototypes: tuple[str, ...]


def emit_parts(block: Block, *, symbol: str, real: Real = "float64") -> Parts:
    """Return the C99 of `emit_block` in several files: one for each large function and its own callees.

    All names begin with `symbol`; functions that no other file calls are static.
    Each file must begin with <math.h>, the pragma FP_CONTRACT and the prototypes.
    """
    nodes = _nodes(block)
    files = _parted(nodes, block.digest())
    shared = {key for at, node in nodes.items() for key in node.calls if files.get(key, "") != files.get(at, "")}
    writer = Writer(identifier(symbol), real, files=files, shared={*shared, block.digest()})
    writer.write(block)
    texts = {
        name: "\n".join([text for text in (*own_helpers(part.programs, real), *part.chunks) if text])
        for name, part in writer.parts.items()
    }
    programs = [program for part in writer.parts.values() for program in part.programs]
    return Parts(MappingProxyType(dict(sorted(texts.items()))), (*inline_helpers(programs, real), *writer.prototypes))


@dataclass(frozen=True)
class _Node:
    """A C function that is to be written."""

    name: str
    size: int  # estimated length of the text
    calls: tuple[str, ...]  # keys of the called functions


def _nodes(block: Block) -> dict[str, _Node]:
    # keys as in `_key_of`
    nodes: dict[str, _Node] = {}
    todo = [(block.digest(), block)]
    while todo:
        key, inner = todo.pop()
        if key in nodes:
            continue
        called = _called(inner)
        nodes[key] = _Node(inner.name, _size(inner), tuple(called))
        todo += called.items()
    return nodes


def _called(block: Block) -> dict[str, Block]:
    if not isinstance(block, Routine):
        return {}
    return {_key_of(s): s.block for s in block.steps if not isinstance(s, Gather) and not inlined(s)}


def _size(block: Block) -> int:
    # estimated number of characters of the C text
    if isinstance(block, Routine):
        return 300 + 90 * len(block.steps)
    if isinstance(block, Procedure):
        return len(block.source)
    operations = sum(instruction.op not in LEAVES for instruction in block.instructions)
    return 200 + 15 * (operations + sum(len(refs) for refs in block.output_refs))


def _parted(nodes: Mapping[str, _Node], root: str) -> dict[str, str]:
    """Return the file of each function outside the file of `root`; the largest separable function is moved first."""
    # a function with the root's name does the main work of the root, and stays in the root's file
    files: dict[str, str] = {}
    rest = set(nodes)
    while sum(nodes[key].size for key in rest) > _MOST:
        able = [key for key in rest if nodes[key].calls and nodes[key].name != nodes[root].name]
        apart = {key: rest - _reached(nodes, root, without=key) for key in able}
        sizes = {key: sum(nodes[k].size for k in own) for key, own in apart.items()}
        fitting = [key for key, size in sizes.items() if _LEAST <= size <= _MOST]
        if not fitting:
            break
        chosen = max(fitting, key=lambda key: (sizes[key], key))
        files |= dict.fromkeys(apart[chosen], free_name(nodes[chosen].name, files))
        rest -= apart[chosen]
    return files


def _reached(nodes: Mapping[str, _Node], root: str, *, without: str) -> set[str]:
    reached, todo = set[str](), [root]
    while todo:
        key = todo.pop()
        if key not in reached and key != without:
            reached.add(key)
            todo += nodes[key].calls
    return reached
