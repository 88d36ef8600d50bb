"""Conversion of a flat instruction list with traced loops to nested routines of programs, loops and arrays.

The loops inside a loop body divide the other instructions of the body into programs. Programs and loops exchange
numbers in arrays. An array that several loops read is assembled once and passed as a whole.

The flat list contains the instructions outside all loops and one copy of every loop body; input symbols represent the
state of each loop and its table rows. An instruction belongs to the innermost loop on whose symbols it depends. So a
value that does not change in a loop is computed before the loop. Values that only a conditional needs are moved into
the conditional (a loop with one iteration that a flag can skip).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from surctl.ir.folding import Numbering
from surctl.ir.program import Program, drop_dead
from surctl.ir.routine import Block, Call, Gather, Loop, Routine, Step

Key = tuple[int, ...]
"""The values in an array, each as a position in the instruction list."""

_ROOT = -1
"""The number of the region that contains the instructions outside all loops."""


Symbol = TypeVar("Symbol")
Value = TypeVar("Value")


@dataclass(frozen=True)
class Traced(Generic[Symbol, Value]):
    """A loop whose values are expressions, or positions in the flat instruction list.

    Attributes:
        name: name of the loop body.
        depth: nesting depth when the loop was traced; 1 for an outermost loop.
        count: number of iterations; 0 for a table row that is picked: the state is its index, and the result the row.
        own: symbols (inputs of the list) of the loop's state, then those of the table rows of the present iteration.
        results: symbols (inputs of the list) of the final state of the loop, then those of its stacked arrays.
        state, tables: initial state of the loop, and tables that the loop reads row by row.
        next, rows: values that one iteration computes: `next` is the next state, and `rows` are rows of the stacked
            arrays.
        until: position in the state of the flag that ends the loop; None if there is no flag.
    """

    name: str
    depth: int
    count: int
    own: tuple[Symbol, ...]
    results: tuple[Symbol, ...]
    state: tuple[Value, ...]
    tables: tuple[Value, ...]
    next: tuple[Value, ...]
    rows: tuple[Value, ...]
    until: int | None = None

    @property
    def before(self) -> tuple[Value, ...]:
        """Return the values that exist before the loop: its initial state and its tables."""
        return (*self.state, *self.tables)

    @property
    def after(self) -> tuple[Value, ...]:
        """Return the values that the loop body computes: the next state and the rows of the stacked arrays."""
        return (*self.next, *self.rows)


class _Regions:
    """The region of each value (the loop body that computes it, or the root outside all loops); parents of loops."""

    def __init__(
        self, program: Program, inputs: int, outputs: Mapping[str, Key], loops: Sequence[Traced[int, Key]]
    ) -> None:
        self.program, self.inputs, self.loops = program, inputs, loops
        self.code = program.instructions
        self.maker = {j: k for k, loop in enumerate(loops) for j in loop.results}
        self._holder = {j: k for k, loop in enumerate(loops) for j in loop.own}
        self.region: list[int | None] = [None] * len(self.code)
        self.parent: list[int] = []
        for k, loop in enumerate(loops):
            for key in (*loop.before, *loop.after):
                self._resolve(key)
            self.parent.append(self._parent(k))
        for key in outputs.values():
            self._resolve(key)
        if any(loop.count == 1 and loop.until is not None for loop in loops):
            self._sink(outputs)

    def loop_of(self, value: int) -> int | None:
        """Return the loop of which this value is a result, or None."""
        instruction = self.code[value]
        return self.maker.get(instruction.args[0]) if instruction.op == "input" else None

    def is_constant(self, value: int) -> bool:
        """Return whether the value is a constant; a constant needs no region, because every program may repeat it."""
        return self.code[value].op == "const"

    def of(self, value: int) -> int:
        """Return the region that computes a value."""
        region = self.region[value]
        assert region is not None
        return region

    def deepest(self, values: Iterable[int]) -> int:
        """Return the innermost of the regions that compute the given values; these regions must be nested."""
        return max((self.of(v) for v in values if not self.is_constant(v)), key=self._depth, default=_ROOT)

    def _depth(self, region: int) -> int:
        return 0 if region == _ROOT else self.loops[region].depth

    def inside(self, region: int, loop: int) -> bool:
        """Return whether a region is the body of a loop or lies inside this body."""
        while region not in (_ROOT, loop):
            region = self.parent[region] if region < len(self.parent) else _ROOT
        return region == loop

    def _resolve(self, values: Iterable[int]) -> None:
        stack = list(values)
        while stack:
            value = stack[-1]
            if self.region[value] is None:
                instruction = self.code[value]
                if instruction.op == "input":
                    j = instruction.args[0]
                    producer = self.maker.get(j)
                    self.region[value] = self._holder.get(j, _ROOT) if producer is None else self.parent[producer]
                elif instruction.op == "const":
                    self.region[value] = _ROOT
                else:
                    missing = [a for a in instruction.args if self.region[a] is None]
                    if missing:
                        stack += missing
                        continue
                    self.region[value] = self.deepest(instruction.args)
            stack.pop()

    def _parent(self, k: int) -> int:
        """Return the innermost region that computes a value on which loop k depends."""
        loop = self.loops[k]
        outside = [v for key in loop.before for v in key]
        stack, visited = [v for key in loop.after for v in key], set[int]()
        while stack:
            value = stack.pop()
            if value in visited:
                continue
            visited.add(value)
            if not self.inside(self.of(value), k):
                outside.append(value)
            elif self.code[value].op != "input":
                stack += self.code[value].args
            else:
                inner = self.loop_of(value)
                if inner is not None:
                    stack += [v for key in (*self.loops[inner].before, *self.loops[inner].after) for v in key]
        return self.deepest(outside)

    def _sink(self, outputs: Mapping[str, Key]) -> None:
        """Move values into a conditional if nothing outside the conditional needs these values."""
        order = list(_postorder([v for key in outputs.values() for v in key], self._needs))
        users: dict[int, list[int]] = {}  # node → the nodes that need it; the outputs belong to the root
        for node in order:
            for need in self._needs(node):
                users.setdefault(need, []).append(node)
        results: dict[int, list[int]] = {}
        for value, instruction in enumerate(self.code):
            if instruction.op == "input" and instruction.args[0] in self.maker:
                results.setdefault(self.maker[instruction.args[0]], []).append(value)
        output_values = {v for key in outputs.values() for v in key}
        for k in reversed(range(len(self.loops))):
            loop = self.loops[k]
            if loop.count != 1 or loop.until is None:
                continue
            for node in reversed(order):
                if node in output_values or node == ~k or self._home(node) != self.parent[k]:
                    continue
                # results of a loop move with their loop; symbols and inputs stay
                if node >= 0 and self.code[node].op in ("input", "const"):
                    continue
                values = [node] if node >= 0 else results.get(~node, [])
                if output_values.intersection(values):
                    continue
                uses = [use for value in values for use in self._uses(value, users)]
                if uses and all(self.inside(region, k) for region in uses):
                    if node >= 0:
                        self.region[node] = k
                    else:
                        self.parent[~node] = k
                        for value in values:
                            self.region[value] = k

    def _home(self, node: int) -> int:
        return self.of(node) if node >= 0 else self.parent[~node]

    def _needs(self, node: int) -> Iterator[int]:
        # a node is a value, or ~k for loop k
        if node < 0:
            loop = self.loops[~node]
            return iter([v for key in (*loop.before, *loop.after) for v in key])
        producer = self.loop_of(node)
        if producer is not None:
            return iter([~producer])
        return iter(() if self.code[node].op in ("input", "const") else self.code[node].args)

    def _uses(self, value: int, users: Mapping[int, Sequence[int]]) -> Iterator[int]:
        for node in users.get(value, ()):
            if node >= 0:
                yield self.of(node)
                continue
            loop = self.loops[~node]
            if any(value in key for key in loop.before):
                yield self.parent[~node]
            if any(value in key for key in loop.after):
                yield ~node


def _postorder(roots: Iterable[int], children: Callable[[int], Iterable[int]]) -> Iterator[int]:
    """Yield each node of a dependency graph once, after the nodes on which it depends."""
    visited = set[int]()
    stack = [(root, False) for root in reversed(list(roots))]
    while stack:
        node, done = stack.pop()
        if done:
            yield node
        elif node not in visited:
            visited.add(node)
            stack.append((node, True))
            stack += [(child, False) for child in reversed(list(children(node))) if child not in visited]


def routine(
    name: str, program: Program, inputs: int, outputs: Mapping[str, Key], loops: Sequence[Traced[int, Key]]
) -> Block:
    """Return the instruction list as a routine with loops, or as a program if there is no loop.

    Args:
        program: the instruction list; its first `inputs` inputs are the inputs of the routine. Its other inputs
            represent the state of loops and the table rows that loops read.
        outputs: for each output by name, the list positions of its entries.
        loops: the traced loops, in the order of tracing, so that each loop follows the loops on which it depends.
    """
    regions = _Regions(program, inputs, outputs, loops)
    return _Emitter(regions, name, outputs).root()


@dataclass(frozen=True)
class _Arguments:
    """The arrays that a loop reads."""

    state: tuple[Key, ...]
    tables: tuple[Key, ...]  # one row for each iteration
    fixed: tuple[Key, ...]

    @property
    def all(self) -> tuple[Key, ...]:
        return (*self.state, *self.tables, *self.fixed)


class _Emitter:
    """Builds the programs and routines of the loops, innermost first."""

    def __init__(self, regions: _Regions, name: str, outputs: Mapping[str, Key]) -> None:
        self.regions, self.name, self.outputs = regions, name, outputs
        self.atoms = {i.args: v for v, i in enumerate(regions.code) if i.op == "input"}
        self.arguments: list[_Arguments] = []
        self.blocks: dict[int, Block] = {}
        self._known: dict[str, Block] = {}
        for k, loop in enumerate(regions.loops):
            self.arguments.append(_Arguments(loop.state, loop.tables, tuple(self._fixed(k))))
            if loop.count:
                self.blocks[k] = self._body(k)

    def root(self) -> Block:
        """Return the program or routine of the whole instruction list."""
        program = self.regions.program
        inputs = [(name, self.entries(j)) for j, (name, _) in enumerate(program.inputs[: self.regions.inputs])]
        return _Body(self, self.name, inputs, self.outputs).block()

    def entries(self, j: int) -> Key:
        # −1 for an entry that is not used
        return tuple(self.atoms.get((j, e), -1) for e in range(self.regions.program.inputs[j][1]))

    def stacked(self, k: int) -> list[int]:
        loop = self.regions.loops[k]
        results = loop.results[len(loop.state) :]
        return [at for at, j in enumerate(results) if any(v >= 0 for v in self.entries(j))]

    def _body(self, k: int) -> Block:
        loop, arguments = self.regions.loops[k], self.arguments[k]
        held = len(loop.state)
        inputs = [(f"s{at}" if at < held else f"t{at - held}", self.entries(j)) for at, j in enumerate(loop.own)]
        inputs += [(f"f{at}", key) for at, key in enumerate(arguments.fixed)]
        outputs = {f"n{at}": key for at, key in enumerate(loop.next)}
        outputs |= {f"r{at}": loop.rows[at] for at in self.stacked(k)}
        block = _Body(self, loop.name, inputs, outputs).block()
        return self._known.setdefault(block.digest(), block)

    def _fixed(self, k: int) -> Iterator[Key]:
        """Yield the outer arrays that loop k reads: whole arrays for its inner loops, then single numbers by region."""
        regions = self.regions
        through: dict[Key, None] = {}
        single: dict[int, dict[int, None]] = {}

        def needs(node: int) -> Iterator[int]:
            if node < 0:
                for key in self.arguments[~node].all:
                    if regions.deepest(key) == k:
                        yield from key
                    else:
                        through[key] = None
            elif regions.is_constant(node):
                return
            elif regions.of(node) != k:
                single.setdefault(regions.of(node), {})[node] = None
            elif (producer := regions.loop_of(node)) is not None:
                yield ~producer
            elif regions.code[node].op != "input":
                yield from regions.code[node].args

        loop = regions.loops[k]
        needed = [*loop.next, *(loop.rows[at] for at in self.stacked(k))]
        for _ in _postorder([v for key in needed for v in key], needs):
            pass
        yield from dict.fromkeys((*through, *(tuple(values) for values in single.values())))


class _Body:
    """Builds one region (a loop body, or the code outside all loops) as a program, or as a routine with loops."""

    def __init__(
        self, whole: _Emitter, name: str, inputs: Sequence[tuple[str, Key]], outputs: Mapping[str, Key]
    ) -> None:
        self.whole, self.regions, self.name = whole, whole.regions, name
        self.inputs, self.outputs = inputs, outputs
        self.sizes = {array: len(key) for array, key in inputs}
        self.known = {key: array for array, key in inputs if -1 not in key}
        self.place: dict[int, tuple[str, int]] = {}
        for array, key in inputs:
            for entry, value in enumerate(key):
                if value >= 0:
                    self.place.setdefault(value, (array, entry))
        self.order = list(_postorder([v for key in outputs.values() for v in key], self._needs))
        self.stage: dict[int, int] = {}
        self.packed: dict[Key, int] = {}
        self._schedule()

    def block(self) -> Block:
        if not any(node < 0 for node in self.order):
            return self._program(self.name, 0, self.outputs)
        steps: list[Step] = []
        for at in range(self.last + 1):
            loops = [~node for node in self.order if node < 0 and self.stage[node] == at]
            arrays = {f"pack{n}": key for n, (key, when) in enumerate(self.packed.items()) if when == at}
            later = tuple(v for v in self.order if v in self.handed and self.stage[v] == at)
            if later:
                arrays[f"later{at}"] = later
            what = f"{self.name}_before_{self.regions.loops[loops[0]].name}" if loops else f"{self.name}_end"
            if at == self.last:
                arrays |= {f"out_{name}": key for name, key in self.outputs.items()}
            if arrays:
                body = self._program(what, at, arrays)
                steps.append(Call(body, tuple(name for name, _ in body.inputs), tuple(arrays)))
            for array, key in arrays.items():
                self.sizes[array] = len(key)
                self.known.setdefault(key, array)
            self.place |= {value: (f"later{at}", entry) for entry, value in enumerate(later)}
            steps += [self._step(k) for k in loops]
        inputs = tuple((name, self.sizes[name]) for name, _ in self.inputs)
        return Routine(self.name, inputs, tuple(steps), tuple(f"out_{name}" for name in self.outputs))

    def _needs(self, node: int) -> Iterator[int]:
        if node < 0:
            for key in self.whole.arguments[~node].all:
                if key not in self.known:
                    yield from key
        elif node in self.place or self.regions.is_constant(node):
            return
        elif (producer := self.regions.loop_of(node)) is not None:
            yield ~producer
        else:
            yield from self.regions.code[node].args

    def _schedule(self) -> None:
        """Assign each instruction to the latest possible program, and each loop to the earliest possible position."""
        soon: dict[int, int] = {}
        for node in self.order:
            producer = self.regions.loop_of(node) if node >= 0 and node not in self.place else None
            if producer is not None:
                soon[node] = soon[~producer] + 1
            else:
                soon[node] = max((soon[need] for need in self._needs(node)), default=0)
            if node < 0:
                for key in self.whole.arguments[~node].all:
                    if key not in self.known and key not in self.packed and not self._whole_result(key):
                        self.packed[key] = max((soon[v] for v in key), default=0)
        last = max((soon[v] for key in self.outputs.values() for v in key), default=0)
        users: dict[int, list[int]] = {}
        for key, when in self.packed.items():
            for value in key:
                users.setdefault(value, []).append(when)
        for key in self.outputs.values():
            for value in key:
                users.setdefault(value, []).append(last)
        self.handed: set[int] = set()
        for node in reversed(self.order):
            if node < 0:
                self.stage[node] = soon[node]
            if node < 0 or not self._is_operation(node):  # a load is repeated in every program that needs it
                continue
            uses = users.get(node, [])
            self.stage[node] = min(uses)
            if max(uses) > self.stage[node]:
                self.handed.add(node)
            for argument in self.regions.code[node].args:
                users.setdefault(argument, []).append(self.stage[node])
        self.last = last

    def _is_operation(self, node: int) -> bool:
        return node not in self.place and self.regions.code[node].op not in ("input", "const")

    def _whole_result(self, key: Key) -> bool:
        """Return whether the array `key` as a whole is the result of a loop."""
        first = self.regions.code[key[0]] if key else None
        return (
            first is not None
            and first.op == "input"
            and first.args[0] in self.regions.maker
            and self.whole.entries(first.args[0]) == key
        )

    def _step(self, k: int) -> Loop | Gather:
        loop, arguments = self.regions.loops[k], self.whole.arguments[k]
        held = len(loop.state)
        which = [*range(held), *(held + at for at in self.whole.stacked(k))]
        results = []
        for at in which:
            key, name = self.whole.entries(loop.results[at]), f"{loop.name}{k}_{at}"
            results.append(name)
            self.sizes[name] = len(key)
            if -1 not in key:
                self.known[key] = name
            for entry, value in enumerate(key):
                if value >= 0:
                    self.place[value] = name, entry
        state, tables, fixed = (
            tuple(self.known[key] for key in keys) for keys in (arguments.state, arguments.tables, arguments.fixed)
        )
        if not loop.count:
            return Gather(tables[0], state[0], self.sizes[results[0]], results[0])
        return Loop(self.whole.blocks[k], loop.count, state, tuple(results), tables, fixed, until=loop.until)

    def _program(self, name: str, stage: int, outputs: Mapping[str, Key]) -> Program:
        code, at, arrays = Numbering(), dict[int, int](), dict[str, int]()
        if not any(node < 0 for node in self.order):
            arrays = {array: k for k, (array, _) in enumerate(self.inputs)}

        def position(value: int) -> int:
            if value in at:
                return at[value]
            if self.regions.is_constant(value):
                return code.constant(self.regions.code[value].number)
            array, entry = self.place[value]
            return code.add("input", (arrays.setdefault(array, len(arrays)), entry))

        for value in self.order:
            if value >= 0 and self.stage.get(value) == stage and self._is_operation(value):
                instruction = self.regions.code[value]
                at[value] = code.add(instruction.op, tuple([position(a) for a in instruction.args]))
        refs = [tuple([position(v) for v in key]) for key in outputs.values()]
        instructions, output_refs = drop_dead(code.instructions, refs)
        sizes = tuple((array, self.sizes[array]) for array in arrays)
        output_sizes = tuple((out, len(key)) for out, key in outputs.items())
        return Program(name, sizes, output_sizes, instructions, output_refs)
