"""Evaluator of the procedures in an instruction list: statements on arrays, with bounded loops.

A procedure is written in a small part of Python. Its text comes from a bundle, so only the constructs below are
accepted before anything is executed: there is no name, attribute or call that the text does not define itself.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.patience import go_on

__all__ = ["evaluator"]

Array = NDArray[np.float64]

_LARGEST = 1 << 60
_UNTIMED = 4096  # most iterations of a loop without a look at the clock
_KNOWN = {"range": 1, "within": 3, "back": 3, "sqrt": 1, "fabs": 1}  # functions, and how many operands they take
_NODES = (
    *(ast.Module, ast.FunctionDef, ast.arguments, ast.arg, ast.Assign, ast.AugAssign, ast.If, ast.For, ast.Return),
    *(ast.Expr, ast.Break, ast.Continue, ast.Pass, ast.Constant, ast.Name, ast.Attribute, ast.Subscript, ast.BinOp),
    *(ast.UnaryOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.Call, ast.Load, ast.Store, ast.Add, ast.Sub, ast.Mult),
    *(ast.Div, ast.USub, ast.Not, ast.And, ast.Or, ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq),
)


class _Memory:
    """The arrays and variables of one evaluation."""

    def __init__(self, space: Mapping[str, Any]) -> None:
        self.__dict__.update(space)


def evaluator(
    source: str,
    sizes: Mapping[str, int],
    memory: Sequence[tuple[str, str, int]],
    ports: tuple[Sequence[tuple[str, int]], Sequence[tuple[str, int]]],
) -> tuple[Callable[[Sequence[Array]], list[Array]], int]:
    """Return the function that evaluates a procedure at n points, and how many operations it takes at most.

    Raises:
        ValueError: the source has a construct that is not one of a procedure.
    """
    inputs, outputs = ports
    arrays = {*(name for name, _, size in memory if size), *(name for name, _ in (*inputs, *outputs))}
    fields = {*sizes, *arrays, *(name for name, _, _ in memory)}
    if any(not name.isidentifier() or name.startswith("_") for name in fields):
        raise ValueError("a procedure with an array of a wrong name")
    tree = ast.parse(source)
    entry, operations = _checked(tree, fields, arrays, sizes)
    scope: dict[str, Any] = {"range": _range, "within": _within, "back": _back, "sqrt": _root, "fabs": abs}
    scope |= {"_divided": _divided, "_times": _times, "_before": _before, "__builtins__": {}}
    exec(compile(ast.fix_missing_locations(_Executable().visit(tree)), "procedure", "exec"), scope)

    def run(vectors: Sequence[Array]) -> list[Array]:
        points = max([vector.shape[1] for vector in vectors], default=1)
        wide = [np.broadcast_to(vector, (vector.shape[0], points)) for vector in vectors]
        results = [np.empty((size, points)) for _, size in outputs]
        for point in range(points):
            go_on()
            space: dict[str, Any] = {name: [math.nan if kind == "real" else 0] * size for name, kind, size in memory}
            space |= {name: 0 for name, _, size in memory if not size}
            space |= {name: vector[:, point].tolist() for (name, _), vector in zip(inputs, wide, strict=True)}
            space |= {name: [math.nan] * size for name, size in outputs}
            state = _Memory({**sizes, **space})
            scope[entry](state)
            for (name, _), result in zip(outputs, results, strict=True):
                result[:, point] = getattr(state, name)
        return results

    return run, operations


def _checked(tree: ast.Module, fields: set[str], arrays: set[str], sizes: Mapping[str, int]) -> tuple[str, int]:
    """Return the name of the last function and its number of operations; ValueError if a construct is not allowed."""
    costs: dict[str, int] = {}
    entries = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Subscript)}
    for node in ast.walk(tree):
        if not isinstance(node, _NODES):
            raise ValueError(f"a procedure with a construct {type(node).__name__}")
        if isinstance(node, ast.Attribute) and not (_is_name(node.value, "s") and node.attr in fields):
            raise ValueError(f"a procedure with an attribute {node.attr}")
        if isinstance(node, ast.Subscript) and not isinstance(node.value, ast.Attribute):
            raise ValueError("a procedure with an entry of something else than an array")
        if isinstance(node, ast.Attribute):  # sums and products of whole arrays would be those of Python's lists
            if (node.attr in arrays) != (id(node) in entries):
                raise ValueError(f"a procedure with {node.attr} as a whole, or with an entry of a number")
            if node.attr in sizes and isinstance(node.ctx, ast.Store):
                raise ValueError(f"a procedure that changes the size {node.attr}")
        if isinstance(node, ast.Name | ast.arg):
            name, bound = (node.id, _stored(node)) if isinstance(node, ast.Name) else (node.arg, True)
            if name.startswith("_") or (bound and name in _KNOWN):
                raise ValueError(f"a procedure with a name {name}")
        if isinstance(node, ast.AugAssign) and not isinstance(node.op, ast.Add | ast.Sub):
            raise ValueError("a procedure with a product in place")
        if isinstance(node, ast.Constant) and type(node.value) not in (int, float, type(None)):
            raise ValueError("a procedure with a constant that is no number")
    for function in tree.body:
        if not isinstance(function, ast.FunctionDef) or function.decorator_list or function.name in (*costs, *_KNOWN):
            raise ValueError("a procedure with a statement outside its functions")
        if function.name.startswith("_") or function.args.defaults or not function.args.args:
            raise ValueError(f"a procedure with a function {function.name}")
        costs[function.name] = _cost(function.body, sizes, costs)
    if not costs:
        raise ValueError("a procedure without a function")
    return list(costs.items())[-1]


def _is_name(node: ast.AST, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name


def _stored(node: ast.Name) -> bool:
    return isinstance(node.ctx, ast.Store)


def _cost(body: Sequence[ast.AST], sizes: Mapping[str, int], costs: Mapping[str, int]) -> int:
    total = 0
    for node in body:
        if isinstance(node, ast.FunctionDef):
            raise ValueError("a procedure with a function inside another")
        if isinstance(node, ast.For):
            call = node.iter
            if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name) or node.orelse:
                raise ValueError("a procedure with a loop over something else than numbers")
            if call.func.id not in ("range", "within", "back"):
                raise ValueError("a procedure with a loop over something else than numbers")
            total += max(0, _constant(call.args[-1], sizes)) * (1 + _cost(node.body, sizes, costs))
            total += _cost(call.args, sizes, costs)
            continue
        if isinstance(node, ast.Call):
            name = node.func.id if isinstance(node.func, ast.Name) else ""
            if name not in costs and len(node.args) != _KNOWN.get(name):
                raise ValueError(f"a procedure with a call of {name or 'something'}")
            total += costs.get(name, 0)
        total += 1 + _cost(list(ast.iter_child_nodes(node)), sizes, costs)
    return total


def _constant(node: ast.AST, sizes: Mapping[str, int]) -> int:
    if isinstance(node, ast.Constant) and type(node.value) is int:
        return node.value
    if isinstance(node, ast.Attribute) and node.attr in sizes:
        return sizes[node.attr]
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub):
        left, right = _constant(node.left, sizes), _constant(node.right, sizes)
        return left + right if isinstance(node.op, ast.Add) else left - right
    raise ValueError("a procedure with a loop without a bound")


class _Executable(ast.NodeTransformer):
    """Drops annotations, divides as IEEE 754 defines it, where Python raises an error, and refuses negative indices."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        node.returns = None
        for arg in node.args.args:
            arg.annotation = None
        self.generic_visit(node)
        return node

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        self.generic_visit(node)
        if isinstance(node.op, ast.Div | ast.Mult):
            name = "_divided" if isinstance(node.op, ast.Div) else "_times"
            return ast.Call(ast.Name(name, ast.Load()), [node.left, node.right], [])
        return node

    def visit_Subscript(self, node: ast.Subscript) -> ast.Subscript:
        # a list of Python has an entry -1; an index that is too large is an error of its own
        self.generic_visit(node)
        if not isinstance(node.slice, ast.Constant):
            index = ast.NamedExpr(ast.Name("_index", ast.Store()), node.slice)
            inside = ast.Compare(index, [ast.GtE()], [ast.Constant(0)])
            node.slice = ast.IfExp(
                inside, ast.Name("_index", ast.Load()), ast.Call(ast.Name("_before", ast.Load()), [], [])
            )
        return node


