"""Write a routine as C99: one static function a block, `for` loops over local arrays, no other memory."""

from __future__ import annotations

from collections.abc import Mapping

from surctl.ir.c99 import C_TYPE, Real, c_literal, emit_c99, identifier
from surctl.ir.c99_folded import emit_folded, preamble
from surctl.ir.c99_lanes import Feed, chooses, emit_lanes, emit_straight
from surctl.ir.moves import handed_on
from surctl.ir.program import Program
from surctl.ir.routine import Block, Call, Gather, Loop, Routine, Step, nested

__all__ = ["emit_block"]


def emit_block(block: Block, *, symbol: str, real: Real = "float64", folded: bool = False) -> str:
    """C99 of the block and of every block inside it, callees first.

    The last function is `static void <symbol>(const double *in0, …, double *out0, …)`; as in `emit_c99` outputs
    may alias inputs. Blocks of one text become one function. Largest stack: the local arrays along the deepest
    chain of calls.

    Args:
        block: program or routine.
        symbol: name of the last function, and beginning of the others' names.
        real: "float32" writes float for double.
        folded: for readers and for any compiler: nested expressions (see `c99_folded`) and nothing beyond C99, a third
            of the text; one such block a file. Without it, for speed: vectors where the compiler knows them.

    Raises:
        InputError: `symbol` is no identifier that C may use.
    """
    identifier(symbol)
    writer = _Writer(symbol, real, overlapping(block), folded)
    alone = run_alone(block)
    if folded:
        programs = [inner for inner in nested(block).values() if isinstance(inner, Program)]
        writer.chunks.append(preamble(programs, real))
    for inner in nested(block).values():
        if isinstance(inner, Routine):
            for step in inner.steps:
                if isinstance(step, Loop) and step.lanes > 1:
                    writer.lanes(step)
        if inner is block or isinstance(inner, Routine) or id(inner) in alone:
            writer.block(inner, last=inner is block)
    return "\n".join(writer.chunks)


def run_alone(block: Block) -> set[int]:
    """Identities of the blocks that a step other than a loop over lanes runs."""
    routines = [inner for inner in nested(block).values() if isinstance(inner, Routine)]
    steps = [step for routine in routines for step in routine.steps if not isinstance(step, Gather)]
    return {id(step.block) for step in steps if isinstance(step, Call) or step.lanes == 1}


def overlapping(block: Block) -> frozenset[str]:
    """Digests of the blocks that a loop gives one array as input and output: what it carries."""
    routines = [inner for inner in nested(block).values() if isinstance(inner, Routine)]
    loops = [step for routine in routines for step in routine.steps if isinstance(step, Loop)]
    return frozenset(loop.block.digest() for loop in loops if loop.carried)


class _Writer:
    """The functions so far, and their names by what they are the text of."""

    def __init__(self, symbol: str, real: Real, overlapping: frozenset[str], folded: bool) -> None:
        self.symbol, self.real, self.kind = symbol, real, C_TYPE[real]
        self.overlapping, self.folded = overlapping, folded
        self.named: dict[str, str] = {}
        self.chunks: list[str] = []

    def block(self, block: Block, *, last: bool) -> None:
        """Write it, unless its text is there already."""
        digest = block.digest()
        if digest in self.named:
            return
        name = self.symbol if last else free_name(f"{self.symbol}_{block.name}", self.named)
        self.named[digest] = name
        if isinstance(block, Program):
            self.chunks.append(self._program(block, name, last=last))
        else:
            self.chunks.append(_routine(block, name, self))

    def _program(self, program: Program, name: str, *, last: bool) -> str:
        apart = not last and program.digest() not in self.overlapping
        if self.folded:
            moves = handed_on(program) if apart else ()
            return emit_folded(program, symbol=name, real=self.real, moves=moves, apart=apart)
        if chooses(program) and not last:
            return emit_straight(program, symbol=name, real=self.real)
        return emit_c99(program, symbol=name, real=self.real, moves=handed_on(program) if apart else ())

    def lanes(self, loop: Loop) -> None:
        """Write the body of a loop over lanes."""
        key = _lanes_key(loop)
        if key in self.named or not isinstance(loop.block, Program):
            return
        self.named[key] = free_name(f"{self.symbol}_{loop.block.name}_{loop.lanes}", self.named)
        self.chunks.append(
            emit_lanes(
                loop.block,
                symbol=self.named[key],
                lanes=loop.lanes,
                feeds=_feeds(loop),
                real=self.real,
                folded=self.folded,
            )
        )


def _feeds(loop: Loop) -> tuple[Feed, ...]:
    side, spread, shared = Feed("lanes"), Feed("spread"), Feed("shared")
    own = len(loop.carried) + len(loop.sliced)
    return (side,) * (loop.index + own) + (spread,) * len(loop.spread) + (shared,) * len(loop.fixed)


def _lanes_key(loop: Loop) -> str:
    kinds = " ".join(feed.kind for feed in _feeds(loop))
    return f"{loop.block.digest()} {loop.lanes} {kinds}"


def free_name(wanted: str, named: Mapping[str, str]) -> str:
    name, at = wanted, 2
    while name in named.values():
        name, at = f"{wanted}_{at}", at + 1
    return identifier(name)


