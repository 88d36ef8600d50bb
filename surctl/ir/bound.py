"""A bound on the operations of a procedure: each loop counts as often as it may run, for all values of its variables.

What is known is evaluated: sizes, arrays to which only constants are assigned, variables of loops that begin at a known
number, and local variables and arguments with such values. So a loop over the rows of a level counts the rows of this
level, and the branches for another kind of level count nothing. Of the branches of an `if`, the most expensive counts,
with what follows it. Four statements say more; none is part of the text of a procedure, or of its C code:

- `assert a <= b` or `b >= a`, where b is known, bounds a in what follows; for a loop from i to j, a is `j - i`, or `j`
  if i is known. If i is not known, `assert 0 <= i` says that its variable has different values from 0 on;
- `seldom(most)` among the conditions of an `if`: a run evaluates the conditions behind it, and enters the branch, at
  most `most` times;
- `once(a, most)`: what follows in the block has another a from 0 to most − 1 each time, until `anew()`, so it counts
  once for each a in the function with `anew()`.

`Procedure.run` checks all of them.
"""

from __future__ import annotations

import ast
import itertools
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache

_VALUES: Mapping[type[ast.AST], Callable[[int, int], int]] = {
    **{ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Lt: operator.lt, ast.LtE: operator.le},
    **{ast.Gt: operator.gt, ast.GtE: operator.ge, ast.Eq: operator.eq, ast.NotEq: operator.ne},
}


@lru_cache(maxsize=32)
def bound(source: str, sizes: tuple[tuple[str, int], ...]) -> int:
    """Return a number of operations that no run of a procedure exceeds, from its source with bounds and its sizes."""
    total = _Bound(ast.parse(source), dict(sizes)).total()
    for each in (operations_in, _stored, _names, _text, _difference, _calls, _matters):
        each.cache_clear()  # they hold the nodes
    return total


@cache
def operations_in(node: ast.AST) -> int:
    """Return the number of operations of an expression or a statement, without those of functions that it calls."""
    if isinstance(node, ast.Subscript):  # the index is whole
        return 0
    own = isinstance(node, ast.BinOp | ast.Compare | ast.AugAssign | ast.UnaryOp)
    root = isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("sqrt", "fabs")
    return own + root + sum(map(operations_in, ast.iter_child_nodes(node)))


def called(node: ast.AST, name: str) -> list[ast.expr] | None:
    """Return the arguments of a call of the function, or None if the node is none."""
    return node.args if isinstance(node, ast.Call) and getattr(node.func, "id", "") == name else None


@dataclass
class _Known:
    """What is known at a statement: values of variables, upper bounds of expressions, which of these are at least 0."""

    values: dict[str, int] = field(default_factory=dict)
    upper: dict[str, int] = field(default_factory=dict)
    whole: set[str] = field(default_factory=set)

    def copy(self) -> _Known:
        return _Known(dict(self.values), dict(self.upper), set(self.whole))

    def forget(self, body: Sequence[ast.AST]) -> None:
        """Forget what depends on variables that the statements assign."""
        for name in frozenset[str]().union(*map(_stored, body)):
            self.values.pop(name, None)
            for text in [text for text in self.upper if name in _names(text)]:
                del self.upper[text]
            self.whole.discard(name)

    def key(self) -> tuple[tuple[str, int], ...]:
        return (*sorted(self.values.items()), ("", 0), *sorted(self.upper.items()))


@cache
def _stored(node: ast.AST) -> frozenset[str]:
    """Return the variables that a statement assigns."""
    variables = (one for one in ast.walk(node) if isinstance(one, ast.Name | ast.Attribute))
    return frozenset(_text(one) for one in variables if isinstance(one.ctx, ast.Store))


@cache
def _names(text: str) -> frozenset[str]:
    return frozenset(re.findall(r"[\w.]+", text))


_text = cache(ast.unparse)
_difference = cache(lambda a, b: ast.BinOp(a, ast.Sub(), b))


