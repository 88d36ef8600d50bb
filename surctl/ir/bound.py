"""A bound on the operations of a procedure: each loop counts as often as it may run, for all values of its variables.

What is known is evaluated: sizes, arrays to which only constants are assigned, variables of loops that begin at a known
number, and local variables and arguments with such values. So a loop over the rows of a level counts the rows of this
level, and the branches for another kind of level count nothing. Of the branches of an `if`, the most expensive counts,
with what follows it. Four statements say more; none is part of the text of a procedure, or of its C code:

- `assert a <= b` or `b >= a`, where one of them is known, bounds the other in what follows; for a loop from i to j, a
  is `j - i`, or `j` if i is known. If i is not known, `assert i >= 0` says that its variable has different values, from
  0 on. `assert a in range(b)` makes cases, of which the most expensive counts, `assert a == b` gives a value, `or` of
  conditions bounds a if no other one can hold, and cases that contradict an `assert` do not count;
- `seldom(most)` among the conditions of an `if`: a run evaluates the conditions behind it, and enters the branch, at
  most `most` times; with `seldom(most, a)`, at most as often for each a, which must be known;
- `once(a, most)`: what follows in the block has another a from 0 to most − 1 each time, until `anew()`, so it counts
  once for each a in the function with `anew()`.

A procedure that counts its operations in `s.spent` (`spending`) can end early: where a run does not enter the branch of
`if s.spent > s.budget`, it has executed at most `budget` operations. Counting and checks cost nothing here.

After `x = f(…)`, paths of f that end with different results are different cases, each with the cost and the assignments
of its own path.

`Procedure.run` checks all of them.
"""

from __future__ import annotations

import ast
import itertools
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from functools import cache, lru_cache, reduce
from typing import TypeAlias

VALUES: Mapping[type[ast.AST], Callable[[int, int], int]] = {
    **{ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Lt: operator.lt, ast.LtE: operator.le},
    **{ast.Gt: operator.gt, ast.GtE: operator.ge, ast.Eq: operator.eq, ast.NotEq: operator.ne},
}
"""Operations on whole numbers whose value a bound needs."""


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
    counter = getattr(node, "target", getattr(node, "left", None))
    if isinstance(counter, ast.Attribute) and counter.attr == "spent":
        return 0
    own = isinstance(node, ast.BinOp | ast.Compare | ast.AugAssign | ast.UnaryOp)
    root = isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("sqrt", "fabs")
    return own + root + sum(map(operations_in, ast.iter_child_nodes(node)))


def spending(source: str) -> str:
    """Return the source of a procedure that adds its operations to `s.spent`, before it executes them."""
    tree = ast.parse(source)
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    for function in functions:
        function.body = _spending(function.body)
    functions[-1].body.insert(0, ast.parse("s.spent = 0").body[0])
    return "\n".join(map(ast.unparse, map(ast.fix_missing_locations, tree.body)))


def _spending(body: Sequence[ast.stmt]) -> list[ast.stmt]:
    """Add the operations of each group of statements that are executed together, before the group."""
    lines, group, cost = list[ast.stmt](), list[ast.stmt](), 0
    for node in body:
        group.append(node)
        if isinstance(node, ast.If | ast.For):
            cost += operations_in(node.test) if isinstance(node, ast.If) else 0
            lines += [*_spent(cost), *group]
            group, cost = [], 0
            node.body, node.orelse = _spending(node.body), _spending(node.orelse)
        elif not isinstance(node, ast.Assert):
            cost += operations_in(node)
    return [*lines, *_spent(cost), *group]


def _spent(cost: int) -> list[ast.stmt]:
    return ast.parse(f"s.spent += {cost}").body if cost else []


def called(node: ast.AST, name: str) -> list[ast.expr] | None:
    """Return the arguments of a call of the function, or None if the node is none."""
    return node.args if isinstance(node, ast.Call) and getattr(node.func, "id", "") == name else None


