"""Random routines that move, join, exchange, carry and gather, for the places where arrays may overlap."""

from __future__ import annotations

import casadi as ca
import numpy as np

from surctl.ir import Block, Call, Gather, Loop, Program, Routine, lower
from surctl.ir.routine import Step

SIZES = (1, 1, 2, 2, 2, 4, 4, 6)


def random_routine(seed: int) -> Routine:
    """A routine of a few steps over small arrays, loops two deep; every other one is a loop that changes its state."""
    maker = _Maker(np.random.default_rng(seed))
    if seed % 2:
        return maker.routine("top", None, None, depth=2)
    body = maker.routine("body", None, [], depth=1)
    state = [f"s{k}" for k in range(len(body.inputs))]
    loop = Loop(body, 3, tuple(state), tuple(f"{name}_last" for name in state))
    inputs = tuple((name, size) for name, (_, size) in zip(state, body.inputs, strict=True))
    return Routine("top", inputs, (loop,), loop.results)


class _Maker:
    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.count = rng, 0
        self.cut: set[str] = set()  # arrays out of which something was moved

    def fresh(self, word: str) -> str:
        self.count += 1
        return f"{word}{self.count}"

    def one(self, values: list[str]) -> str:
        """Any of them, the last ones more often."""
        return values[max(int(self.rng.integers(len(values))), int(self.rng.integers(len(values))))]

    def routine(self, word: str, given: list[int] | None, wanted: list[int] | None, *, depth: int) -> Routine:
        """Of inputs and results of these sizes; of any where None."""
        if given is None:
            given = [int(self.rng.choice(SIZES)) for _ in range(self.rng.integers(1, 4))]
        inputs = tuple((self.fresh("in"), size) for size in given)
        sizes, steps = dict(inputs), list[Step]()
        for _ in range(self.rng.integers(1, 9 if depth == 2 else 6)):
            steps.append(self.step(sizes, depth))
        results = []
        if wanted is None:
            wanted = [0] * int(self.rng.integers(1, 5))
        for size in wanted or given:  # a state that changes has the sizes of the inputs
            fitting = [name for name in sizes if size in (0, sizes[name])]
            if size and (not fitting or self.rng.random() < 0.15):
                steps.append(self.computed(sizes, [size]))
                fitting = list(sizes)[-1:]
            results.append(self.one(fitting))
        return Routine(self.fresh(word), inputs, tuple(steps), tuple(results))

    def step(self, sizes: dict[str, int], depth: int) -> Step:
        kind = self.rng.choice(["move", "move", "compute", "loop", "loop", "gather", "call"])
        if kind == "move":
            return self.moved(sizes)
        if kind == "loop":
            return self.loop(sizes, depth)
        if kind == "call" and depth:
            args = [self.one(list(sizes)) for _ in range(self.rng.integers(1, 4))]
            block = self.routine("called", [sizes[a] for a in args], None, depth=depth - 1)
            return self.called(sizes, block, args)
        indices = [name for name, size in sizes.items() if size == 1]
        if kind == "gather" and indices:
            source = self.one(list(sizes))
            width = int(self.rng.choice([w for w in (1, 2, 3, 4, 6) if sizes[source] % w == 0]))
            result = self.fresh("g")
            step = Gather(source, self.one(indices), width, result)
            sizes[result] = width
            return step
        return self.computed(sizes, [int(self.rng.choice(SIZES)) for _ in range(self.rng.integers(1, 3))])

    def called(self, sizes: dict[str, int], block: Block, args: list[str]) -> Call:
        results = [self.fresh("r") for _ in block.outputs]
        sizes.update(zip(results, (size for _, size in block.outputs), strict=True))
        return Call(block, tuple(args), tuple(results))

    def moved(self, sizes: dict[str, int]) -> Call:
        """Split, join, exchange, or a mixture of pieces."""
        args = [self.one(list(sizes)) for _ in range(self.rng.integers(1, 4))]
        self.cut |= set(args)
        x = [ca.SX.sym(f"x{k}", sizes[a]) for k, a in enumerate(args)]
        kind = self.rng.choice(["split", "join", "exchange", "mixture"])
        if kind == "split":
            cut = int(self.rng.integers(0, sizes[args[0]]))
            made = [part for part in (x[0][:cut], x[0][cut:]) if part.numel()]
        elif kind == "join":
            made = [ca.vertcat(*x)]
        elif kind == "exchange":
            made = x[::-1]
        else:
            made = [ca.vertcat(*(self.piece(x) for _ in range(self.rng.integers(1, 4)))) for _ in range(2)]
        return self.called(sizes, lower(ca.Function(self.fresh("moves"), x, made)), args)

    def piece(self, x: list[ca.SX]) -> ca.SX:
        one = x[int(self.rng.integers(len(x)))]
        a, b = sorted(int(k) for k in self.rng.integers(0, one.numel() + 1, 2))
        return one[a:b] if b > a and self.rng.random() < 0.7 else one

    def computed(self, sizes: dict[str, int], made: list[int]) -> Call:
        args = [self.one(list(sizes)) for _ in range(self.rng.integers(1, 4))]
        return self.called(sizes, self.program([sizes[a] for a in args], made), args)

    def program(self, given: list[int], made: list[int]) -> Program:
        """Every entry a mean of two entries of the inputs and a number of its own."""
        x = [ca.SX.sym(f"x{k}", size) for k, size in enumerate(given)]
        pool = ca.vertcat(*x) if x else ca.SX([1.5])

        def entry() -> ca.SX:
            i, j = (int(k) for k in self.rng.integers(0, pool.numel(), 2))
            return 0.5 * pool[i] - 0.25 * pool[j] + round(float(self.rng.random()), 3)

        return lower(ca.Function(self.fresh("compute"), x, [ca.vertcat(*(entry() for _ in range(n))) for n in made]))

    def exchange(self, carried: list[int], given: list[int], stacked: list[int]) -> Program | None:
        """The carried arrays in another order, where their sizes allow it."""
        order = [int(k) for k in self.rng.permutation(len(carried))]
        if not carried or [carried[k] for k in order] != carried:
            return None
        x = [ca.SX.sym(f"x{k}", size) for k, size in enumerate(given)]
        first = len(given) - len(carried)
        made = [x[first + k] for k in order] + [ca.vertcat(*x)[:1] for n in stacked if n == 1]
        return lower(ca.Function(self.fresh("exchange"), x[first:] + x[:first], made)) if stacked in ([], [1]) else None

    def loop(self, sizes: dict[str, int], depth: int) -> Loop:
        count = int(self.rng.integers(1, 4))
        lanes = 2 if self.rng.random() < 0.15 else 1
        names = list(sizes)
        carried = [self.one(names) for _ in range(self.rng.integers(0, 3))]
        cut = [name for name in names if name in self.cut]
        if cut and self.rng.random() < 0.5:  # changed in place only if none of its pieces is read afterwards
            carried = [self.one(cut), *carried[1:]]
        carried = [name for name in carried if sizes[name] % lanes == 0]
        parts = [name for name in names if sizes[name] % (count * lanes) == 0]
        sliced = [self.one(parts) for _ in range(self.rng.integers(0, 3))] if parts else []
        fixed = [self.one(names) for _ in range(self.rng.integers(0, 3))]
        index = bool(self.rng.random() < 0.3) or not (carried or sliced or fixed)
        state = [sizes[name] // lanes for name in carried]
        flags = [k for k, size in enumerate(state) if size == 1 and lanes == 1]
        until = int(self.rng.choice(flags)) if flags and self.rng.random() < 0.3 else None
        stacked = [int(self.rng.choice((1, 2)))] if until is None and (not carried or self.rng.random() < 0.5) else []
        rest = [sizes[name] // (count * lanes) for name in sliced] + [sizes[name] for name in fixed]
        given = [1] * index + state + rest
        block: Block | None = None
        if self.rng.random() < 0.2 and not index:
            block = self.exchange(state, rest + state, stacked)
        if block is None and lanes == 1 and depth and self.rng.random() < 0.6:
            block = self.routine("body", given, [*state, *stacked], depth=depth - 1)
        if block is None:
            block = self.program(given, [*state, *stacked])
        results = [self.fresh("l") for _ in block.outputs]
        made = [sizes[name] for name in carried] + [n * count * lanes for n in stacked]
        sizes.update(zip(results, made, strict=True))
        return Loop(
            block, count, tuple(carried), tuple(results), tuple(sliced), tuple(fixed), index, until, lanes=lanes
        )