class _Bound:
    def __init__(self, tree: ast.Module, sizes: Mapping[str, int]) -> None:
        self.functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
        self.sizes, self.tables = sizes, _tables(tree)
        self.calls: dict[tuple[object, ...], int] = {}
        self.rare: dict[int, int] = {}  # of each branch with `seldom`, in the whole run
        self.shared: dict[int, int] = {}  # of what follows `once`, for each value

    def total(self) -> int:
        """Return the bound for the last function."""
        return self._function(list(self.functions)[-1], _Known()) + sum(self.rare.values())

    def _function(self, name: str, known: _Known) -> int:
        key = (name, known.key())
        if key not in self.calls:
            self.calls[key] = self._block(body := self.functions[name].body, known)
            if any(called(node, "anew") is not None for one in body for node in ast.walk(one)):
                self.calls[key] += sum(self.shared.values())
        return self.calls[key]

    def _block(self, body: Sequence[ast.stmt], known: _Known) -> int:
        total = 0
        for place, node in enumerate(body):
            match node:
                case ast.For():
                    total += self._loop(node, known)
                case ast.If(test=test):
                    return total + self._branches(node, body[place + 1 :], known)
                case ast.Expr(value=call) if (args := called(call, "once")) is not None:
                    self._once(args, body[place + 1 :], known)
                    return total
                case ast.Expr(value=call) if called(call, "anew") is not None:
                    pass
                case ast.Assert(test=test):
                    for one in test.values if isinstance(test, ast.BoolOp) else [test]:
                        self._learn(one, known)
                case _:
                    total += self._expression(node, known)
                    moved = self._moved(node, known)
                    known.forget([node])
                    known.upper |= moved
                    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                        value = self._value(node.value, known)
                        known.values |= {} if value is None else {node.targets[0].id: value}
        return total

    def _moved(self, node: ast.AST, known: _Known) -> dict[str, int]:
        """Return the bounds of differences `a - …` after a statement `a -= b`."""
        if not isinstance(node, ast.AugAssign) or not isinstance(node.op, ast.Sub):
            return {}
        less, name = self._value(node.value, known), _text(node.target)
        return {text: most - less for text, most in known.upper.items() if less and text.startswith(f"{name} - ")}

    def _learn(self, test: ast.expr, known: _Known) -> None:
        match test:
            case ast.Compare(left=less, ops=[ast.LtE()], comparators=[more]):
                pass
            case ast.Compare(left=more, ops=[ast.GtE()], comparators=[less]):
                pass
            case _:
                return
        if isinstance(less, ast.Constant) and less.value == 0:
            known.whole.add(_text(more))
        most = self._upper(more, known)
        if most is not None:
            known.upper[_text(less)] = min(most, known.upper.get(_text(less), most))

    def _branches(self, node: ast.If, rest: Sequence[ast.stmt], known: _Known) -> int:
        tested, most = self._tests(node.test, known)
        test, costs, after = self._value(node.test, known), list[int](), known.copy()
        after.forget([*node.body, *node.orelse])
        follow = self._block(rest, after)
        for part, truth in ((node.body, True), (node.orelse, False)):
            if test is not None and bool(test) is not truth:
                continue
            cost = self._block(part, known.copy())
            if most is not None and truth:
                self._rare(node, most * cost)
                cost = 0
            ends = bool(part) and isinstance(part[-1], ast.Return | ast.Break | ast.Continue)
            costs.append(cost if ends else cost + follow)
        return tested + max(costs)

    def _tests(self, node: ast.expr, known: _Known) -> tuple[int, int | None]:
        """Return the cost of a condition, and how often it is fulfilled at most, if `seldom` says so."""
        total, most = 0, None
        for value in node.values if isinstance(node, ast.BoolOp) else [node]:
            limit = called(value, "seldom")
            if limit is not None:
                most = self._value(limit[0], known)
            elif most is None:
                total += self._expression(value, known)
            else:
                self._rare(value, most * self._expression(value, known))
        return total, most

    def _rare(self, node: ast.AST, cost: int) -> None:
        self.rare[id(node)] = max(self.rare.get(id(node), 0), cost)

    def _once(self, args: Sequence[ast.expr], rest: Sequence[ast.stmt], known: _Known) -> None:
        most = self._value(args[1], known) or 0
        value = self._value(args[0], known)
        for at in range(most) if value is None else [value]:
            inner = known.copy()
            if isinstance(args[0], ast.Name):
                inner.values[args[0].id] = at
            self.shared[at] = max(self.shared.get(at, 0), self._block(rest, inner))

    def _loop(self, node: ast.For, known: _Known) -> int:
        assert isinstance(node.iter, ast.Call) and isinstance(node.target, ast.Name)
        args, name = node.iter.args, node.target.id
        start = 0 if len(args) == 1 else self._value(args[0], known)
        extent = args[0] if len(args) == 1 else _difference(args[1], args[0])
        limits = [self._upper(args[-1], known), self._upper(extent, known)]
        stop = self._upper(args[-2], known) if len(args) > 1 else None
        if start is not None and stop is not None:
            limits.append(stop - start)
        count = max(0, min(limit for limit in limits if limit is not None))
        whole = len(args) > 1 and _text(args[0]) in known.whole
        known.forget([node])
        if count == 0:
            return 0
        first = 0 if whole and start is None and stop is not None else start
        if first is None or not _matters(name, node):
            return count * self._block(node.body, known.copy())
        costs = []
        for at in range(first, first + count if start is not None or stop is None else stop):
            inner = known.copy()
            inner.values[name] = at
            costs.append(self._block(node.body, inner))
        return sum(sorted(costs)[-count:])

    def _expression(self, node: ast.AST, known: _Known) -> int:
        own = [(name, call) for name, call in _calls(node) if name in self.functions]
        return operations_in(node) + sum(self._function(name, self._passed(name, call, known)) for name, call in own)

    def _passed(self, function: str, call: ast.Call, known: _Known) -> _Known:
        """Return what is known of the arguments of a call, and of their differences."""
        names = [arg.arg for arg in self.functions[function].args.args[1:]]
        pairs = dict(zip(names, call.args[1:], strict=True))
        inner = _Known()
        for name, arg in pairs.items():
            value, most = self._value(arg, known), self._upper(arg, known)
            inner.values |= {} if value is None else {name: value}
            if isinstance(arg, ast.BinOp) and isinstance(arg.op, ast.Sub) and (less := self._value(arg.right, known)):
                inner.upper[f"{_text(arg.left)} - {name}"] = less
            inner.upper |= {} if most is None else {name: most}
        for (a, one), (b, other) in itertools.permutations(pairs.items(), 2):
            most = self._upper(_difference(one, other), known)
            inner.upper |= {} if most is None else {f"{a} - {b}": most}
        return inner

    def _upper(self, node: ast.expr, known: _Known) -> int | None:
        match node:
            case ast.BinOp(left=ast.BinOp(left=a, op=ast.Add(), right=part), op=ast.Sub(), right=b):
                if _text(a) == _text(b):
                    return self._upper(part, known)
        value = self._value(node, known)
        return known.upper.get(_text(node)) if value is None else value

    def _value(self, node: ast.expr, known: _Known) -> int | None:
        """Return the value of a whole expression or a condition, or None if it is not known."""
        match node:
            case ast.Constant(value=value) if isinstance(value, int):
                return int(value)
            case ast.Name(id=name):
                return known.values.get(name)
            case ast.Attribute(attr=name):
                return self.sizes.get(name)
            case ast.Subscript(value=ast.Attribute(attr=name), slice=at) if name in self.tables:
                place = self._value(at, known)
                return None if place is None else self.tables[name].get(place)
            case ast.BinOp(left=left, op=op, right=right) | ast.Compare(left=left, ops=[op], comparators=[right]):
                a, b = self._value(left, known), self._value(right, known)
                return None if a is None or b is None or type(op) not in _VALUES else int(_VALUES[type(op)](a, b))
            case ast.BoolOp(op=op, values=values):
                truths = [self._value(value, known) for value in values]
                decided = isinstance(op, ast.Or)
                if any(truth is not None and bool(truth) is decided for truth in truths):
                    return int(decided)
                return None if None in truths else int(not decided)
        return None


