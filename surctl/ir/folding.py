"""Passes over an instruction list: equal instructions once, folded constants, fused products, shared divisions."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from surctl.errors import InputError
from surctl.ir.program import LEAVES, OPERATIONS, TRUTHS, Instruction, Program, drop_dead
from surctl.ir.routine import Block, Call, Routine, changed_programs


class Numbering:
    """Value numbering: an instruction that the list already contains is not added again; results do not change."""

    def __init__(self) -> None:
        self.instructions: list[Instruction] = []
        self._known: dict[tuple[str, tuple[int, ...] | str], int] = {}

    def constant(self, value: float) -> int:
        """Return the list position of a constant; -0.0 and 0.0 are different constants."""
        # the key is its bit pattern, since 0.0 == -0.0 as numbers
        key = ("const", value.hex())
        at = self._known.get(key)
        return self._append(key, Instruction("const", (), value)) if at is None else at

    def add(self, op: str, args: tuple[int, ...]) -> int:
        """Return the list position of an operation on earlier values, or of the instruction for an input entry."""
        if op not in LEAVES and OPERATIONS[op].commutative:
            args = tuple(sorted(args))
        key = (op, args)
        at = self._known.get(key)
        return self._append(key, Instruction(op, args)) if at is None else at

    def do(self, op: str, *args: int | float) -> int:
        """Return the list position of an operation; an operand of type float is a constant, an int a position."""
        return self.add(op, tuple([self.constant(a) if isinstance(a, float) else a for a in args]))

    def copy(self, instruction: Instruction, moved: list[int]) -> int:
        """Return the position of a copy of an instruction from another list; `moved` maps old to new positions."""
        if instruction.op == "const":
            return self.constant(instruction.number)
        if instruction.op == "input":
            return self.add("input", instruction.args)
        return self.add(instruction.op, tuple(moved[a] for a in instruction.args))

    def rewritten(self, program: Program, moved: list[int]) -> Program:
        """Return the program with this list's instructions that it needs; `moved` maps old to new positions."""
        refs = [tuple(moved[r] for r in group) for group in program.output_refs]
        instructions, output_refs = drop_dead(self.instructions, refs)
        return Program(program.name, program.inputs, program.outputs, instructions, output_refs)

    def _append(self, key: tuple[str, tuple[int, ...] | str], instruction: Instruction) -> int:
        at = self._known[key] = len(self.instructions)
        self.instructions.append(instruction)
        return at


def fused(block: Block) -> Block:
    """Replace a b + c, a b - c and c - a b by `fma` if only sums and differences use the product a b.

    Fusion changes rounding, so `lower` does not fuse. The outputs of the fused program or routine have equal bytes on
    every machine, because IEEE 754 defines the rounding of `fma`. On a machine without an instruction for `fma`, the
    code calls the function of the C library, which is slow.
    """
    return changed_programs(block, _program)


def _program(program: Program) -> Program:
    additive = _additive(program)
    text, moved = Numbering(), list[int]()
    for instruction in program.instructions:
        if instruction.op in ("add", "sub") and additive & set(instruction.args):
            left, right = instruction.args
            product, other = (right, left) if right in additive else (left, right)
            factors = [moved[a] for a in program.instructions[product].args]
            a, b = factors[0], factors[-1]
            addend = moved[other]
            if instruction.op == "sub" and product == right:
                a = text.add("neg", (a,))
            elif instruction.op == "sub":
                addend = text.add("neg", (addend,))
            moved.append(text.add("fma", (a, b, addend)))
        else:
            moved.append(text.copy(instruction, moved))
    return text.rewritten(program, moved)


def _additive(program: Program) -> set[int]:
    """Return the list positions of the products that are used only in sums and differences."""
    products = {at for at, i in enumerate(program.instructions) if i.op in ("mul", "sq")}
    for instruction in program.instructions:
        if instruction.op not in ("add", "sub", "const", "input"):
            products -= set(instruction.args)
    return products - {r for refs in program.output_refs for r in refs}


def shared_divisors(program: Program) -> Program:
    """Replace x / d by x · (1 / d) for every d that is the divisor of more than one division.

    A division takes a vector unit as long as thirty products. If 1 / d is a normal number, the replacement changes a
    quotient by at most two units in the last place. `lower` does not make this replacement, because it must not change
    any bit; and CasADi would convert x · (1 / d) back to x / d.
    """
    divisors = Counter(i.args[-1] for i in program.instructions if i.op in ("div", "inv"))
    text, moved = Numbering(), list[int]()
    for instruction in program.instructions:
        if instruction.op == "div" and divisors[instruction.args[1]] > 1:
            over, under = (moved[a] for a in instruction.args)
            moved.append(text.add("mul", (over, text.add("inv", (under,)))))
        else:
            moved.append(text.copy(instruction, moved))
    return text.rewritten(program, moved)