def _routine(routine: Routine, symbol: str, writer: _Writer) -> str:
    arguments = [f"const {writer.kind} *in{k}" for k in range(len(routine.inputs))]
    arguments += [f"{writer.kind} *out{k}" for k in range(len(routine.results))]
    sizes = routine.sizes()
    # local arrays are numbered, so that no name from outside reaches the C text unchecked
    local = {name: f"in{k}" for k, (name, _) in enumerate(routine.inputs)}
    local |= {name: f"a{k}" for k, name in enumerate(sizes) if name not in local}
    kept = taken_over(routine)
    local |= {result: local[name] for result, name in kept.items()}
    meaning = ", ".join(f"{local[name]}: {identifier(name)} {size}" for name, size in sizes.items())
    lines = [f"/* {meaning}; outputs may alias inputs */", f"static void {symbol}({', '.join(arguments)})", "{"]
    own = list(sizes.items())[len(routine.inputs) :]
    lines += [f"    {writer.kind} {local[name]}[{size}];" for name, size in own if name not in kept]
    read = {name for step in routine.steps for name in reads(step)} | set(routine.results)
    lines += [f"    (void){local[name]};" for name in local if name not in read and name not in kept]
    for step in routine.steps:
        lines += _step(step, sizes, local, writer)
    for k, name in enumerate(routine.results):
        lines.append(_copy(f"out{k}", local[name], sizes[name]))
    return "\n".join([*lines, "}"]) + "\n"


def taken_over(routine: Routine) -> dict[str, str]:
    """Last carried array → the array that held it before the loop, where nothing else reads that: no copy then."""
    inputs = {name for name, _ in routine.inputs}
    origin: dict[str, str] = {}
    for at, step in enumerate(routine.steps):
        if not isinstance(step, Loop):
            continue
        later = {name for other in routine.steps[at + 1 :] for name in reads(other)} | set(routine.results)
        for name, result in zip(step.carried, step.results, strict=False):
            alone = step.carried.count(name) == 1 and name not in (*step.sliced, *step.spread, *step.fixed)
            if alone and name not in later and name not in inputs:
                origin[result] = origin.get(name, name)
    return origin


def reads(step: Step) -> tuple[str, ...]:
    if isinstance(step, Gather):
        return (step.source, step.index)
    return step.args if isinstance(step, Call) else (*step.carried, *step.sliced, *step.spread, *step.fixed)


def _copy(to: str, source: str, size: int) -> str:
    if size <= 8:  # a compiler keeps what it can name in registers
        return "    " + " ".join(f"{to}[{k}] = {source}[{k}];" for k in range(size))
    return f"    for (int k = 0; k < {size}; ++k) {{ {to}[k] = {source}[k]; }}"


def _step(step: Step, sizes: Mapping[str, int], local: Mapping[str, str], writer: _Writer) -> list[str]:
    if isinstance(step, Gather):
        return _gather(step, sizes[step.source] // step.width, local, writer)
    if isinstance(step, Call):
        function = writer.named[step.block.digest()]
        return [f"    {function}({', '.join(local[name] for name in (*step.args, *step.results))});"]
    return _loop(step, sizes, local, writer)


def _gather(step: Gather, count: int, local: Mapping[str, str], writer: _Writer) -> list[str]:
    index, source = f"{local[step.index]}[0]", local[step.source]
    none, one, last = (c_literal(value, writer.real) for value in (0.0, 1.0, count - 1.0))
    # compared before it is cast: a NaN or a number beyond int has no value as an int
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


def _loop(loop: Loop, sizes: Mapping[str, int], local: Mapping[str, str], writer: _Writer) -> list[str]:
    state = len(loop.carried)
    function = writer.named[_lanes_key(loop) if loop.lanes > 1 else loop.block.digest()]
    results = [local[name] for name in loop.results]
    pairs = zip(loop.carried, results[:state], strict=True)
    lines = [_copy(result, local[name], sizes[name]) for name, result in pairs if result != local[name]]
    running = "" if loop.until is None else f" && ({results[loop.until]}[0] == {c_literal(0.0, writer.real)})"
    lines.append(f"    for (int i = 0; (i < {loop.count}){running}; ++i) {{")
    if loop.index:
        first = f"({writer.kind})i" if loop.lanes == 1 else f"({writer.kind})({loop.lanes} * i)"
        ranks = [first if k == 0 else f"{first} + {c_literal(float(k), writer.real)}" for k in range(loop.lanes)]
        lines.append(f"        const {writer.kind} turn[{loop.lanes}] = {{{', '.join(ranks)}}};")
    arguments = ["turn"] * loop.index + results[:state]
    arguments += [_part(local[name], sizes[name] // loop.count) for name in (*loop.sliced, *loop.spread)]
    arguments += [local[name] for name in loop.fixed]
    arguments += results[:state]
    arguments += [_part(local[name], sizes[name] // loop.count) for name in loop.results[state:]]
    return [*lines, f"        {function}({', '.join(arguments)});", "    }"]


def _part(array: str, width: int) -> str:
    return f"{array} + {width} * i"
