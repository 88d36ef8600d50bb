"""Writer of a routine as C99: functions and `for` loops; division of a large law into several C files."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from textwrap import indent
from types import MappingProxyType

from surctl.ir.c99 import C_TYPE, Real, broken, c_literal, copy_loop, entry, handed_on, identifier, signature
from surctl.ir.c99_procedure import emit_procedure
from surctl.ir.c99_program import emit_lanes, emit_program, inline_helpers, own_helpers, preamble
from surctl.ir.places import Overlaps, Places, inlined, overlapping, reads
from surctl.ir.procedure import Procedure
from surctl.ir.program import LEAVES, Program
from surctl.ir.routine import Block, Call, Feed, Gather, Loop, Routine, Step, nested

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
        if key not in self.named:
            self.named[key] = self.symbol if last else self._name(block.name)
            self._add(key, self.function(block, self.named[key], last=last), block)

    def function(self, block: Block, name: str, *, last: bool) -> str:
        """Return the C function of a block; `last` says that it is the whole that is written."""
        if isinstance(block, Procedure):
            return emit_procedure(block, symbol=name, real=self.real, vectors=self.vectors)
        if isinstance(block, Routine):
            return RoutineText(block, name, self).text()
        apart = not last and block.digest() not in self.overlapping
        moves = handed_on(block, strided=True) if apart else ()
        return emit_program(block, symbol=name, real=self.real, moves=moves, apart=apart)

    def lanes_function(self, loop: Loop, program: Program, name: str) -> str:
        """Return the C function of a loop's body that runs in several SIMD lanes."""
        return emit_lanes(program, symbol=name, lanes=loop.lanes, feeds=feeds_of(loop), real=self.real)

    def _name(self, name: str) -> str:
        return free_name(f"{self.symbol}_{name}", self.named)

    def _add(self, key: str, text: str, block: Block) -> None:
        part = self.parts.setdefault(self.files.get(key, ""), _Part())
        if key in self.shared:
            text = text.replace("static void ", "void ", 1)
            self.prototypes += [f"{prototype};" for prototype in _HEAD.findall(text)]
        part.functions.append(text)
        part.programs += [block] if isinstance(block, Program) else []

    def _lanes(self, loop: Loop) -> None:
        key = function_key(loop)
        if key not in self.named and isinstance(loop.block, Program):
            self.named[key] = self._name(f"{loop.block.name}_{loop.lanes}")
            self._add(key, self.lanes_function(loop, loop.block, self.named[key]), loop.block)


def feeds_of(loop: Loop) -> tuple[Feed, ...]:
    """Return the layout of each input of a loop's body that runs in several SIMD lanes."""
    own: list[Feed] = ["lanes"] * (loop.index + len(loop.carried) + len(loop.sliced))
    return tuple(own + ["spread"] * len(loop.spread) + ["shared"] * len(loop.fixed))


def function_key(step: Call | Loop) -> str:
    """Return the key of the C function that a step calls: the block's digest and, for SIMD lanes, the input layouts."""
    if isinstance(step, Call) or step.lanes == 1:
        return step.block.digest()
    loop = step
    return f"{loop.block.digest()} {loop.lanes} {' '.join(feeds_of(loop))}"


def free_name(base: str, named: Mapping[str, str]) -> str:
    """Return a C identifier for the name, with a number at the end if the identifier is already used."""
    name, at = base, 2
    while name in named.values():
        name, at = f"{base}_{at}", at + 1
    return identifier(name)


