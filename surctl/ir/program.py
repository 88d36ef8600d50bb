"""The instruction list: a function as plain data; its operations, text and digest.

IEEE 754 defines the value of every operation to the last bit, except for the operations in `LIBM`. So every back end
computes the same bytes. `fma` is a product and a sum with one rounding. Operations return 1 for true and 0 for false,
and treat any nonzero number as true (also a NaN, as in C).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError

_Value = NDArray[np.floating[Any]]  # () or (batch,), of the replay's dtype

LEAVES = frozenset({"const", "input"})
"""Instructions without operands: `const` has a `value`; `args` of `input` are the indices of input and entry."""


@dataclass(frozen=True)
class Operation:
    """One operation of the instruction list.

    Attributes:
        name: name in the instruction list: CasADi's name in lower case, or `select`.
        arity: number of operands.
        numpy: NumPy function that performs the operation on arrays of one dtype; a bool result represents 0 and 1.
        commutative: whether the operands can be swapped without a change of any bit of a finite result.
    """

    name: str
    arity: int
    numpy: Callable[..., Any]
    commutative: bool = False


def _select(condition: _Value, then: _Value, otherwise: _Value) -> Any:
    return np.where(condition != 0, then, otherwise)


def _if_else_zero(condition: _Value, then: _Value) -> Any:
    return np.where(condition != 0, then, np.zeros_like(then))


def _fmin(a: _Value, b: _Value) -> Any:
    # not np.fmin: for signed zeros and NaN the result must be that of the C text
    return np.where(b < a, b, a)


def _fmax(a: _Value, b: _Value) -> Any:
    return np.where(a < b, b, a)


def _fma(a: _Value, b: _Value, c: _Value) -> Any:
    single = np.result_type(a, b, c) == np.float32
    return np.frompyfunc(_fma_single if single else _fma_double, 3, 1)(a, b, c)


def _fma_double(*operands: Any) -> float:
    # rational numbers: slow, but the only rounding is the last step, for every double
    a, b, c = map(float, operands)
    if not (math.isfinite(a) and math.isfinite(b)) or (c == 0.0 and 0.0 in (a, b)):
        return a * b + c
    if not math.isfinite(c):  # a b must not overflow to the opposite infinity
        return c
    exact = Fraction(a) * Fraction(b) + Fraction(c)
    try:
        return float(exact)
    except OverflowError:
        return math.inf if exact > 0 else -math.inf


def _fma_single(a: Any, b: Any, c: Any) -> float:
    once = _fma_double(a, b, c)
    if math.isfinite(once):  # a second rounding errs if the double lies midway between floats; its last bit decides
        lost = Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c)) - Fraction(once)
        if lost and not np.float64(once).view(np.int64) & 1:
            once = math.nextafter(once, math.copysign(math.inf, lost))
    return once


_TABLE = (
    Operation("add", 2, lambda a, b: a + b, commutative=True),
    Operation("sub", 2, lambda a, b: a - b),
    Operation("mul", 2, lambda a, b: a * b, commutative=True),
    Operation("div", 2, lambda a, b: a / b),
    Operation("fma", 3, _fma),
    Operation("neg", 1, lambda a: -a),
    Operation("inv", 1, lambda a: 1.0 / a),
    Operation("sq", 1, lambda a: a * a),
    Operation("twice", 1, lambda a: a + a),
    Operation("sqrt", 1, np.sqrt),
    Operation("fabs", 1, np.abs),
    Operation("floor", 1, np.floor),
    Operation("fmin", 2, _fmin),
    Operation("fmax", 2, _fmax),
    Operation("lt", 2, lambda a, b: a < b),
    Operation("le", 2, lambda a, b: a <= b),
    Operation("eq", 2, lambda a, b: a == b, commutative=True),
    Operation("ne", 2, lambda a, b: a != b, commutative=True),
    Operation("and", 2, lambda a, b: (a != 0) & (b != 0), commutative=True),
    Operation("or", 2, lambda a, b: (a != 0) | (b != 0), commutative=True),
    Operation("not", 1, lambda a: a == 0),
    Operation("if_else_zero", 2, _if_else_zero),
    Operation("select", 3, _select),
    Operation("sin", 1, np.sin),
    Operation("cos", 1, np.cos),
    Operation("atan2", 2, np.arctan2),
    Operation("acos", 1, np.arccos),
    Operation("tan", 1, np.tan),
    Operation("exp", 1, np.exp),
    Operation("log", 1, np.log),
    Operation("tanh", 1, np.tanh),
)

OPERATIONS: Mapping[str, Operation] = MappingProxyType({op.name: op for op in _TABLE})
"""The operations by name."""

LIBM = frozenset({"sin", "cos", "atan2", "acos", "tan", "exp", "log", "tanh"})
"""Operations whose last bits depend on the platform's mathematical library."""

SUBSTITUTES: Mapping[str, str] = MappingProxyType(
    {
        "assertion": "check outside the law",
        "call": "build the inner function without never_inline",
        "erf": "approximate it by a polynomial or a rational function",
        "monitor": "remove it",
        "parameter": "make it an input of the function",
        "printme": "remove it",
    }
)
"""For operations that the instruction list does not support, the replacement that an error message suggests."""


_ARITY = {name: operation.arity for name, operation in OPERATIONS.items()}


@dataclass(frozen=True, slots=True)
class Instruction:
    """One assignment; other instructions refer to its value by its position in the list.

    Attributes:
        op: `const`, `input`, or a name in `surctl.ir.program.OPERATIONS`.
        args: list positions of the operands, which are earlier instructions; for `input`: (index of the input, index of
            the entry).
        value: the number of a `const`, None otherwise.
    """

    op: str
    args: tuple[int, ...] = ()
    value: float | None = None

    @property
    def number(self) -> float:
        """Return the value of a `const` instruction; -0.0 and 0.0 are different values."""
        assert self.value is not None
        return float(self.value)


