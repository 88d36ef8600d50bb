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
        kinds: kind of each operand, then of the result: v for a number, m for a truth value.
        python: Python text of the result for NumPy arrays of one dtype, where truth values are arrays of bool; zero and
            one are numbers of this dtype, other names are in `IN_PYTHON`.
        commutative: whether the operands can be swapped without a change of any bit of a finite result.
    """

    name: str
    kinds: str
    python: str
    commutative: bool = False

    @property
    def arity(self) -> int:
        """Return the number of operands."""
        return len(self.kinds) - 1

    @cached_property
    def numpy(self) -> Callable[..., Any]:
        """Return the operation as a function of doubles, of which any but 0 is true."""
        names = "abc"[: self.arity]
        operands = [f"({name} != 0)" if kind == "m" else name for name, kind in zip(names, self.kinds, strict=False)]
        scope = {**IN_PYTHON, "zero": np.float64(0.0), "one": np.float64(1.0)}
        function: Callable[..., Any] = eval(f"lambda {', '.join(names)}: {self.python.format(*operands)}", scope)
        return function


def _fma(a: _Value, b: _Value, c: _Value) -> Any:
    single = np.result_type(a, b, c) == np.float32
    exact = np.frompyfunc(_fma_single if single else _fma_double, 3, 1)(a, b, c)
    return np.asarray(exact, dtype=np.float32 if single else np.float64)


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


_OF_NUMPY = (np.sqrt, np.abs, np.floor, np.sin, np.cos, np.tan, np.exp, np.log, np.tanh)

IN_PYTHON: Mapping[str, Callable[..., Any]] = MappingProxyType(
    {"where": np.where, "fma": _fma, "atan2": np.arctan2, "acos": np.arccos, **{f.__name__: f for f in _OF_NUMPY}}
)
"""Functions in the Python text of operations, by name."""

_TABLE = (
    Operation("add", "vvv", "{0} + {1}", commutative=True),
    Operation("sub", "vvv", "{0} - {1}"),
    Operation("mul", "vvv", "{0} * {1}", commutative=True),
    Operation("div", "vvv", "{0} / {1}"),
    Operation("fma", "vvvv", "fma({0}, {1}, {2})"),
    Operation("neg", "vv", "-{0}"),
    Operation("inv", "vv", "one / {0}"),
    Operation("sq", "vv", "{0} * {0}"),
    Operation("twice", "vv", "{0} + {0}"),
    Operation("sqrt", "vv", "sqrt({0})"),
    Operation("fabs", "vv", "absolute({0})"),
    Operation("floor", "vv", "floor({0})"),
    # not np.fmin: for signed zeros and NaN the result must be that of the C text
    Operation("fmin", "vvv", "where({1} < {0}, {1}, {0})"),
    Operation("fmax", "vvv", "where({0} < {1}, {1}, {0})"),
    Operation("lt", "vvm", "{0} < {1}"),
    Operation("le", "vvm", "{0} <= {1}"),
    Operation("eq", "vvm", "{0} == {1}", commutative=True),
    Operation("ne", "vvm", "{0} != {1}", commutative=True),
    Operation("and", "mmm", "{0} & {1}", commutative=True),
    Operation("or", "mmm", "{0} | {1}", commutative=True),
    Operation("not", "mm", "~{0}"),
    Operation("if_else_zero", "mvv", "where({0}, {1}, zero)"),
    Operation("select", "mvvv", "where({0}, {1}, {2})"),
    Operation("sin", "vv", "sin({0})"),
    Operation("cos", "vv", "cos({0})"),
    Operation("atan2", "vvv", "atan2({0}, {1})"),
    Operation("acos", "vv", "acos({0})"),
    *(Operation(name, "vv", f"{name}({{0}})") for name in ("tan", "exp", "log", "tanh")),
)

OPERATIONS: Mapping[str, Operation] = MappingProxyType({op.name: op for op in _TABLE})
"""The operations by name."""

TRUTHS = frozenset(op.name for op in _TABLE if op.kinds[-1] == "m")
"""Names of the operations that return a truth value."""

LIBM = frozenset({"sin", "cos", "atan2", "acos", "tan", "exp", "log", "tanh"})
"""Operations whose last bits depend on the platform's mathematical library."""

SUBSTITUTES: Mapping[str, str] = MappingProxyType(
    {
        "assertion": "check outside the law",
        "call": "build the inner function without never_inline",
        "copysign": "write if_else(y < 0, -fabs(x), fabs(x))",
        "erf": "approximate it by a polynomial or a rational function",
        "fmod": "write x - y*floor(x/y) (result has the sign of y)",
        "monitor": "remove it",
        "parameter": "make it an input of the function",
        "printme": "remove it",
        "remainder": "write x - y*floor(x/y + 0.5)",
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
