"""Writer of a procedure as C99: a struct for its memory, static functions, iterations that are computed together."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from surctl.ir.c99 import C_TYPE, Real, broken, c_literal, signature
from surctl.ir.procedure import BINARY, COMPARED, Procedure, Typed

_SIGNS: Mapping[type[ast.AST], str] = {**BINARY, **COMPARED, ast.And: "&&", ast.Or: "||"}


_VECTORS = """#if defined(__GNUC__) && !defined(__clang__)
typedef {kind} {name} __attribute__((vector_size(4 * sizeof({kind})), aligned(sizeof({kind})), may_alias));
#define FOUR(entry) (*(const {name} *)&(entry))
#define TO_FOUR(entry) (*({name} *)&(entry))
#endif
"""


def emit_procedure(procedure: Procedure, *, symbol: str, real: Real = "float64", vectors: bool = False) -> str:
    """Return C functions, the last `static void <symbol>(const double *in0, …, double *out0, …)`.

    The text needs <math.h>. No output may overlap an input or another output. The memory is a local variable of the
    last function. With `vectors`, loops over the entries of arrays compute four or eight entries at once, with GCC;
    results are equal.
    """
    kind, memory = C_TYPE[real], f"{symbol}_memory"
    words = {"real": kind, "whole": "int", "": "void", "none": "void"}
    fields = [f"    const {kind} *{name};" for name, _ in procedure.inputs]
    fields += [f"    {kind} *{name};" for name, _ in procedure.outputs]
    for name, what, size in procedure.memory:
        fields.append(f"    {words[what]} {name}[{size}];" if size else f"    {words[what]} {name};")
    chunks = [_VECTORS.format(kind=kind, name=f"{symbol}_four")] if vectors else []
    chunks += ["\n".join(["typedef struct {", *fields, f"}} {memory};"]) + "\n"]
    for function in procedure.functions:
        text = _Function(procedure, function, symbol, real, words, vectors=vectors)
        arguments = [f"{memory} *s", *(f"{words[what]} {name}" for name, what in function.arguments)]
        head = f"static {words[function.result]} {symbol}_{function.name}("
        chunks.append("\n".join([*broken(head, arguments, ")", indent=" " * 8), "{", *text.lines(), "}"]) + "\n")
    reads, writes = ([size for _, size in group] for group in (procedure.inputs, procedure.outputs))
    names = [f"    s.{name} = in{k};" for k, (name, _) in enumerate(procedure.inputs)]
    names += [f"    s.{name} = out{k};" for k, (name, _) in enumerate(procedure.outputs)]
    names += [f"    s.{name} = 0;" for name, _, size in procedure.memory if not size]
    top = signature(f"static void {symbol}", reads, writes, kind)
    entry = f"    {symbol}_{procedure.functions[-1].name}(&s);"
    ends = ["#if defined(FOUR)", "#undef FOUR", "#undef TO_FOUR", "#endif"] if vectors else []
    chunks.append("\n".join([*top, "{", f"    {memory} s;", *names, entry, "}", *ends]) + "\n")
    return "\n".join(chunks)


class _Function:
    """Translates one function to C."""

    def __init__(
        self, procedure: Procedure, function: Typed, symbol: str, real: Real, words: Mapping[str, str], *, vectors: bool
    ) -> None:
        self.sizes = dict(procedure.sizes)
        self.groups = _groups(function, self.sizes) if vectors else {}
        self.group: _Group | None = None  # the loop of which several iterations are written together
        self.shifts: tuple[int, ...] = (0,)  # first iteration of each of their vectors
        self.shift = 0  # of the vector that is written
        self.function, self.symbol, self.real, self.words = function, symbol, real, words
        self.called = {f.name: [kind for _, kind in f.arguments] for f in procedure.functions}

    def lines(self) -> list[str]:
        own = {name for group in self.groups.values() for name in group.local}
        local = [f"    {self.words[kind]} {name} = 0;" for name, kind in self.function.local.items() if name not in own]
        body = self._block(self.function.node.body, "    ")
        idle = ["    (void)s;"] if not any("s->" in line or "(s" in line for line in body) else []
        return [*local, *idle, *body]

    def _block(self, body: Sequence[ast.stmt], indent: str) -> list[str]:
        lines = []
        for statement in body:
            once = self.group is None or isinstance(statement, ast.For) or not self.group.varies(statement)
            for shift in (0,) if once else self.shifts:
                self.shift = shift
                lines += self._statement(statement, indent)
        return lines

    def _statement(self, node: ast.stmt, indent: str) -> list[str]:
        match node:
            case ast.Assign(targets=[ast.Name(id=name) as target], value=ast.Constant() as value) if self._is_four(
                name
            ):
                four = ", ".join([self._as(value, "real")] * 4)
                return [f"{indent}{self._text(target)} = ({self.symbol}_four){{{four}}};"]
            case ast.Assign(targets=[target], value=value):
                return [f"{indent}{self._text(target)} = {self._as(value, self.function.types[id(target)])};"]
            case ast.AugAssign(target=target, op=op, value=value):
                kind = self.function.types[id(target)]
                return [f"{indent}{self._text(target)} {_SIGNS[type(op)]}= {self._as(value, kind)};"]
            case ast.If(test=test, body=body, orelse=other):
                lines = [f"{indent}if ({self._text(test)}) {{", *self._block(body, indent + "    ")]
                if other:
                    lines += [f"{indent}}} else {{", *self._block(other, indent + "    ")]
                return [*lines, f"{indent}}}"]
            case ast.For(target=ast.Name(id=name), iter=ast.Call(func=ast.Name(id=kind), args=args), body=body):
                start, stop = ("0", args[0]) if kind == "range" else (self._text(args[0]), args[1])
                end = self._text(stop)
                head = f"for (int {name} = {start}, {name}_end = {end}; {name} < {name}_end; ++{name}) {{"
                if kind == "back":
                    head = f"for (int {name} = {end} - 1, {name}_end = {start}; {name} >= {name}_end; --{name}) {{"
                if id(node) in self.groups:
                    return self._grouped(name, self.groups[id(node)], start, end, body, indent)
                return [f"{indent}{head}", *self._block(body, indent + "    "), f"{indent}}}"]
            case ast.Return(value=value):
                return [f"{indent}return {self._as(value, self.function.result)};" if value else f"{indent}return;"]
            case ast.Expr(value=value):
                return [f"{indent}{self._text(value)};"]
            case ast.Break():
                return [f"{indent}break;"]
            case ast.Continue():
                return [f"{indent}continue;"]
        return []

    def _grouped(
        self, name: str, group: _Group, start: str, end: str, body: Sequence[ast.stmt], indent: str
    ) -> list[str]:
        """Return C for a loop that computes groups of iterations at once, and then those that are left, one by one."""
        inner, lines = indent + "        ", [f"{indent}{{", f"{indent}    const int {name}_end = {end};"]
        lines += [f"{indent}    int {name} = {start};", "#if defined(FOUR)"]
        left = int(end) - int(start) if (start + end).isdigit() else -1  # −1: not known
        for width in group.widths:
            if left in range(width):
                continue
            left = left % width if left > 0 else left
            self.group, self.shifts = group, tuple(range(0, width, 4))
            own = [f"{inner}{self.symbol}_four _{local}{at};" for local in sorted(group.local) for at in self.shifts]
            lines.append(f"{indent}    for (; {name} + {width} <= {name}_end; {name} += {width}) {{")
            lines += [*own, *self._block(body, inner), f"{indent}    }}"]
        self.group, self.shifts = None, (0,)
        last = [f"{indent}    for (; {name} < {name}_end; ++{name}) {{"]
        last += [f"{inner}{self.words['real']} {local};" for local in sorted(group.local)]
        last += [*self._block(body, inner), f"{indent}    }}"]
        return [*lines, *(["#else", *last, "#endif"] if left == 0 else ["#endif", *last]), f"{indent}}}"]

    def _is_four(self, name: str) -> bool:
        return self.group is not None and name in self.group.local

    def _as(self, node: ast.expr, kind: str) -> str:
        """Return the text of an expression that is converted to the type."""
        own = self.function.types[id(node)]
        if own == kind or kind != "real":
            return self._text(node)
        if isinstance(node, ast.Constant):
            return c_literal(float(node.value), self.real)  # type: ignore[arg-type]
        return f"({self.words['real']}){self._operand(node)}"

    def _operand(self, node: ast.expr, kind: str = "") -> str:
        text = self._as(node, kind) if kind else self._text(node)
        atom = isinstance(node, ast.Name | ast.Attribute | ast.Subscript | ast.Call)
        positive = isinstance(node, ast.Constant) and not text.startswith("-")
        return text if atom or positive or text.startswith("(" + self.words["real"] + ")") else f"({text})"

    def _text(self, node: ast.expr) -> str:
        types = self.function.types
        match node:
            case ast.Constant(value=value):
                return c_literal(value, self.real) if isinstance(value, float) else str(int(value))  # type: ignore[arg-type]
            case ast.Name(id=name):
                return f"_{name}{self.shift}" if self._is_four(name) else name
            case ast.Attribute(attr=name):
                return str(self.sizes[name]) if name in self.sizes else f"s->{name}"
            case ast.Subscript(value=ast.Attribute(attr=name), slice=at):
                if self.group is None or not _mentions(self.group.name, at):
                    return f"s->{name}[{self._text(at)}]"
                text = f"s->{name}[{self._text(at)}{f' + {self.shift}' if self.shift else ''}]"
                return f"{'FOUR' if isinstance(node.ctx, ast.Load) else 'TO_FOUR'}({text})"
            case ast.BinOp(left=left, op=op, right=right):
                kind = types[id(node)]
                return f"{self._operand(left, kind)} {_SIGNS[type(op)]} {self._operand(right, kind)}"
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                kind = "real" if "real" in (types[id(left)], types[id(right)]) else "whole"
                return f"{self._operand(left, kind)} {_SIGNS[type(op)]} {self._operand(right, kind)}"
            case ast.BoolOp(op=op, values=values):
                return f" {_SIGNS[type(op)]} ".join(self._operand(value) for value in values)
            case ast.UnaryOp(op=op, operand=operand):
                return f"{'-' if isinstance(op, ast.USub) else '!'}{self._operand(operand)}"
            case ast.IfExp(test=test, body=body, orelse=other):
                kind = types[id(node)]
                return f"{self._operand(test)} ? {self._operand(body, kind)} : {self._operand(other, kind)}"
            case ast.Call(func=ast.Name(id=name), args=args):
                if name not in self.called:
                    return f"{name}{'f' if self.real == 'float32' else ''}({self._as(args[0], 'real')})"
                passed = [self._as(arg, kind) for arg, kind in zip(args[1:], self.called[name], strict=True)]
                return f"{self.symbol}_{name}({', '.join(['s', *passed])})"
        raise AssertionError(ast.dump(node))


_BRANCHING = (ast.Call, ast.Compare, ast.BoolOp, ast.IfExp, ast.Div, ast.UnaryOp)


def _mentions(name: str, node: ast.AST) -> bool:
    return any(isinstance(inner, ast.Name) and inner.id == name for inner in ast.walk(node))


def _groups(function: Typed, sizes: Mapping[str, int]) -> dict[int, _Group]:
    """Return the loops whose iterations may be computed together, outer loops first, by the `id` of the node."""
    groups: dict[int, _Group] = {}
    inside: set[int] = set()
    for node in ast.walk(function.node):
        if isinstance(node, ast.For) and id(node) not in inside:
            group = _Reader(node, function, sizes).group()
            if group is not None:
                groups[id(node)] = group
                inside |= {id(inner) for inner in ast.walk(node)}
    while True:  # a vector must not be needed elsewhere
        covered = {id(inner) for group in groups.values() for inner in ast.walk(group.node)}
        others = {n.id for n in ast.walk(function.node) if isinstance(n, ast.Name) and id(n) not in covered}
        allowed = {key: group for key, group in groups.items() if not others & group.local}
        if len(allowed) == len(groups):
            return allowed
        groups = allowed


@dataclass(frozen=True)
class _Group:
    """A loop whose iterations may be computed together.

    Attributes:
        node, name: the loop and its variable.
        local: local variables that differ between iterations.
        widths: numbers of iterations that are computed at once, largest first.
    """

    node: ast.For
    name: str
    local: frozenset[str]
    widths: tuple[int, ...]

    def varies(self, statement: ast.stmt) -> bool:
        """Return whether a statement differs between iterations."""
        return any(_mentions(name, statement) for name in (self.name, *self.local))


class _Reader:
    """Decides whether the iterations of a loop are independent sums and products of entries in neighbouring places.

    No iteration uses an entry that another iteration of its group writes: the index of an array that is written is the
    same wherever it occurs, also in all iterations of inner loops, or it is `… * size + variable` with a size that is
    not below the width of the group.
    """

    def __init__(self, node: ast.For, function: Typed, sizes: Mapping[str, int]) -> None:
        assert isinstance(node.target, ast.Name)
        self.node, self.name, self.types, self.sizes = node, node.target.id, function.types, sizes
        pairs = [(_target(each), _value(each)) for each in _statements(node.body) if not isinstance(each, ast.For)]
        values = [(target.id, value) for target, value in pairs if isinstance(target, ast.Name)]
        self.owned = {name for name, _ in values}
        self.local: set[str] = set()
        while new := {name for name, value in values if self._differs(value)} - self.local:
            self.local |= new
        self.turns: set[str] = set()
        self.indices: dict[str, dict[str, ast.expr]] = {}  # of each array, by their text
        self.written: set[str] = set()

    def group(self) -> _Group | None:
        """Return the loop as a group, or None if its iterations cannot be computed together."""
        assert isinstance(self.node.iter, ast.Call) and isinstance(self.node.iter.func, ast.Name)
        begun = all(_begins(name, self.node.body) for name in self.local)
        if self.node.iter.func.id == "back" or not begun or not self._block(self.node.body) or not self.written:
            return None
        most = min(map(self._width, self.written))
        widths = tuple(width for width in (8, 4) if width <= most and (width == 4 or self.turns))
        return _Group(self.node, self.name, frozenset(self.local), widths) if widths else None

    def _width(self, array: str) -> int:
        indices = self.indices[array].values()
        if len(indices) == 1 and not any(_mentions(name, at) for name in self.turns | self.owned for at in indices):
            return 8
        return min(map(self._stride, indices))

    def _stride(self, at: ast.expr) -> int:
        match at:
            case ast.BinOp(
                left=ast.BinOp(op=ast.Mult(), right=ast.Attribute(attr=size)), op=ast.Add(), right=ast.Name(id=name)
            ) if name == self.name:
                return self.sizes.get(size, 0)
        return 0

    def _block(self, body: Sequence[ast.stmt]) -> bool:
        return all(map(self._statement, body))

    def _statement(self, node: ast.stmt) -> bool:
        if isinstance(node, ast.For) and isinstance(node.target, ast.Name) and isinstance(node.iter, ast.Call):
            self.turns.add(node.target.id)
            return not any(map(self._differs, node.iter.args)) and self._block(node.body)
        target, value = _target(node), _value(node)
        if not self._is_sum(value):
            return False
        if isinstance(target, ast.Subscript) and isinstance(target.value, ast.Attribute):
            self.written.add(target.value.attr)
            return self._differs(value) and self._is_entry(target) and _mentions(self.name, target.slice)
        if not isinstance(target, ast.Name):
            return False
        if target.id in self.local:
            return self._differs(value) or isinstance(node, ast.AugAssign) or isinstance(value, ast.Constant)
        return isinstance(node, ast.Assign) and not any(_mentions(name, value) for name in self.owned)

    def _differs(self, value: ast.expr) -> bool:
        return any(_mentions(name, value) for name in (self.name, *self.local))

    def _is_sum(self, node: ast.expr) -> bool:
        if isinstance(node, ast.Subscript):
            return self._is_entry(node)
        if isinstance(node, _BRANCHING) or (isinstance(node, ast.Name) and node.id == self.name):
            return False
        return all(self._is_sum(inner) for inner in ast.iter_child_nodes(node) if isinstance(inner, ast.expr))

    def _is_entry(self, node: ast.Subscript) -> bool:
        """Return whether an index does not depend on the variable, is the variable, or a sum with it as last term."""
        at = node.slice
        assert isinstance(node.value, ast.Attribute)
        self.indices.setdefault(node.value.attr, {})[ast.unparse(at)] = at
        if not _mentions(self.name, at):
            return True
        last = at.right if isinstance(at, ast.BinOp) and isinstance(at.op, ast.Add) else at
        first = at.left if last is not at and isinstance(at, ast.BinOp) else None
        follows = isinstance(last, ast.Name) and last.id == self.name
        return follows and (first is None or not _mentions(self.name, first)) and self.types[id(node)] == "real"


def _statements(body: Sequence[ast.stmt]) -> Iterator[ast.stmt]:
    for statement in body:
        yield statement
        if isinstance(statement, ast.For):
            yield from _statements(statement.body)


_NONE = ast.Tuple([])  # not in the language of procedures


def _target(node: ast.stmt) -> ast.expr:
    return (
        node.target if isinstance(node, ast.AugAssign) else node.targets[0] if isinstance(node, ast.Assign) else _NONE
    )


def _value(node: ast.stmt) -> ast.expr:
    return node.value if isinstance(node, ast.Assign | ast.AugAssign) else _NONE


def _begins(name: str, body: Sequence[ast.stmt]) -> bool:
    """Return whether a variable is assigned in the first statement that mentions it, in the block with all of them."""
    using = [statement for statement in body if _mentions(name, statement)]
    first = using[0]
    if len(using) == 1 and isinstance(first, ast.For):
        return _begins(name, first.body)
    return isinstance(first, ast.Assign) and not _mentions(name, first.value) and isinstance(first.targets[0], ast.Name)