@dataclass
class _Known:
    """What is known at a statement: values of variables, and upper and lower bounds of expressions."""

    values: dict[str, int] = field(default_factory=dict)
    upper: dict[str, int] = field(default_factory=dict)
    lower: dict[str, int] = field(default_factory=dict)

    def copy(self) -> _Known:
        return _Known(dict(self.values), dict(self.upper), dict(self.lower))

    def parts(self) -> tuple[dict[str, int], ...]:
        return self.values, self.upper, self.lower

    def between(self, name: str, least: int, most: int) -> _Known:
        """Return the same with bounds of a variable."""
        known = self.copy()
        known.values |= {name: most} if least == most else {}
        known.lower[name], known.upper[name] = least, most
        return known

    def forget(self, names: Set[str]) -> None:
        """Forget what depends on these variables."""
        for name in names:
            self.values.pop(name, None)
            for text in [text for text in self.upper if name in _names(text)]:
                del self.upper[text]
            self.lower.pop(name, None)

    def key(self) -> tuple[tuple[str, int], ...]:
        return tuple(item for part in self.parts() for item in (*sorted(part.items()), ("", 0)))


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


_NONE = -(1 << 100)


@dataclass(frozen=True)
class _Cost:
    """Operations at most of paths without a check of `s.spent`; of those with one, since the last, with its budget.

    Below 0 if there is no such path.
    """

    free: int
    checked: int = _NONE

    @property
    def possible(self) -> bool:
        return max(self.free, self.checked) >= 0

    def __add__(self, other: _Cost | int) -> _Cost:
        """Return the cost of paths that go on with others."""
        more = _Cost(other) if isinstance(other, int) else other
        if not self.possible:
            return self
        return _Cost(max(self.free + more.free, _NONE), max(self.checked + more.free, more.checked, _NONE))

    def either(self, other: _Cost) -> _Cost:
        return _Cost(max(self.free, other.free), max(self.checked, other.checked))

    def repeated(self, most: int) -> _Cost:
        """Return the cost of 0 to `most` repetitions."""
        again = max(self.free, 0)
        return _Cost(most * again, self.checked + (most - 1) * again)


_Paths: TypeAlias = tuple[_Cost, frozenset[str]]  # the cost, and variables that may be assigned
_NEVER = _Cost(_NONE)
_CASES = 12