_LONGEST = 1200
"""Largest number of operations in one C function; the compile time of gcc grows faster than this number."""


def shortened(block: Block) -> Block:
    """Return the program or routine with its long programs split, except programs that run in SIMD lanes."""
    return changed_programs(block, partial(split, size=_LONGEST), lanes=False)


def split(program: Program, size: int) -> Block:
    """Return a routine that calls parts of a program, each of at most `size` operations; short programs are unchanged.

    A part returns, as one array, the values that later parts or the outputs need. Constants and the reading of inputs
    are repeated in each part.
    """
    count = -(-program.operations // size)
    if count < 2:
        return program
    operations = [at for at, i in enumerate(program.instructions) if i.op not in LEAVES]
    size = -(-program.operations // count)
    owner = {at: k // size for k, at in enumerate(operations)}  # number of the part to which each belongs
    last = count - 1
    needed: list[list[int]] = [[] for _ in range(count)]  # values that each part passes on, in order
    place: dict[int, tuple[int, int]] = {}
    uses = [(at, arg) for at, i in enumerate(program.instructions) if i.op not in LEAVES for arg in i.args]
    uses += [(-1, ref) for refs in program.output_refs for ref in refs]
    for user, arg in uses:
        if arg in owner and owner[arg] != (last if user < 0 else owner[user]) and arg not in place:
            place[arg] = (owner[arg], len(needed[owner[arg]]))
            needed[owner[arg]].append(arg)
    free = "part"  # no input has a name that begins so
    while any(name.startswith(free) for name, _ in program.inputs):
        free += "x"
    steps = []
    for part in range(count):
        mine = [at for at, of in owner.items() if of == part]
        refs = list(program.output_refs) if part == last else [tuple(needed[part])]
        outputs = program.outputs if part == last else ((f"{free}{part}", len(needed[part])),)
        arrays = (*program.inputs, *((f"{free}{k}", len(needed[k])) for k in range(part)))
        body = _part(program, mine, refs, place, (f"{program.name}_{part}", arrays, outputs))
        results = tuple(f"{free}{last}_{k}" for k in range(len(outputs))) if part == last else (outputs[0][0],)
        steps.append(Call(body, tuple(name for name, _ in body.inputs), results))
    return Routine(program.name, program.inputs, tuple(steps), steps[-1].results)


def _part(
    program: Program,
    mine: list[int],
    refs: list[tuple[int, ...]],
    place: dict[int, tuple[int, int]],
    head: tuple[str, tuple[tuple[str, int], ...], tuple[tuple[str, int], ...]],
) -> Program:
    name, arrays, outputs = head
    code, at_of = Numbering(), dict[int, int]()

    def position(old: int) -> int:
        if old not in at_of:
            instruction = program.instructions[old]
            if instruction.op == "const":
                at_of[old] = code.constant(instruction.number)
            elif instruction.op == "input":
                at_of[old] = code.add("input", instruction.args)
            else:
                part, entry = place[old]
                at_of[old] = code.add("input", (len(program.inputs) + part, entry))
        return at_of[old]

    for old in mine:
        instruction = program.instructions[old]
        at_of[old] = code.add(instruction.op, tuple(position(a) for a in instruction.args))
    moved = [tuple(position(r) for r in group) for group in refs]
    instructions, output_refs = drop_dead(code.instructions, moved)
    used = sorted({i.args[0] for i in instructions if i.op == "input"})
    rank = {old: new for new, old in enumerate(used)}
    instructions = tuple(
        Instruction("input", (rank[i.args[0]], i.args[1])) if i.op == "input" else i for i in instructions
    )
    return Program(name, tuple(arrays[k] for k in used), outputs, instructions, output_refs)


def with_constants(program: Program, source: int, values: Sequence[float]) -> Program:
    """Return the program with constants instead of the entries of an input, and with the constant results computed.

    The input remains in the program's list of inputs but is not read. For finite numbers, the outputs equal those of
    the original program with `values` as input, except for the sign of a zero, because x + 0 becomes x and 0 · x
    becomes 0. Constant values are computed in double; if the program is evaluated in another precision, they are then
    rounded to it.
    """
    name, size = program.inputs[source]
    if len(values) != size or not all(math.isfinite(v) for v in values):
        raise InputError(f"needs {size} finite numbers", key=f"{program.name}.{name}")
    if program.libm:
        raise InputError("uses the mathematical library", key=program.name, remedy="apply surctl.ir.without_libm first")
    text, moved = _Folding(), list[int]()
    for instruction in program.instructions:
        if instruction.op == "input" and instruction.args[0] == source:
            moved.append(text.constant(float(values[instruction.args[1]])))
        elif instruction.op in LEAVES:
            moved.append(text.copy(instruction, moved))
        else:
            moved.append(text.folded(instruction.op, tuple(moved[a] for a in instruction.args)))
    return text.rewritten(program, moved)


class _Folding(Numbering):
    """An instruction list under construction in which no operation has only constant operands."""

    def value(self, at: int) -> float | None:
        return self.instructions[at].value

    def folded(self, op: str, args: tuple[int, ...]) -> int:
        known = [self.value(a) for a in args]
        if all(v is not None for v in known):
            with np.errstate(all="ignore"):
                return self.constant(float(OPERATIONS[op].numpy(*(np.float64(v) for v in known))))
        rule = _RULES.get(op)
        simplified = rule(self, args) if rule else None
        return self.add(op, args) if simplified is None else simplified

    def is_truth(self, at: int) -> bool:
        return self.instructions[at].op in TRUTHS

    def op(self, at: int) -> str:
        return self.instructions[at].op

    def args(self, at: int) -> tuple[int, ...]:
        return self.instructions[at].args

    def is_true(self, at: int) -> int:
        """Return the list position of the value's truth value: 0 if the value is 0, otherwise 1."""
        return at if self.is_truth(at) else self.folded("ne", (at, self.constant(0.0)))


_POSITIVE = frozenset({"fabs", "sq", "sqrt"}) | TRUTHS


def _sum(text: _Folding, args: tuple[int, ...]) -> int | None:
    for one, other in (args, args[::-1]):
        if text.value(one) == 0.0:
            return other
        if text.op(other) == "neg":  # x + (-y)
            return text.folded("sub", (one, text.args(other)[0]))
        if text.op(other) == "if_else_zero" and text.op(text.args(other)[1]) == "neg":
            condition, then = text.args(other)
            return text.folded("sub", (one, text.folded("if_else_zero", (condition, text.args(then)[0]))))
    return _one_condition(text, "add", args)


def _difference(text: _Folding, args: tuple[int, ...]) -> int | None:
    if text.value(args[1]) == 0.0:
        return args[0]
    if text.op(args[1]) == "neg":
        return text.folded("add", (args[0], text.args(args[1])[0]))
    return _one_condition(text, "sub", args)


def _one_condition(text: _Folding, op: str, args: tuple[int, ...]) -> int | None:
    """Return the sum or difference of two `if_else_zero` with equal conditions as one `if_else_zero`, or None."""
    if all(text.op(a) == "if_else_zero" for a in args) and text.args(args[0])[0] == text.args(args[1])[0]:
        inner = text.folded(op, tuple(text.args(a)[1] for a in args))
        return text.folded("if_else_zero", (text.args(args[0])[0], inner))
    return None


def _product(text: _Folding, args: tuple[int, ...]) -> int | None:
    for one, other in (args, args[::-1]):
        factor = text.value(one)
        if factor == 0.0:
            return text.constant(0.0)
        if factor == 1.0:
            return other
        if factor is not None and text.is_truth(other):
            return text.folded("if_else_zero", (other, one))
    return None


def _larger(text: _Folding, args: tuple[int, ...]) -> int | None:
    if all(text.is_truth(a) for a in args):
        return text.folded("or", args)
    value = text.value(args[1])
    return args[0] if value is not None and value <= 0.0 and text.op(args[0]) in _POSITIVE else None


def _both(text: _Folding, args: tuple[int, ...]) -> int | None:
    for one, other in (args, args[::-1]):
        value = text.value(one)
        if value is not None:
            return text.is_true(other) if value else text.constant(0.0)
    return text.is_true(args[0]) if args[0] == args[1] else None


def _either(text: _Folding, args: tuple[int, ...]) -> int | None:
    for one, other in (args, args[::-1]):
        value = text.value(one)
        if value is not None:
            return text.constant(1.0) if value else text.is_true(other)
    return text.is_true(args[0]) if args[0] == args[1] else None


def _select(text: _Folding, args: tuple[int, ...]) -> int | None:
    condition, then, otherwise = args
    value = text.value(condition)
    if value is not None:
        return then if value else otherwise
    if then == otherwise:
        return then
    return text.folded("if_else_zero", (condition, then)) if text.value(otherwise) == 0.0 else None


def _only_if(text: _Folding, args: tuple[int, ...]) -> int | None:
    condition, then = args
    if text.op(then) in ("select", "if_else_zero") and text.args(then)[0] == condition:
        return text.folded("if_else_zero", (condition, text.args(then)[1]))
    return condition if text.value(then) == 1.0 and text.is_truth(condition) else None


_RULES: dict[str, Callable[[_Folding, tuple[int, ...]], int | None]] = {
    "add": _sum,
    "sub": _difference,
    "mul": _product,
    "fmax": _larger,
    "and": _both,
    "or": _either,
    "select": _select,
    "if_else_zero": _only_if,
}
