"""Procedures: algorithms with many branches, as statements on arrays of fixed size with bounded loops.

A routine computes every branch and selects; an algorithm that mostly skips its work (an active-set solver, a pivoted
elimination) would cost far more in that form. A procedure is written as functions in a small part of Python, which is
both its definition and what `replay` executes. Its C text performs the same operations in the same order.

All arrays are declared with their sizes and live in one memory, the first argument `s` of each function. The last
function is the entry: it reads the inputs and writes the outputs, which are arrays of `s` as well. The language has:

- numbers: real (float), whole (int); local variables have the type of their first value;
- `s.array[i]`, `s.variable`, and `s.size`, which is a constant;
- `+ - *`, `/` on reals, comparisons, `and or not`, `a if c else b`, `sqrt`, `fabs`, and calls of earlier functions;
- assignments, `if`, `return`, `break`, `continue`, `pass`;
- `for i in range(stop)` with a constant, `for i in within(start, stop, most)`, which is `range(start, stop)` with at
  most `most` (a constant) iterations, and `for i in back(start, stop, most)`, the same in reverse order;
- what bounds the number of operations more closely, see module `bound`.

There is no recursion and no unbounded loop, so the number of operations is bounded. A procedure has to write an entry
of its memory before it reads it, and must stay inside its arrays for any input, NaN included: `replay` raises an error
if it does not, but C does not notice.
"""

from __future__ import annotations

import ast
import hashlib
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache
from types import FunctionType
from typing import Any, NoReturn, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir.bound import VALUES, bound, called

# Numbers with derivatives, with which a procedure is executed to differentiate it (forward mode)


_Slope: TypeAlias = NDArray[np.float64]


def _parts(number: Dual | float) -> tuple[float, _Slope | float]:
    return (number.value, number.slope) if isinstance(number, Dual) else (float(number), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Dual:
    """A real with its derivatives (d,); comparisons are those of the values, so branches have no derivative."""

    value: float
    slope: _Slope

    def __add__(self, other: Dual | float) -> Dual:
        value, slope = _parts(other)
        return Dual(self.value + value, self.slope + slope)

    def __sub__(self, other: Dual | float) -> Dual:
        value, slope = _parts(other)
        return Dual(self.value - value, self.slope - slope)

    def __rsub__(self, other: float) -> Dual:
        return Dual(other - self.value, -self.slope)

    def __mul__(self, other: Dual | float) -> Dual:
        value, slope = _parts(other)
        return Dual(self.value * value, self.slope * value + self.value * slope)

    __radd__, __rmul__ = __add__, __mul__

    def __truediv__(self, other: Dual | float) -> Dual:
        value, slope = _parts(other)
        ratio = float(np.float64(self.value) / np.float64(value))
        return Dual(ratio, (self.slope - ratio * slope) / np.float64(value))

    def __rtruediv__(self, other: float) -> Dual:
        return Dual(other, 0.0 * self.slope) / self

    def __neg__(self) -> Dual:
        return Dual(-self.value, -self.slope)

    def __abs__(self) -> Dual:
        return -self if self.value < 0.0 else self

    def __lt__(self, other: Dual | float) -> bool:
        return self.value < _parts(other)[0]

    def __le__(self, other: Dual | float) -> bool:
        return self.value <= _parts(other)[0]

    def __gt__(self, other: Dual | float) -> bool:
        return self.value > _parts(other)[0]

    def __ge__(self, other: Dual | float) -> bool:
        return self.value >= _parts(other)[0]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Dual | float | int) and self.value == _parts(other)[0]

    __hash__: Any = None

    def root(self) -> Dual:
        """Return the square root."""
        root = math.sqrt(self.value) if self.value >= 0.0 else math.nan
        return Dual(root, 0.5 * self.slope / np.float64(root))


def within(start: int, stop: int, most: int) -> range:
    """Return range(start, stop); an error if it has more than `most` numbers."""
    if stop - start > most:
        raise IndexError(f"a loop has {stop - start} iterations, at most {most} were declared")
    return range(start, stop)


def back(start: int, stop: int, most: int) -> range:
    """Return the numbers of `within` in reverse order."""
    return within(start, stop, most)[::-1]


def seldom(most: int, value: int = 0) -> bool:
    """Return True, see module `bound`."""
    return most >= 0


def once(value: int, most: int) -> None:
    """Do nothing, see module `bound`."""