class _Bound:
    def __init__(self, tree: ast.Module, sizes: Mapping[str, int]) -> None:
        self.functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
        self.sizes, self.tables = sizes, _tables(tree)
        self.calls: dict[tuple[object, ...], tuple[_Paths, dict[int, int]]] = {}
        self.rare: dict[tuple[int, int | None], int] = {}  # of each branch with `seldom`, in the whole run
        self.shared: dict[int, int] = {}  # of what follows `once`, for each value
        self.uses: dict[str, tuple[frozenset[str], frozenset[str]]] = {}  # variables a function reads or assigns
        self.sums = {
            name
            for name, node in self.functions.items()
            if any(called(one, "anew") is not None for one in ast.walk(node))
        }
        self.assigned: dict[int, frozenset[str]] = {}
        self.ends: dict[str, list[int]] = {}  # upper bounds of the results of a function
        for name, node in self.functions.items():
            below = [self.uses[other] for other, _ in _calls(node) if other in self.uses]
            read = frozenset(_text(one) for one in ast.walk(node) if isinstance(one, ast.Attribute))
            stored = frozenset(text for text in _stored(node) if "." in text)
            self.uses[name] = read.union(*(one for one, _ in below)), stored.union(*(one for _, one in below))
            most = [
                self._upper(one.value, _Known()) for one in ast.walk(node) if isinstance(one, ast.Return) and one.value
            ]
            loops = (one for one in ast.walk(node) if isinstance(one, ast.For))
            inner = any(isinstance(one, ast.Return) for loop in loops for one in ast.walk(loop))
            self.ends[name] = [] if inner or None in most else sorted({one for one in most if one is not None})

    def total(self) -> int:
        """Return the bound for the last function."""
        cost = self._function(list(self.functions)[-1], _Known())[0]
        return max(cost.free, cost.checked) + sum(self.rare.values())

    def _function(self, name: str, known: _Known, end: int | None = None) -> _Paths:
        """Return the cost of a function, or of its paths to a result with this upper bound, and what they assign."""
        key = (name, end, known.key())
        if key not in self.calls:
            before, self.shared = self.shared, {}
            cost, stored = self._block(self.functions[name].body, known, end)
            if name in self.sums:
                cost, self.shared = cost + sum(self.shared.values()), {}
            self.calls[key] = (cost, frozenset(text for text in stored if "." in text)), self.shared
            self.shared = before
        paths, shared = self.calls[key]
        for at, most in shared.items():
            self.shared[at] = max(self.shared.get(at, 0), most)
        return paths

    def _block(self, body: Sequence[ast.stmt], known: _Known, end: int | None = None) -> _Paths:
        """Return the cost of statements, below 0 if no path through them is possible, and what the paths assign."""
        total, stored = _Cost(0), frozenset[str]()
        for place, node in enumerate(body):
            rest = body[place + 1 :]
            if isinstance(node, ast.Assert) and isinstance(node.test, ast.BoolOp) and isinstance(node.test.op, ast.Or):
                left = [value for value in node.test.values if self._value(value, known) != 0]
                node = ast.Assert(left[0]) if len(left) == 1 else node
            match node:
                case ast.For():
                    total = total + self._loop(node, known)
                    stored |= self._stored(node)
                    continue
                case ast.If(test=ast.Compare(left=ast.Attribute(attr="spent"), comparators=[budget])):
                    ended = isinstance(node.body[-1], ast.Return | ast.Break | ast.Continue)
                    cost, names = self._block([*node.body, *([] if ended else rest)], known.copy(), end)
                    follow, others = self._block(rest, known, end)
                    since = max(follow.checked, follow.free + (self._value(budget, known) or 0))
                    return total + cost.either(_Cost(_NONE, since)), stored | names | others
                case ast.If():
                    cases = self._branches(node, rest, known, end)
                case ast.Return(value=ast.expr() as value) if end is not None and self._upper(value, known) != end:
                    return _NEVER, stored
                case ast.Expr(value=call) if (args := called(call, "once")) is not None:
                    self._once(args, rest, known)
                    return total, stored.union(*map(self._stored, rest))
                case ast.Expr(value=call) if called(call, "anew") is not None:
                    continue
                case ast.Assert(test=ast.Compare(left=one, ops=[ast.In()], comparators=[ast.Call(args=args)])):
                    if self._value(one, known) is not None or _text(one) in known.lower:
                        continue
                    values = range(*(self._value(arg, known) or 0 for arg in args))
                    step = 1 if len(values) <= _CASES else -(-len(values) // 3)  # for the time that it takes
                    parts = [values[at : at + step] for at in range(0, len(values), step)]
                    cases = [self._block(rest, known.between(_text(one), part[0], part[-1]), end) for part in parts]
                case ast.Assert(test=test):
                    if self._value(test, known) == 0:
                        return _NEVER, stored
                    self._learn(test, known)
                    continue
                case ast.Assign(targets=[target], value=ast.Call(func=ast.Name(id=name)) as call) if self.ends.get(
                    name
                ):
                    cases = [self._after(call, target, most, rest, known, end) for most in self.ends[name]]
                case _:
                    total = total + self._expression(node, known)
                    self._assign(node, known)
                    stored |= self._stored(node)
                    continue
            cases = [case for case in cases if case[0].possible]
            most = reduce(_Cost.either, (cost for cost, _ in cases), _NEVER)
            return total + most if cases else _NEVER, stored.union(*(names for _, names in cases))
        return total, stored

    def _after(
        self, call: ast.Call, target: ast.expr, most: int, rest: Sequence[ast.stmt], known: _Known, end: int | None
    ) -> _Paths:
        """Return the cost of a call with this upper bound of its result, and of the statements that follow it."""
        assert isinstance(call.func, ast.Name)
        name = call.func.id
        cost, stored = self._function(name, self._passed(name, call, known), most)
        inner = known.copy()
        inner.forget(stored | {_text(target)})
        inner.upper[_text(target)] = most
        follow, names = self._block(rest, inner, end)
        return cost + follow, stored | names

    def _stored(self, node: ast.AST) -> frozenset[str]:
        """Return the variables that a statement may assign, also in functions that it calls."""
        if id(node) not in self.assigned:
            below = (self.uses[name][1] for name, _ in _calls(node) if name in self.uses)
            self.assigned[id(node)] = _stored(node).union(*below)
        return self.assigned[id(node)]

    def _assign(self, node: ast.AST, known: _Known) -> None:
        """Note the value of the variable that a statement assigns, and bounds of `a - …` after `a -= b`."""
        value, upper = None, dict[str, int]()
        match node:
            case ast.Assign(targets=[ast.Name() | ast.Attribute() as target], value=new):
                value, most = self._value(new, known), self._upper(new, known)
                upper |= {} if most is None else {_text(target): most}
            case ast.AugAssign(target=ast.Name() | ast.Attribute() as target, op=op, value=new):
                value, less = self._value(ast.BinOp(target, op, new), known), self._value(new, known)
                if isinstance(op, ast.Sub) and less is not None:
                    begin = f"{_text(target)} - "
                    upper |= {key: bound - less for key, bound in known.upper.items() if key.startswith(begin)}
        known.forget(self._stored(node))
        known.upper |= upper
        known.values |= {} if value is None else {_text(target): value}

    def _learn(self, test: ast.expr, known: _Known) -> None:
        match test:
            case ast.BoolOp(op=ast.And(), values=values):
                for value in values:
                    self._learn(value, known)
            case ast.Compare(left=one, ops=[ast.Eq()], comparators=[other]):
                most = self._value(other, known)
                known.values |= {} if most is None else {_text(one): most}
            case (
                ast.Compare(left=less, ops=[ast.LtE()], comparators=[more])
                | ast.Compare(left=more, ops=[ast.GtE()], comparators=[less])
            ):
                least, most = self._value(less, known), self._upper(more, known)
                if least is not None:
                    known.lower[_text(more)] = max(least, known.lower.get(_text(more), least))
                if most is not None:
                    known.upper[_text(less)] = min(most, known.upper.get(_text(less), most))

    def _branches(self, node: ast.If, rest: Sequence[ast.stmt], known: _Known, end: int | None) -> list[_Paths]:
        """Return the cost of each branch with what follows it."""
        cost, seldom = self._tests(node.test, known)
        test, cases = self._value(node.test, known), list[_Paths]()
        after = known.copy()
        after.forget(self._stored(node))
        follow, names = self._block(rest, after, end)
        known.forget(self._stored(node.test))
        for part, truth in ((node.body, True), (node.orelse, False)):
            if test is not None and bool(test) is not truth:
                continue
            own, stored = self._block(part, known.copy(), end if seldom is None else None)
            if truth and seldom is not None:
                self._rare(node, seldom, own)
                own = _Cost(0, own.checked)
            if not part or not isinstance(part[-1], ast.Return | ast.Break | ast.Continue):
                own, stored = own + follow, stored | names
            cases.append((cost + own, stored | self._stored(node.test)))
        return cases

    def _tests(self, node: ast.expr, known: _Known) -> tuple[_Cost, tuple[int, int | None] | None]:
        """Return the cost of a condition, and if `seldom` says so, how often it is fulfilled for which value."""
        total, seldom = _Cost(0), None
        for value in node.values if isinstance(node, ast.BoolOp) else [node]:
            limit = called(value, "seldom")
            if limit is not None:
                seldom = self._value(limit[0], known) or 0, self._value(limit[-1], known)
            elif seldom is None:
                total = total + self._expression(value, known)
            else:
                self._rare(value, seldom, self._expression(value, known))
            if isinstance(node, ast.BoolOp) and isinstance(node.op, ast.And) and self._value(value, known) == 0:
                break
        return total, seldom

    def _rare(self, node: ast.AST, seldom: tuple[int, int | None], cost: _Cost) -> None:
        most, value = seldom
        self.rare[id(node), value] = max(self.rare.get((id(node), value), 0), most * cost.free)

    def _once(self, args: Sequence[ast.expr], rest: Sequence[ast.stmt], known: _Known) -> None:
        most = self._upper(args[1], known) or 0
        value = self._value(args[0], known)
        for at in range(most) if value is None else [value]:
            inner = known.copy()
            if isinstance(args[0], ast.Name):
                inner.values[args[0].id] = at
            self.shared[at] = max(self.shared.get(at, 0), self._block(rest, inner)[0].free)

    def _loop(self, node: ast.For, known: _Known) -> _Cost:
        assert isinstance(node.iter, ast.Call) and isinstance(node.target, ast.Name)
        args, name = node.iter.args, node.target.id
        start = 0 if len(args) == 1 else self._value(args[0], known)
        extent = args[0] if len(args) == 1 else _difference(args[1], args[0])
        limits = [self._upper(args[-1], known), self._upper(extent, known)]
        stop = self._upper(args[-2], known) if len(args) > 1 else None
        if start is not None and stop is not None:
            limits.append(stop - start)
        count = max(0, min(limit for limit in limits if limit is not None))
        whole = len(args) > 1 and known.lower.get(_text(args[0]), -1) >= 0
        known.forget(self._stored(node))
        if count == 0:
            return _Cost(0)
        first = 0 if whole and start is None and stop is not None else start
        if first is None or not _matters(name, node):
            return self._block(node.body, known.copy())[0].repeated(count)
        values = range(first, first + count if start is not None or stop is None else stop)
        costs = [self._block(node.body, known.between(name, at, at))[0] for at in values]
        most = reduce(_Cost.either, costs)
        return most.repeated(count) if most.checked >= 0 else _Cost(sum(sorted(max(0, c.free) for c in costs)[-count:]))

    def _expression(self, node: ast.AST, known: _Known) -> _Cost:
        own = [(name, call) for name, call in _calls(node) if name in self.functions]
        if len(own) > 1:  # the later ones may follow what the first assigns
            known = known.copy()
            known.forget(self._stored(node))
        costs = (self._function(name, self._passed(name, call, known))[0] for name, call in own)
        return reduce(_Cost.__add__, costs, _Cost(operations_in(node)))

    def _passed(self, function: str, call: ast.Call, known: _Known) -> _Known:
        """Return what is known of the arguments of a call, and of their differences."""
        names = [arg.arg for arg in self.functions[function].args.args[1:]]
        pairs = dict(zip(names, call.args[1:], strict=True))
        inner = _Known(*({t: n for t, n in part.items() if t in self.uses[function][0]} for part in known.parts()))
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
            case ast.IfExp(body=a, orelse=b):
                bounds = [self._upper(a, known), self._upper(b, known)]
                return None if None in bounds else max(most for most in bounds if most is not None)
        value = self._value(node, known)
        if value is not None:
            return value
        bounds = [known.upper.get(_text(node))]
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Sub):
            most, less = self._upper(node.left, known), self._value(node.right, known)
            less = known.lower.get(_text(node.right)) if less is None else less
            bounds.append(None if most is None or less is None else most - less)
        return min((most for most in bounds if most is not None), default=None)

    def _value(self, node: ast.expr, known: _Known) -> int | None:
        """Return the value of a whole expression or a condition, or None if it is not known."""
        match node:
            case ast.Constant(value=value) if isinstance(value, int):
                return int(value)
            case ast.Name(id=name):
                return known.values.get(name)
            case ast.Attribute(attr=name):
                return known.values.get(_text(node), self.sizes.get(name))
            case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int(value))):
                return -value
            case ast.Call(func=ast.Name(id="seldom")):
                return 1
            case ast.IfExp(test=test, body=body, orelse=orelse):
                truth = self._value(test, known)
                return None if truth is None else self._value(body if truth else orelse, known)
            case ast.Compare(left=left, ops=[ast.Gt()], comparators=[ast.Constant(value=int(value))]) if (
                known.upper.get(_text(left), value + 1) <= value
            ):
                return 0
            case ast.Subscript(value=ast.Attribute(attr=name), slice=at) if name in self.tables:
                place = self._value(at, known)
                return None if place is None else self.tables[name].get(place)
            case ast.BinOp(left=left, op=op, right=right) | ast.Compare(left=left, ops=[op], comparators=[right]):
                a, b = self._value(left, known), self._value(right, known)
                return None if a is None or b is None or type(op) not in VALUES else int(VALUES[type(op)](a, b))
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