class RoutineText:
    """Translates one routine to C: its arrays in memory (see `Places`), and its steps."""

    def __init__(self, routine: Routine, symbol: str, writer: Writer) -> None:
        self.routine, self.symbol, self.writer = routine, symbol, writer
        self.overlaps = writer.overlapping.get(routine.digest(), frozenset())
        self.places, self.sizes = Places(routine, self.overlaps), routine.sizes()
        # local arrays are numbered, so that no unchecked external name enters the C text
        numbered = reversed(list(enumerate(self.places.of.values())))
        self.pointers = {place: f"a{k}" for k, place in numbered if place[1]}
        self.local = {name: self.pointers.get(place, place[0]) for name, place in self.places.of.items()}

    def text(self) -> str:
        """Return the C function."""
        body: list[str] = []
        for at, step in enumerate(self.routine.steps):
            body += self._moved(step) if inlined(step) else self.step(step, at)
        body = self._results(body)
        text = "\n".join([*body, *(base for base, _ in self.pointers)])
        used, read = (set(re.findall(r"\w+", t)) for t in (text, _TARGET.sub("", text)))
        idle = [name for name in self.places.own if name not in read]  # compilers warn about unread arrays
        others = [*(f"in{k}" for k in range(len(self.routine.inputs))), *self.pointers.values()]
        idle += [name for name in others if name not in used]
        return "\n".join([*self.head(), *(f"    (void){name};" for name in idle), *body, "}"]) + "\n"

    def comment(self) -> list[str]:
        """Return the comment with the names of the arguments, as far as they are not generated."""
        named = [(f"in{k}", name) for k, (name, _) in enumerate(self.routine.inputs)]
        named += [(f"out{k}", name) for k, name in enumerate(self.routine.results)]
        said = [f"{what}: {name}" for what, name in named if identifier(name) and not _GENERATED.fullmatch(name)]
        said += [f"out{k} may be in{j}" for k, j in sorted(self.overlaps)]
        return broken("/* ", said, " */", indent="   ") if said else []

    def head(self) -> list[str]:
        """Return the comment, the signature, and the declarations of the arrays."""
        kind, (starts, shared) = self.writer.kind, self.places.pool
        apart = "APART " if shared >= _LARGE and self.symbol != self.writer.symbol else ""
        read = [self.sizes[name] for name, _ in self.routine.inputs]
        written = [self.sizes[name] for name in self.routine.results]
        lines = [*self.comment(), *signature(f"{apart}static void {self.symbol}", read, written, kind), "{"]
        own = [f"{array}[{size}]" for array, size in self.places.own.items()]
        lines += _declared(kind, [f"pool[{shared}]"] if starts else own)
        lines += _declared(kind, [f"*const {array} = {_at('pool', start)}" for array, start in starts.items()])
        return lines + self.declared_pointers()

    def declared_pointers(self) -> list[str]:
        """Return the declarations of the pointers to pieces of arrays."""
        lines = []
        for from_input in (True, False):
            kind = f"const {self.writer.kind}" if from_input else self.writer.kind
            chosen = [(p, name) for p, name in self.pointers.items() if p[0].startswith("in") == from_input]
            lines += _declared(kind, [f"*const {name} = {self.at(*place)}" for place, name in chosen])
        return lines

    def at(self, array: str, start: int) -> str:
        """Return the C text of a pointer to an entry of an array."""
        return _at(array, start)

    def copy(self, to: tuple[str, int], source: tuple[str, int], size: int) -> str:
        """Return the C text that copies entries between places: pairs (array, first entry)."""
        there, here = entry(*to), entry(*source)
        if size <= _FEW:
            return "    " + " ".join(f"{there}{k}] = {here}{k}];" for k in range(size))
        return copy_loop(there, here, size)

    def _whole(self, to: str, source: str, size: int) -> str:
        return self.copy((to, 0), (source, 0), size)

    def _moved(self, step: Step) -> list[str]:
        """Return C lines for a call that only moves data: the copies for which source and destination differ."""
        lines = []
        for move in inlined(step):
            assert isinstance(step, Call)
            to, source = self.places.of[step.results[move.output]], self.places.of[step.args[move.input]]
            there, here = (to[0], to[1] + move.to), (source[0], source[1] + move.start)
            if there != here:
                lines.append(self.copy(there, here, move.count))
        return lines

    def _results(self, body: list[str]) -> list[str]:
        """Return the lines of all steps, followed by the copies of results that are not in place."""
        results, held = self.routine.results, self.places.held
        for k, j in sorted(self.overlaps):  # a loop passes a carried array as input and as output, and needs no copy
            size = self.sizes[results[k]]
            copied = self._whole(f"out{k}", f"in{j}", size)
            if size > _FEW and copied in body:
                body[body.index(copied)] = f"    if (out{k} != in{j}) {{\n{indent(copied, '    ')}\n    }}"
        body += [self._whole(f"held{k}", self.local[results[k]], self.sizes[results[k]]) for k in held]
        for k, name in enumerate(results):
            source = f"held{k}" if k in held else self.local[name]
            body += [self._whole(f"out{k}", source, self.sizes[name])] if source != f"out{k}" else []
        return body

    def step(self, step: Step, at: int) -> list[str]:
        """Return the C lines of a step; `at` is its number."""
        if isinstance(step, Gather):
            return self.gather(step)
        if isinstance(step, Loop):
            return self.loop(step, at)
        arguments = [self.local[name] for name in (*step.args, *step.results)]
        return self.call("    ", self.writer.named[step.block.digest()], arguments)

    def call(self, start: str, function: str, arguments: list[str]) -> list[str]:
        """Return the C lines of a call; `start` is the indentation."""
        return broken(f"{start}{function}(", arguments, ");", indent=f"{start}    ")

    def gather(self, step: Gather) -> list[str]:
        """Return the C lines that copy a piece of an array."""
        kind, index, source = self.writer.kind, f"{self.local[step.index]}[0]", self.local[step.source]
        count = self.sizes[step.source] // step.width
        none, one, last = (c_literal(value, self.writer.real) for value in (0.0, 1.0, count - 1.0))
        first = f"{step.width}U * at"
        if step.lanes > 1:
            first = f"{step.width * step.lanes}U * (at / {step.lanes}U) + at % {step.lanes}U"
        parts = [f"{self.local[step.result]}[{k}] = piece[{k * step.lanes}];" for k in range(step.width)]
        # compared before the cast: a NaN or a number outside the range of int cannot be cast
        return [
            "    {",
            f"        const {kind} held = ({index} >= {one}) ? (({index} < {last}) ? {index} : {last}) : {none};",
            "        const unsigned at = (unsigned)(int)held;",
            f"        const {kind} *piece = {source} + {first};",
            f"        {' '.join(parts)}",
            "    }",
        ]

    def begun(self, loop: Loop, stays: Mapping[str, str]) -> list[str]:
        """Return the copies of the initial state of a loop to its results, except those that stay where they are."""
        pairs = zip(loop.carried, loop.results, strict=False)
        return [
            self._whole(self.local[result], self.local[name], self.sizes[name])
            for name, result in pairs
            if self.local[result] != self.local[name] and result not in stays
        ]

    def _stays(self, loop: Loop) -> dict[str, str]:
        """Return, by result name, the initial values that a loop of at most one iteration returns if it does not run.

        No copy is needed for these values. The result must be a separate local array, because arrays that share memory
        with the result would also move.
        """
        if loop.count > 1 or loop.until is None:
            return {}
        steps, place_of = self.routine.steps, self.places.of
        occupied = [place[0] for place in place_of.values()]
        # a call that only moves data copies from the array itself, not through a pointer
        moved = {name for other in steps if inlined(other) for name in reads(other)}
        read = {name for other in steps for name in reads(other)}
        safe = {f"in{k}" for k in range(len(self.routine.inputs))} - {f"in{j}" for _, j in self.overlaps}
        return {
            result: name
            for k, (name, result) in enumerate(zip(loop.carried, loop.results, strict=False))
            if k != loop.until
            and place_of[name][0] in safe
            and result in read - moved
            and self.places.own.get(place_of[result][0], 0) > _FEW
            and occupied.count(place_of[result][0]) == 1
        }

    def loop(self, loop: Loop, at: int) -> list[str]:
        """Return the C lines of a loop."""
        # results in `stays` are later read through a pointer, which replaces their entry in `local`
        del at
        local, kind, real, state = self.local, self.writer.kind, self.writer.real, len(loop.carried)
        stays = self._stays(loop)
        results = [local[name] for name in loop.results]
        begun = [
            local[name] if result in stays else array
            for name, result, array in zip(loop.carried, loop.results, results, strict=False)
        ]
        lines = self.begun(loop, stays)
        now = {result: f"{local[result]}_now" for result in stays}
        lines += [f"    const {kind} *{now[result]} = {local[name]};" for result, name in stays.items()]
        runs = "" if loop.until is None else f"({results[loop.until]}[0] == {c_literal(0.0, real)})"
        if stays:  # Frama-C then treats the two cases separately: in one of them the array is not written
            chosen = f"{next(iter(now.values()))}_runs"
            lines += [f"    const int {chosen} = {runs};", f"    /*@ split {chosen}; */"]
            runs = chosen
        within = f"(i < {loop.count}) && {runs}" if runs else f"i < {loop.count}"
        lines.append(f"    for (int i = 0; {within}; ++i) {{")
        if loop.index:
            first = f"({kind})i" if loop.lanes == 1 else f"({kind})({loop.lanes} * i)"
            ranks = [first if k == 0 else f"{first} + {c_literal(float(k), real)}" for k in range(loop.lanes)]
            lines.append(f"        const {kind} turn[{loop.lanes}] = {{{', '.join(ranks)}}};")
        arguments = ["turn"] * loop.index + begun
        arguments += [self.part(name, loop.count) for name in (*loop.sliced, *loop.spread)]
        arguments += [local[name] for name in loop.fixed]
        arguments += results[:state] + [self.part(name, loop.count) for name in loop.results[state:]]
        lines += self.call("        ", self.writer.named[function_key(loop)], arguments)
        lines += [f"        {now[result]} = {local[result]};" for result in stays]
        local |= now
        return [*lines, "    }"]

    def part(self, name: str, count: int) -> str:
        """Return the C text of the piece of an array that iteration i of `count` uses."""
        return f"{self.local[name]} + {self.sizes[name] // count} * i"


def _declared(kind: str, each: list[str]) -> list[str]:
    return broken(f"    {kind} ", each, ";", indent=" " * 8) if each else []


def _at(array: str, start: int) -> str:
    return f"{array} + {start}" if start else array


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
    return {function_key(s): s.block for s in block.steps if not isinstance(s, Gather) and not inlined(s)}


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