def anew() -> None:
    """Do nothing, see module `bound`."""


def sqrt(x: float) -> float:
    """Return √x in the precision of x; NaN for x < 0."""
    if type(x) is float:
        return math.sqrt(x) if x >= 0.0 else math.nan
    number: Any = x
    root: Any = number.root() if isinstance(number, Dual) else np.sqrt(number)
    return root  # type: ignore[no-any-return]


def fabs(x: float) -> float:
    """Return |x| in the precision of x."""
    return abs(x)


_FUNCTIONS: Mapping[str, Callable[[float], float]] = {"sqrt": sqrt, "fabs": fabs}
_RANGES = {"range": 1, "within": 3, "back": 3}
BINARY: Mapping[type[ast.AST], str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
COMPARED: Mapping[type[ast.AST], str] = {
    **{ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="},
}
"""Signs of the operations and of the comparisons of the language, which are those of C."""


@dataclass(frozen=True)
class Procedure:
    """An algorithm on flat vectors, see the module docstring.

    Attributes:
        name: C identifier.
        inputs, outputs: (name, number of entries) of each input and output array, all real.
        sizes: (name, value) of each constant.
        memory: (name, "real" or "whole", number of entries) of each array, and of each variable, whose number is 0.
        source: the functions, as `ast.unparse` writes them; the last one is the entry.
        bounded: the same with `assert` and `seldom`, see module `bound`.
    """

    name: str
    inputs: tuple[tuple[str, int], ...]
    outputs: tuple[tuple[str, int], ...]
    sizes: tuple[tuple[str, int], ...]
    memory: tuple[tuple[str, str, int], ...]
    source: str
    bounded: str = field(default="", compare=False, repr=False)

    @classmethod
    def of(
        cls,
        name: str,
        functions: Sequence[Callable[..., Any] | str],
        *,
        inputs: Sequence[tuple[str, int]],
        outputs: Sequence[tuple[str, int]],
        sizes: Mapping[str, int],
        reals: Mapping[str, int],
        wholes: Mapping[str, int],
    ) -> Procedure:
        """Return the procedure that Python functions define; `reals` and `wholes` are the memory, 0 for a variable."""
        texts = [function if isinstance(function, str) else source_of(function) for function in functions]
        memory = [(key, "real", size) for key, size in reals.items()]
        memory += [(key, "whole", size) for key, size in wholes.items()]
        source, bounded = ("\n".join(part) for part in (map(_unbounded, texts), texts))
        return cls(name, tuple(inputs), tuple(outputs), tuple(sizes.items()), tuple(memory), source, bounded)

    def __post_init__(self) -> None:
        """Raise InputError for a source that a back end could not run."""
        _ = self.functions

    def __reduce__(self) -> tuple[type[Procedure], tuple[Any, ...]]:
        """Pickle the fields alone: a copy has nodes, and so types by `id`, of its own."""
        return Procedure, tuple(getattr(self, each.name) for each in fields(self))

    @cached_property
    def functions(self) -> tuple[Typed, ...]:
        """Return the functions with the types of their variables, in the order of the source."""
        return tuple(_typed(self))

    @cached_property
    def operations(self) -> int:
        """Return a number of operations that no run exceeds, see module `bound`."""
        return bound(self.bounded or self.source, self.sizes)

    @property
    def libm(self) -> frozenset[str]:
        """Return the names of the operations that call libm: none."""
        return frozenset()

    @property
    def stored(self) -> int:
        """Return the number of entries of all arrays and variables of the memory."""
        return sum(max(size, 1) for _, _, size in self.memory)

    def text(self) -> str:
        """Return the procedure as text; procedures with equal texts are equal, on any machine."""
        lines = [f"procedure {self.name}"]
        lines += [f"in {name} {size}" for name, size in self.inputs]
        lines += [f"out {name} {size}" for name, size in self.outputs]
        lines += [f"size {name} {value}" for name, value in self.sizes]
        lines += [f"{kind} {name} {size}" for name, kind, size in self.memory]
        return "\n".join([*lines, self.source, ""])

    def digest(self) -> str:
        """Return the SHA-256 of `text`, in hexadecimal."""
        return self._digest

    @cached_property
    def _digest(self) -> str:
        return hashlib.sha256(self.text().encode()).hexdigest()

    def run(self, arrays: Sequence[Sequence[Any]], memory: Mapping[str, Any] | None = None) -> list[list[Any]]:
        """Return the outputs for one list of reals for each input, executed in Python, in this memory or a new one."""
        state = _Memory({**dict(self.sizes), **(self._space(arrays) if memory is None else memory)})
        self._entry(state)
        return [getattr(state, name) for name, _ in self.outputs]

    def _space(self, arrays: Sequence[Sequence[Any]]) -> dict[str, Any]:
        space: dict[str, Any] = {}
        for name, kind, size in self.memory:
            unset: float | int = math.nan if kind == "real" else 1 << 60
            space[name] = [unset] * size if size else 0
        space |= {name: list(array) for (name, _), array in zip(self.inputs, arrays, strict=True)}
        return space | {name: [math.nan] * size for name, size in self.outputs}

    @cached_property
    def _entry(self) -> Callable[[_Memory], None]:
        scope: dict[str, Any] = {
            "range": range,
            "within": within,
            "back": back,
            "_divided": _divided,
            **_CHECKED,
            **_FUNCTIONS,
        }
        tree = ast.fix_missing_locations(_Executable().visit(ast.parse(self.bounded or self.source)))
        scope["__builtins__"] = {}
        exec(compile(tree, self.name, "exec"), scope)  # `_typed` admits only the language above
        entry: Callable[[_Memory], None] = scope[self.functions[-1].name]
        return entry


@lru_cache(maxsize=512)  # many procedures have some functions in common
def _unbounded(text: str) -> str:
    """Return functions without the statements of module `bound`, as `Procedure.source` holds them."""
    return "\n".join(map(ast.unparse, _Unbounded().visit(ast.parse(text)).body))


class _Unbounded(ast.NodeTransformer):
    """Drops the statements of module `bound`, which are not part of the text of a procedure."""

    def visit_Assert(self, node: ast.Assert) -> None:
        return None

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        return node if called(node.value, "once") is called(node.value, "anew") else None

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        self.generic_visit(node)
        values = [value for value in node.values if called(value, "seldom") is None]
        return values[0] if len(values) == 1 else ast.BoolOp(node.op, values)


class _Executable(ast.NodeTransformer):
    """Drops annotations, and replaces divisions and the statements of module `bound` by calls that execute them."""

    def visit_Call(self, node: ast.Call) -> ast.expr:
        self.generic_visit(node)
        name = getattr(node.func, "id", "")
        if name not in ("seldom", "once", "anew"):
            return node
        place = ast.Constant(f"{node.lineno}:{node.col_offset}")
        return ast.Call(ast.Name(f"_{name}", ast.Load()), [ast.Name("s", ast.Load()), place, *node.args], [])

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        node.returns = None
        for arg in node.args.args:
            arg.annotation = None
        self.generic_visit(node)
        return node

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        self.generic_visit(node)
        if not isinstance(node.op, ast.Div):
            return node
        return ast.Call(ast.Name("_divided", ast.Load()), [node.left, node.right], [])


def _divided(a: Any, b: Any) -> Any:
    # as IEEE 754 defines it: Python raises an error for a divisor of 0
    if b != 0.0 or type(b) is not float or isinstance(a, Dual):
        return a / b
    return float(np.float64(a) / np.float64(b))


class _Memory:
    def __init__(self, space: Mapping[str, Any]) -> None:
        self.__dict__.update(space)
        self.entered: Counter[tuple[str, int]] = Counter()
        self.values: set[int] = set()


def _seldom(s: _Memory, place: str, most: int, value: int = 0) -> bool:
    s.entered[place, value] += 1
    if s.entered[place, value] > most:
        raise IndexError(f"a branch is entered {s.entered[place, value]} times, at most {most} were declared")
    return True


def _once(s: _Memory, place: str, value: int, most: int) -> None:
    if value in s.values or not 0 <= value < most:
        raise IndexError(f"a value comes twice, or is not below {most}: {value}")
    s.values.add(value)


def _anew(s: _Memory, place: str) -> None:
    s.values.clear()


_CHECKED = {"_seldom": _seldom, "_once": _once, "_anew": _anew}


def source_of(function: Callable[..., Any]) -> str:
    """Return the source of a function in the language of procedures, as `Procedure.source` holds it."""
    import inspect

    assert isinstance(function, FunctionType)
    node = ast.parse(inspect.getsource(function)).body[0]
    assert isinstance(node, ast.FunctionDef)
    first = node.body[0]
    if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
        del node.body[0]
    node.args.args[0].annotation = None
    return ast.unparse(node)


@dataclass(frozen=True)
class Typed:
    """A function of a procedure.

    Attributes:
        node: its definition.
        arguments: (name, type) of each argument after `s`; a type is "real" or "whole".
        result: type of the returned value, or "" if there is none.
        local: type of each local variable that is not the variable of a loop.
        types: type of each expression, by the `id` of its node.
    """

    node: ast.FunctionDef
    arguments: tuple[tuple[str, str], ...]
    result: str
    local: Mapping[str, str]
    types: Mapping[int, str]

    @property
    def name(self) -> str:
        """Return the name of the function."""
        return self.node.name


def _constant(node: ast.expr, sizes: Mapping[str, int]) -> int:
    """Return the value of a constant whole number: a literal, a size, or a sum, difference or product of such."""
    if isinstance(node, ast.Constant) and type(node.value) is int:
        return node.value
    if isinstance(node, ast.Attribute) and node.attr in sizes:
        return sizes[node.attr]
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub | ast.Mult):
        return VALUES[type(node.op)](_constant(node.left, sizes), _constant(node.right, sizes))
    raise InputError("is not a constant", value=ast.unparse(node))


def _typed(procedure: Procedure) -> Iterator[Typed]:
    try:
        tree = ast.parse(procedure.source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise InputError("has a source that is not Python", key=procedure.name) from None
    names = [name for group in (procedure.inputs, procedure.outputs, procedure.sizes) for name, _ in group]
    names += [name for name, _, _ in procedure.memory]
    bad = [name for name in names if not name.isidentifier() or name.startswith("_") or names.count(name) > 1]
    if bad or any(kind not in ("real", "whole") for _, kind, _ in procedure.memory):
        raise InputError("has memory with a wrong name or type", key=procedure.name, value=bad)
    known: dict[str, Typed] = {}
    for node in tree.body:
        if not isinstance(node, ast.FunctionDef):
            raise InputError("has a statement outside a function", key=procedure.name)
        function = _Check(procedure, known, node).function()
        known[node.name] = function
        yield function
    if not known or ast.unparse(tree).replace("\n\n\n", "\n").replace("\n\n", "\n") != procedure.source:
        raise InputError("has a source that is not written as `ast.unparse` writes it", key=procedure.name)


class _Check:
    """Checks one function and finds its types."""

    def __init__(self, procedure: Procedure, known: Mapping[str, Typed], node: ast.FunctionDef) -> None:
        self.procedure, self.known, self.node = procedure, known, node
        self.sizes = dict(procedure.sizes)
        self.fields = {name: (kind, size > 0) for name, kind, size in procedure.memory}
        self.fields |= {name: ("real", True) for name, _ in (*procedure.inputs, *procedure.outputs)}
        self.fields |= dict.fromkeys(self.sizes, ("whole", False))
        self.constant = {*self.sizes, *(name for name, _ in procedure.inputs)}
        self.local: dict[str, str] = {}
        self.turns: dict[str, int] = {}
        self.types: dict[int, str] = {}
        self.result = ""

    def wrong(self, node: ast.AST, problem: str = "is not in the language of procedures") -> NoReturn:
        key = f"{self.procedure.name}.{self.node.name}"
        raise InputError(problem, key=key, value=ast.unparse(node).split("\n")[0])

    def function(self) -> Typed:
        node, args = self.node, self.node.args
        plain = not (args.posonlyargs or args.kwonlyargs or args.vararg or args.kwarg or args.defaults)
        if not plain or node.decorator_list or not args.args or args.args[0].arg != "s" or node.name in self.known:
            self.wrong(node)
        arguments = [(arg.arg, self._annotated(arg.annotation)) for arg in args.args[1:]]
        self.local = dict(arguments)
        self.result = "" if _is_none(node.returns) else self._annotated(node.returns)
        self._block(node.body)
        for name, _ in arguments:
            del self.local[name]
        return Typed(node, tuple(arguments), self.result, self.local, self.types)

    def _annotated(self, node: ast.expr | None) -> str:
        kind = {"int": "whole", "bool": "whole", "float": "real"}.get(getattr(node, "id", ""))
        return kind if kind is not None else self.wrong(self.node, "needs int or float for each argument and result")

    def _block(self, body: Sequence[ast.stmt]) -> None:
        for statement in body:
            self._statement(statement)

    def _statement(self, node: ast.stmt) -> None:
        match node:
            case ast.Assign(targets=[target], value=value):
                self._store(target, self._type(value))
            case ast.AugAssign(target=target, op=ast.Add() | ast.Sub() | ast.Mult(), value=value):
                self._type(target)
                self._store(target, self._type(value))
            case ast.If(test=test, body=body, orelse=other):
                self._type(test)
                self._block(body)
                self._block(other)
            case ast.For(target=ast.Name(id=name), iter=ast.Call() as call, body=body, orelse=[]):
                self._loop(name, call, body)
            case ast.Return(value=None) if not self.result:
                pass
            case ast.Return(value=ast.expr() as value) if self.result:
                self._type(value)
            case ast.Expr(value=ast.Call(func=ast.Name(id=name)) as call) if name in self.known:
                self._type(call)
            case ast.Break() | ast.Continue() if self.turns:
                pass
            case ast.Pass():
                pass
            case _:
                self.wrong(node)

    def _loop(self, name: str, call: ast.Call, body: Sequence[ast.stmt]) -> None:
        kind = call.func.id if isinstance(call.func, ast.Name) else ""
        if _RANGES.get(kind) != len(call.args) or call.keywords or name in (*self.local, *self.turns) or name[0] == "_":
            self.wrong(call)
        if _constant(call.args[-1], self.sizes) < 0 or any(self._type(arg) != "whole" for arg in call.args):
            self.wrong(call)
        self.turns[name] = 1
        self._block(body)
        del self.turns[name]

    def _store(self, target: ast.expr, kind: str) -> None:
        match target:
            case ast.Name(id=name) if name not in self.turns and name != "s" and not name.startswith("_"):
                own = self.local.setdefault(name, kind)
            case ast.Attribute(value=ast.Name(id="s"), attr=name) if name in self.fields and name not in self.constant:
                own, whole = self.fields[name]
                if whole:
                    self.wrong(target)
            case ast.Subscript(value=ast.Attribute(attr=name)) if name not in self.constant:
                own = self._type(target)
            case _:
                self.wrong(target, "cannot be assigned")
        if own == "whole" and kind == "real":
            self.wrong(target, "is whole, and gets a real value")
        self.types[id(target)] = own

    def _type(self, node: ast.expr) -> str:
        kind = self.types[id(node)] = self._kind(node)
        return kind

    def _kind(self, node: ast.expr) -> str:
        match node:
            case ast.Constant(value=value) if type(value) in (int, float, bool):
                return "real" if type(value) is float else "whole"
            case ast.Name(id=name) if name in self.local:
                return self.local[name]
            case ast.Name(id=name) if name in self.turns:
                return "whole"
            case ast.Attribute(value=ast.Name(id="s"), attr=name) if name in self.fields and not self.fields[name][1]:
                return self.fields[name][0]
            case ast.Subscript(value=ast.Attribute(value=ast.Name(id="s"), attr=name), slice=at) if (
                name in self.fields and self.fields[name][1] and self._type(at) == "whole"
            ):
                return self.fields[name][0]
            case ast.BinOp(left=left, op=op, right=right) if type(op) in BINARY:
                kinds = {self._type(left), self._type(right)}
                if "real" not in kinds and isinstance(op, ast.Div):
                    self.wrong(node)
                return "real" if "real" in kinds else "whole"
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return self._type(operand)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                self._type(operand)
                return "whole"
            case ast.BoolOp(values=values):
                for part in values:
                    self._type(part)
                return "whole"
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in COMPARED:
                self._type(left)
                self._type(right)
                return "whole"
            case ast.IfExp(test=test, body=body, orelse=other):
                self._type(test)
                kinds = {self._type(body), self._type(other)}
                return "real" if "real" in kinds else "whole"
            case ast.Call(func=ast.Name(id=name), args=[arg], keywords=[]) if name in _FUNCTIONS:
                self._type(arg)
                return "real"
            case ast.Call(func=ast.Name(id=name), args=[ast.Name(id="s"), *args], keywords=[]) if name in self.known:
                expected = [kind for _, kind in self.known[name].arguments]
                if len(args) != len(expected) or any(
                    self._type(arg) == "real" and kind == "whole" for arg, kind in zip(args, expected, strict=True)
                ):
                    self.wrong(node)
                return self.known[name].result or "none"
        return self.wrong(node)


def _is_none(node: ast.expr | None) -> bool:
    return node is None or (isinstance(node, ast.Constant) and node.value is None)
