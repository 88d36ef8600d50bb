"""Writer of a procedure as C99: a struct for its memory, and a static function for each of its functions."""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence

from surctl.ir.c99 import C_TYPE, Real, broken, c_literal, signature
from surctl.ir.procedure import Procedure, Typed

_SIGNS: Mapping[type[ast.AST], str] = {
    **{ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.And: "&&", ast.Or: "||"},
    **{ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="},
}


_VECTORS = """#if defined(__GNUC__) && !defined(__clang__)
typedef {kind} {name} __attribute__((vector_size(4 * sizeof({kind})), aligned(sizeof({kind})), may_alias));
#define FOUR(entry) (*(const {name} *)&(entry))
#define TO_FOUR(entry) (*({name} *)&(entry))
#endif
"""


def emit_procedure(procedure: Procedure, *, symbol: str, real: Real = "float64", vectors: bool = False) -> str:
    """Return C functions, the last `static void <symbol>(const double *in0, …, double *out0, …)`.

    The text needs <math.h>. No output may overlap an input or another output. The memory is a local variable of the
    last function.

    Args:
        procedure: the procedure.
        symbol: name of the last function, and prefix of the other names.
        real: type of the numbers.
        vectors: whether loops over the entries of arrays compute four entries at once, with GCC; results are equal.
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
    top = [f"/* {procedure.operations} operations at most */", *signature(f"static void {symbol}", reads, writes, kind)]
    entry = f"    {symbol}_{procedure.functions[-1].name}(&s);"
    ends = ["#if defined(FOUR)", "#undef FOUR", "#undef TO_FOUR", "#endif"] if vectors else []
    chunks.append("\n".join([*top, "{", f"    {memory} s;", *names, entry, "}", *ends]) + "\n")
    return "\n".join(chunks)


class _Function:
    """Translates one function to C."""

    def __init__(
        self, procedure: Procedure, function: Typed, symbol: str, real: Real, words: Mapping[str, str], *, vectors: bool
    ) -> None:
        self.vectors = vectors
        self.four = ""  # variable of the loop of which four iterations are computed at once
        self.function, self.symbol, self.real, self.words = function, symbol, real, words
        self.sizes = dict(procedure.sizes)
        self.called = {f.name: [kind for _, kind in f.arguments] for f in procedure.functions}

    def lines(self) -> list[str]:
        local = [f"    {self.words[kind]} {name} = 0;" for name, kind in self.function.local.items()]
        body = self._block(self.function.node.body, "    ")
        idle = ["    (void)s;"] if not any("s->" in line or "(s" in line for line in body) else []
        return [*local, *idle, *body]

    def _block(self, body: Sequence[ast.stmt], indent: str) -> list[str]:
        return [line for statement in body for line in self._statement(statement, indent)]

    def _statement(self, node: ast.stmt, indent: str) -> list[str]:
        match node:
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
                if self.vectors and kind != "back" and _entrywise(name, body):
                    return self._fours(name, start, end, body, indent)
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

    def _fours(self, name: str, start: str, end: str, body: Sequence[ast.stmt], indent: str) -> list[str]:
        inner = indent + "        "
        self.four = name
        together = self._block(body, inner)
        self.four = ""
        return [
            f"{indent}{{",
            f"{indent}    const int {name}_end = {end};",
            f"{indent}    int {name} = {start};",
            "#if defined(FOUR)",
            f"{indent}    for (; {name} + 4 <= {name}_end; {name} += 4) {{",
            *together,
            f"{indent}    }}",
            "#endif",
            f"{indent}    for (; {name} < {name}_end; ++{name}) {{",
            *self._block(body, inner),
            f"{indent}    }}",
            f"{indent}}}",
        ]

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
                return name
            case ast.Attribute(attr=name):
                return str(self.sizes[name]) if name in self.sizes else f"s->{name}"
            case ast.Subscript(value=ast.Attribute(attr=name), slice=at):
                text = f"s->{name}[{self._text(at)}]"
                if not (self.four and _mentions(self.four, at)):
                    return text
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


def _follows(name: str, at: ast.expr) -> bool:
    """Return whether an index grows by 1 with the variable: it is the variable, or a sum with it as the last term."""
    last = at.right if isinstance(at, ast.BinOp) and isinstance(at.op, ast.Add) else at
    first = at.left if last is not at and isinstance(at, ast.BinOp) else None
    return isinstance(last, ast.Name) and last.id == name and (first is None or not _mentions(name, first))


def _entrywise(name: str, body: Sequence[ast.stmt]) -> bool:
    """Return whether the iterations are independent sums and products of entries, in neighbouring places of arrays.

    An array that is written is read at the same place only, so four iterations at once give the same numbers.
    """
    written: dict[str, str] = {}
    read: list[tuple[str, str]] = []
    for statement in body:
        if not isinstance(statement, ast.Assign | ast.AugAssign):
            return False
        target = statement.target if isinstance(statement, ast.AugAssign) else statement.targets[0]
        if not isinstance(target, ast.Subscript) or not _follows(name, target.slice):
            return False
        assert isinstance(target.value, ast.Attribute)
        place = ast.unparse(target.slice)
        if written.setdefault(target.value.attr, place) != place or not _mentions(name, statement.value):
            return False
        inner = list(ast.walk(statement.value))
        entries = [node for node in inner if isinstance(node, ast.Subscript)]
        indices = {id(node) for entry in entries for node in ast.walk(entry.slice)}
        for node in inner:
            if id(node) in indices:
                continue
            if isinstance(node, ast.Subscript):
                assert isinstance(node.value, ast.Attribute)
                if _mentions(name, node.slice) and not _follows(name, node.slice):
                    return False
                read.append((node.value.attr, ast.unparse(node.slice)))
            elif isinstance(node, _BRANCHING) or (isinstance(node, ast.Name) and node.id == name):
                return False
    return all(written.get(array, place) == place for array, place in read)
