"""Bound of the machine instructions of one step: the longest path through the disassembled code of the program."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from graphlib import TopologicalSorter

import numpy as np

__all__ = ["InstructionBound", "instruction_bound"]

_FUNCTION = re.compile(r"^[0-9a-f]+ <([^>]+)>:$")
_LINE = re.compile(r"^\s*([0-9a-f]+):\s+(?:[0-9a-f]{4}(?: [0-9a-f]{4})?|[0-9a-f]{8})\s*\t(\S+)\s*(.*)$")
_CONDITIONS = ("eq", "ne", "cs", "cc", "hs", "lo", "mi", "pl", "vs", "vc", "hi", "ls", "ge", "lt", "gt", "le")
_BRANCH = re.compile(rf"^b({'|'.join(_CONDITIONS)})?(?:\.[nw])?$")
_TARGET = re.compile(r"([0-9a-f]+) <([^>+]+)(?:\+0x[0-9a-f]+)?>")


class _Unbounded(Exception):
    """The code has a recursion, a loop of the compiler's library, or a jump whose target the text does not state."""


@dataclass(frozen=True)
class InstructionBound:
    """Largest number of instructions of a function, or why the code gives none.

    Attributes:
        most: bound of the instructions from the first one of the function to its return, with all calls, or None.
        reason: why there is none, None if there is one.
    """

    most: int | None
    reason: str | None = None


@dataclass(frozen=True)
class _Instruction:
    at: int
    name: str
    operands: str


def instruction_bound(listing: str, function: str, *, turns: int, own: str) -> InstructionBound:
    """Return a bound of the instructions of one call, from the listing of `arm-none-eabi-objdump -d`.

    Every path through the branches counts, whether or not its conditions can hold together, so that the bound is not
    smaller than any run. An instruction that a condition skips counts as executed. Each loop of the exported functions
    counts as if it ran `turns` times; loops of other functions (division in software, for example) have no bound here.
    Instructions are not cycles.

    Args:
        listing: text of the disassembler for a linked program for Cortex-M (Thumb-2).
        function: name of the function.
        turns: largest number of turns of any loop of the exported functions.
        own: beginning of the names of the exported functions.

    Example:
        >>> text = "00000000 <f>:\\n   0:\\t2800 \\tcmp\\tr0, #0\\n   2:\\td000 \\tbeq.n\\t6 <f+0x6>\\n"
        >>> text += "   4:\\t3001 \\tadds\\tr0, #1\\n   6:\\t4770 \\tbx\\tlr\\n"
        >>> instruction_bound(text, "f", turns=1, own="f")
        InstructionBound(most=4, reason=None)
    """
    try:
        return InstructionBound(_Program(listing, turns, own).most(function))
    except _Unbounded as reason:
        return InstructionBound(None, str(reason))


def _functions(listing: str) -> Iterator[tuple[str, list[_Instruction]]]:
    body: list[_Instruction] = []
    for line in listing.splitlines():
        if head := _FUNCTION.match(line):
            body = []
            yield head[1], body
        elif parts := _LINE.match(line):
            operands = re.split(r"[;@]", parts[3])[0].strip()  # the comment may name places that are no targets
            body.append(_Instruction(int(parts[1], 16), parts[2], operands))