@dataclass(frozen=True)
class Program:
    """A function of flat vectors in static single assignment form.

    Attributes:
        name: name of the original function.
        inputs: (name, number of entries) of each input vector.
        outputs: (name, number of entries) of each output vector.
        instructions: the instruction list; every operand precedes its use.
        output_refs: for each output, the list positions of the values of its entries.

    Raises:
        InputError: an unknown operation, an operand that is not computed before its use, an entry outside
            an input or a reference outside the list (possible only for data that `lower` did not create).
    """

    name: str
    inputs: tuple[tuple[str, int], ...]
    outputs: tuple[tuple[str, int], ...]
    instructions: tuple[Instruction, ...]
    output_refs: tuple[tuple[int, ...], ...]

    def __post_init__(self) -> None:
        """Raise InputError for an instruction list that a back end could not run."""
        for at, instruction in enumerate(self.instructions):
            args = instruction.args
            # most instructions are operations on earlier values
            if len(args) == _ARITY.get(instruction.op) and min(args) >= 0 and max(args) < at:
                continue
            problem = self._problem(at, instruction)
            if problem:
                raise InputError(problem, key=f"{self.name}[{at}]", value=instruction.op)
        sizes = tuple(len(refs) for refs in self.output_refs)
        if sizes != tuple(size for _, size in self.outputs):
            raise InputError("outputs and their references differ in size", key=self.name)
        if any(not 0 <= r < len(self.instructions) for refs in self.output_refs for r in refs):
            raise InputError("an output refers outside the instruction list", key=self.name)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle all but the function of Python that `replay` keeps here: it belongs to its process."""
        return {name: value for name, value in self.__dict__.items() if name != "_python"}

    def _problem(self, at: int, instruction: Instruction) -> str:
        op, args = instruction.op, instruction.args
        if op == "const":
            return "" if instruction.value is not None and not args else "a constant needs a value and no operand"
        if op == "input":
            inside = len(args) == 2 and 0 <= args[0] < len(self.inputs)
            return "" if inside and 0 <= args[1] < self.inputs[args[0]][1] else "no such input entry"
        if op not in OPERATIONS:
            return "unknown operation"
        if len(args) != OPERATIONS[op].arity:
            return f"takes {OPERATIONS[op].arity} operands, has {len(args)}"
        return "" if all(0 <= a < at for a in args) else "an operand is not computed before its use"

    @cached_property
    def libm(self) -> frozenset[str]:
        """Return the names of the operations that call libm (such as sin), whose last bits depend on the machine."""
        return frozenset(i.op for i in self.instructions) & LIBM

    @cached_property
    def operations(self) -> int:
        """Return the number of instructions that compute a value (all except constants and input entries)."""
        return sum(1 for i in self.instructions if i.op not in LEAVES)

    def text(self) -> str:
        """Return the whole program as text; programs with equal texts are equal, on any machine."""
        return self._text

    @cached_property
    def _text(self) -> str:  # cached, since the digest of every routine around it uses it
        lines = [f"program {self.name}"]
        lines += [f"in{k} {name} {size}" for k, (name, size) in enumerate(self.inputs)]
        lines += [f"v{at} = {_right_side(i)}" for at, i in enumerate(self.instructions)]
        for k, ((name, _), refs) in enumerate(zip(self.outputs, self.output_refs, strict=True)):
            lines.append(" ".join([f"out{k} {name}", *(f"v{r}" for r in refs)]))
        return "\n".join(lines) + "\n"

    def digest(self) -> str:
        """Return the SHA-256 of `text`, in hexadecimal; it identifies the program, for example as a key in caches."""
        return self._digest

    @cached_property
    def _digest(self) -> str:
        return hashlib.sha256(self.text().encode()).hexdigest()


def _right_side(instruction: Instruction) -> str:
    op, args = instruction.op, instruction.args
    if op == "const":
        return f"const {float(0.0 if instruction.value is None else instruction.value).hex()}"  # -0.0 differs from 0.0
    if op == "input":
        return f"in{args[0]}[{args[1]}]"
    if len(args) == 2:
        return f"{op} v{args[0]} v{args[1]}"
    return " ".join([op, *[f"v{a}" for a in args]])


def drop_dead(
    instructions: list[Instruction], refs: list[tuple[int, ...]]
) -> tuple[tuple[Instruction, ...], tuple[tuple[int, ...], ...]]:
    """Return (instructions, output_refs) with only the instructions that the outputs need, in unchanged order."""
    live = bytearray(len(instructions))
    for group in refs:
        for ref in group:
            live[ref] = 1
    for at in range(len(instructions) - 1, -1, -1):
        if live[at] and instructions[at].op not in LEAVES:
            for arg in instructions[at].args:
                live[arg] = 1
    remaining: list[Instruction] = []
    new = [0] * len(instructions)
    for at, instruction in enumerate(instructions):
        if live[at]:
            new[at] = len(remaining)
            # before the first dropped instruction no position changes
            moved = new[at] != at and instruction.op not in LEAVES
            remaining.append(_renumbered(instruction, new) if moved else instruction)
    return tuple(remaining), tuple(tuple([new[r] for r in group]) for group in refs)


def _renumbered(instruction: Instruction, new: Sequence[int]) -> Instruction:
    return Instruction(instruction.op, tuple([new[a] for a in instruction.args]), instruction.value)