def _tables(tree: ast.AST) -> dict[str, dict[int, int]]:
    """Return the entries of the arrays to which only constants are assigned, each entry once."""
    tables: dict[str, dict[int, int]] = {}
    wrong: set[str] = set()
    for name, at, value in _stores(tree):
        table = tables.setdefault(name, {})
        if at is None or value is None or at in table:
            wrong.add(name)
        else:
            table[at] = value
    return {name: table for name, table in tables.items() if name not in wrong}


def _stores(tree: ast.AST) -> Iterator[tuple[str, int | None, int | None]]:
    """Yield name, index and value of each entry of an array that is assigned; None for what is not a constant."""
    for node in ast.walk(tree):
        match node:
            case ast.Assign(targets=[ast.Subscript(value=ast.Attribute(attr=name), slice=at)], value=value):
                yield name, _constant(at), _constant(value)
            case ast.AugAssign(target=ast.Subscript(value=ast.Attribute(attr=name))):
                yield name, None, None


def _constant(node: ast.expr) -> int | None:
    return node.value if isinstance(node, ast.Constant) and type(node.value) is int else None


@cache
def _calls(node: ast.AST) -> list[tuple[str, ast.Call]]:
    return [
        (call.func.id, call) for call in ast.walk(node) if isinstance(call, ast.Call) if isinstance(call.func, ast.Name)
    ]


@cache
def _matters(name: str, loop: ast.For) -> bool:
    """Return whether the cost of the statements in a loop may depend on a variable."""
    for node in (inner for statement in loop.body for inner in ast.walk(statement)):
        parts: Sequence[ast.AST] = ()
        match node:
            case ast.Call(func=ast.Name(id=called), args=args) if called not in ("fabs", "sqrt"):
                parts = args
            case ast.If(test=test) | ast.Assert(test=test):
                parts = (test,)
            case ast.Assign(targets=[ast.Name()], value=value):
                parts = (value,)
        if any(isinstance(inner, ast.Name) and inner.id == name for part in parts for inner in ast.walk(part)):
            return True
    return False
