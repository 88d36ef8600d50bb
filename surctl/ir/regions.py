"""Assignment of the instructions of a flat list with traced loops to the loop in which each instruction runs.

The flat list contains the instructions outside all loops and one copy of every loop body; input symbols represent the
state of each loop and its table rows. An instruction belongs to the innermost loop on whose symbols it depends. So a
value that does not change in a loop is computed before the loop. Values that only a conditional needs are moved into
the conditional (a loop with one iteration that a flag can skip).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from surctl.ir.program import Program

__all__ = ["ROOT", "Key", "Regions", "Traced", "postorder"]

Key = tuple[int, ...]
"""The values in an array, each as a position in the instruction list."""

ROOT = -1
"""The number of the region that contains the instructions outside all loops."""


@dataclass(frozen=True)
class Traced:
    """A loop whose values are given as positions in the flat instruction list.

    Attributes:
        name: name of the loop body.
        depth: nesting depth when the loop was traced; 1 for an outermost loop.
        count: number of iterations; 0 for a table row that is picked: the state is its index, and the result the row.
        own: inputs of the list that represent the loop's state, then those for the table rows of the present iteration.
        results: inputs of the list that represent the final state of the loop, then those for its stacked arrays.
        state, tables: initial state of the loop, and tables that the loop reads row by row.
        next, rows: values that one iteration computes: `next` is the next state, and `rows` are rows of the stacked
            arrays.
        until: position in the state of the flag that ends the loop; None if there is no flag.
    """

    name: str
    depth: int
    count: int
    own: tuple[int, ...]
    results: tuple[int, ...]
    state: tuple[Key, ...]
    tables: tuple[Key, ...]
    next: tuple[Key, ...]
    rows: tuple[Key, ...]
    until: int | None = None

    @property
    def before(self) -> tuple[Key, ...]:
        """Return the values that exist before the loop: its initial state and its tables."""
        return (*self.state, *self.tables)

    @property
    def after(self) -> tuple[Key, ...]:
        """Return the values that the loop body computes: the next state and the rows of the stacked arrays."""
        return (*self.next, *self.rows)


class Regions:
    """Assignment of every value to the region that computes it: a loop body, or the root (the code outside all loops).

    Attributes:
        region: for each value, the loop whose body computes it.
        parent: for each loop, the outer loop whose body contains it.
    """

    def __init__(self, program: Program, inputs: int, outputs: Mapping[str, Key], loops: Sequence[Traced]) -> None:
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
        return max((self.of(v) for v in values if not self.is_constant(v)), key=self._depth, default=ROOT)

    def _depth(self, region: int) -> int:
        return 0 if region == ROOT else self.loops[region].depth

    def inside(self, region: int, loop: int) -> bool:
        """Return whether a region is the body of a loop or lies inside this body."""
        while region not in (ROOT, loop):
            region = self.parent[region] if region < len(self.parent) else ROOT
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
                    self.region[value] = self._holder.get(j, ROOT) if producer is None else self.parent[producer]
                elif instruction.op == "const":
                    self.region[value] = ROOT
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
        order = list(postorder([v for key in outputs.values() for v in key], self._needs))
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


def postorder(roots: Iterable[int], children: Callable[[int], Iterable[int]]) -> Iterator[int]:
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