def _before() -> int:
    raise ValueError("a procedure with a negative index of an array")


def _divided(a: float, b: float) -> float:
    return a / b if b != 0.0 else a * math.copysign(1.0, b) * math.inf


def _times(a: Any, b: Any) -> Any:
    product = a * b
    if type(product) is int and abs(product) > _LARGEST:  # whole numbers of Python grow without a limit
        raise ValueError("a procedure with a whole number that is too large")
    return product


def _root(x: float) -> float:
    return math.sqrt(x) if x >= 0.0 else math.nan


def _range(stop: int) -> Iterable[int]:
    return _timed(range(stop))


def _within(start: int, stop: int, most: int) -> Iterable[int]:
    return _timed(_bounded(start, stop, most))


def _back(start: int, stop: int, most: int) -> Iterable[int]:
    return _timed(_bounded(start, stop, most)[::-1])


def _bounded(start: int, stop: int, most: int) -> range:
    if stop - start > most:
        raise ValueError("a loop of a procedure has more iterations than declared")
    return range(start, stop)


def _timed(numbers: range) -> Iterable[int]:
    go_on()
    return numbers if len(numbers) <= _UNTIMED else _parts(numbers)


def _parts(numbers: range) -> Iterator[int]:
    for first in range(0, len(numbers), _UNTIMED):
        go_on()
        yield from numbers[first : first + _UNTIMED]