class _Program:
    """The functions of a program, and the bounds of those that were asked for."""

    def __init__(self, listing: str, turns: int, own: str) -> None:
        self.functions = dict(_functions(listing))
        self.turns, self.own = turns, own
        self.known: dict[str, int] = {}
        self.open: set[str] = set()

    def most(self, name: str) -> int:
        """Return the bound of one call of a function."""
        if name in self.known:
            return self.known[name]
        if name in self.open:
            raise _Unbounded(f"{name} is recursive")
        if not self.functions.get(name):
            raise _Unbounded(f"{name} is not in the program")
        self.open.add(name)
        body = self.functions[name]
        order = {each.at: k for k, each in enumerate(body)}
        cost: dict[int, int] = {}
        after: dict[int, list[int]] = {}
        waiting = [0]
        while waiting:
            k = waiting.pop()
            if k in cost:
                continue
            if k == len(body):  # it runs on into the next function, as parts of the library do
                cost[k], after[k] = self.most(self._next(name)), []
                continue
            cost[k], places = self._after(body[k], name)
            after[k] = [k + 1 if place < 0 else order.get(place, len(body)) for place in places]
            waiting += after[k]
        self.known[name] = self._longest(cost, after, frozenset({0}), name)
        self.open.discard(name)
        return self.known[name]

    def _next(self, name: str) -> str:
        names = list(self.functions)
        here = names.index(name) + 1
        end = self.functions[name][-1].at
        if here == len(names) or not self.functions[names[here]] or self.functions[names[here]][0].at > end + 4:
            raise _Unbounded(f"{name} runs on beyond its end")
        return names[here]

    def _longest(
        self, cost: Mapping[int, int], after: Mapping[int, list[int]], first: frozenset[int], name: str
    ) -> int:
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        # loops are the strong components; each counts as one node, as often as its entries can be passed
        nodes = sorted(cost)
        at = {k: i for i, k in enumerate(nodes)}
        pairs = [(k, n) for k in nodes for n in after[k] if n in at]
        rows, columns = ([at[pair[side]] for pair in pairs] for side in (0, 1))
        size = len(nodes)
        matrix = coo_array((np.ones(len(pairs), dtype=np.int8), (rows, columns)), shape=(size, size))
        part = dict(
            zip(nodes, connected_components(matrix, directed=True, connection="strong")[1].tolist(), strict=True)
        )
        members: dict[int, list[int]] = {}
        for k in nodes:
            members.setdefault(part[k], []).append(k)
        before: dict[int, set[int]] = {one: set() for one in members}
        entries = {one: set(inside) & first for one, inside in members.items()}
        turning = {part[k] for k, n in pairs if k == n}
        for k, n in pairs:
            if part[k] == part[n]:
                turning.add(part[k])
            else:
                before[part[n]].add(part[k])
                entries[part[n]].add(n)
        longest: dict[int, int] = {}
        for one in TopologicalSorter(before).static_order():
            inside = members[one]
            weight = cost[inside[0]]
            if one in turning:
                if not name.startswith(self.own):
                    raise _Unbounded(f"{name} has a loop")
                heads = frozenset(entries[one])
                onward = {k: [n for n in after[k] if part.get(n) == one and n not in heads] for k in inside}
                once = self._longest({k: cost[k] for k in inside}, onward, heads, name)
                backs = sum(n in heads for k in inside for n in after[k])  # loops may share their entry
                weight = len(heads) * (self.turns + 1) ** max(backs, 1) * once
            longest[one] = weight + max((longest[each] for each in before[one]), default=0)
        return max(longest.values())

    def _after(self, here: _Instruction, name: str) -> tuple[int, list[int]]:
        # instructions of this one with its call, and what follows: addresses, -1 for the next one, none after a return
        where = _TARGET.search(here.operands)
        if branch := _BRANCH.match(here.name):
            onward = [-1] if branch[1] else []
            if where is None:
                raise _Unbounded(f"{name} jumps to a place that the listing does not state")
            if where[2] != name:  # a call in the last place of the function
                return 1 + self.most(where[2]), onward
            return 1, [int(where[1], 16), *onward]
        if here.name in ("cbz", "cbnz") and where is not None:
            return 1, [int(where[1], 16), -1]
        if here.name == "bl" and where is not None:
            return 1 + self.most(where[2]), [-1]
        returns = re.match(r"^(?:pop|ldm(?:ia)?|bx|ldr)([a-z]{2})?(?:\.[nw])?$", here.name)
        if returns and (here.operands == "lr" or re.search(r"\bpc}$|^pc, \[sp\]", here.operands)):
            return 1, [-1] if returns[1] in _CONDITIONS else []
        if re.match(r"^(bx|blx|tbb|tbh|udf)", here.name) or re.match(r"^(\{?pc\b)|.*\bpc}$", here.operands):
            raise _Unbounded(f"{name} jumps to a place that only its run knows")
        return 1, [-1]
