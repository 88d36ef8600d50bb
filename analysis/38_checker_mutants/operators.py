"""Mutants of a module of the checker: each changes one place at which the module decides or rounds."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from dataclasses import dataclass

__all__ = ["Change", "changes"]

_PAIRS = (
    *(("min", "max"), ("any", "all"), ("root_up", "root_down"), ("ceil", "floor")),
    *(('"f"', '"c"'), ('"d"', '"u"'), ("math.inf", "-math.inf")),
)
_EXCHANGED = dict(_PAIRS) | {new: old for old, new in _PAIRS}
_TIMED = "go_on"  # it limits the time and decides nothing about a claim

Place = tuple[str, ast.AST, str]
"""What a mutant does, the node that it replaces, and the source in its place."""


@dataclass(frozen=True)
class Change:
    """One mutant of a source text.

    Attributes:
        kind: what the mutant does.
        function: qualified name of the function that contains the place; empty outside functions.
        line: line of the place.
        old, new: source of the statement or condition around the place, without and with the mutant.
        source: the whole mutated text.
    """

    kind: str
    function: str
    line: int
    old: str
    new: str
    source: str


def changes(source: str) -> list[Change]:
    """Return the mutants of a source text in the order of their places; two with the same `new` count as one."""
    text = source.encode()
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def ends(node: ast.AST) -> tuple[int, int]:
        assert isinstance(node, ast.expr | ast.stmt) and node.end_lineno and node.end_col_offset is not None
        return starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset

    def part(begin: int, end: int) -> str:
        return text[begin:end].decode()

    def visit(node: ast.AST, function: str, around: ast.AST | None) -> Iterator[Change]:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            function = f"{function}.{node.name}".lstrip(".")
        if isinstance(node, ast.If | ast.While):
            around = node.test
        elif isinstance(node, ast.For):
            around = node.iter
        elif isinstance(node, ast.stmt) and not hasattr(node, "body"):
            around = node
        for kind, place, new in _places(node, lambda part_: part(*ends(part_))):
            begin, end = ends(place)
            first, last = ends(around) if around else (begin, end)
            first, last = min(first, begin), max(last, end)
            shown = (part(first, last), part(first, begin) + new + part(end, last))
            old, changed = (" ".join(words.split()) for words in shown)
            yield Change(kind, function, part(0, begin).count("\n") + 1, old, changed, part(0, begin) + new
                         + part(end, len(text)))  # fmt: skip
        for name, value in ast.iter_fields(node):
            if name not in ("args", "annotation", "returns") or isinstance(node, ast.Call):
                for child in value if isinstance(value, list) else [value]:
                    if isinstance(child, ast.AST):
                        yield from visit(child, function, around)

    return list({change.source: change for change in visit(ast.parse(source), "", None)}.values())


def _places(node: ast.AST, source: Callable[[ast.AST], str]) -> Iterator[Place]:
    match node:
        case ast.Raise():
            yield "accepts", node, "pass"
        case ast.Return(value=ast.Constant(value=False)):
            yield "accepts", node, "return True"
        case ast.Return(value=ast.BoolOp() as test):
            yield from _ignored(test, ast.And)
        case ast.If(test=test) if _decides(node):
            yield from _ignored(test, ast.Or)
        case ast.Expr(value=ast.Call(func=called)) if source(called) != _TIMED:
            yield "leaves out", node, "pass"
        case ast.For(iter=elements) if any(map(_decides, ast.walk(node))) and not _attempts(elements):
            yield from _shortened(elements, source)
        case ast.Call(func=ast.Name(id="any" | "all"), args=[ast.GeneratorExp(generators=[first, *_])]):
            yield from _shortened(first.iter, source)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in _EXCHANGED:
        yield "exchanges", node.func, _EXCHANGED[node.func.id]
    if isinstance(node, ast.Constant | ast.Attribute) and source(node) in _EXCHANGED:
        yield "exchanges", node, _EXCHANGED[source(node)]


def _decides(node: ast.AST) -> bool:
    """Return whether a statement is a condition that rejects."""
    return isinstance(node, ast.If) and any(
        isinstance(inner, ast.Raise)
        or (isinstance(inner, ast.Return) and isinstance(inner.value, ast.Constant) and inner.value.value is False)
        for inner in (*node.body, *node.orelse)
    )


def _ignored(test: ast.expr, op: type[ast.boolop]) -> Iterator[Place]:
    if isinstance(test, ast.BoolOp) and isinstance(test.op, op):
        for value in test.values:
            yield "ignores", value, str(op is ast.And)
            yield from _ignored(value, op)


def _attempts(elements: ast.expr) -> bool:
    """Return whether a loop counts attempts up to a constant of the module instead of visiting elements."""
    match elements:
        case ast.Call(func=ast.Name(id="range"), args=[ast.Name(id=name)]):
            return name.isupper()
    return False


def _shortened(elements: ast.expr, source: Callable[[ast.AST], str]) -> Iterator[Place]:
    for rest in ("[1:]", "[:-1]"):
        yield "leaves out", elements, f"[*({source(elements)})]{rest}"
