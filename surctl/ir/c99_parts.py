"""Writer of C99 in several files; a large function is in one file with the functions that only this function calls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from surctl.ir.c99 import Real, identifier
from surctl.ir.c99_folded import inline_helpers, own_helpers
from surctl.ir.c99_routine import Writer, free_name, key_of
from surctl.ir.places import inlined
from surctl.ir.procedure import Procedure
from surctl.ir.program import LEAVES
from surctl.ir.routine import Block, Gather, Routine

__all__ = ["Parts", "emit_parts"]

_LEAST, _MOST = 16_000, 64_000  # smallest size of a separate file, and size beyond which a file is split [characters]


@dataclass(frozen=True)
class Parts:
    """C text of a program or routine, divided into several files.

    Attributes:
        files: C text of each file, by the name of the file's main function; the file of the last function has the name
            "".
        prototypes: C text that every file needs before its own: prototypes of the functions that are called from
            another file, and small inline functions.
    """

    files: Mapping[str, str]
    prototypes: tuple[str, ...]


def emit_parts(block: Block, *, symbol: str, real: Real = "float64") -> Parts:
    """Return the C99 of `emit_block(…, folded=True)` in several files: one for each large function and its own callees.

    All names begin with `symbol`; functions that no other file calls are static.
    Each file must begin with <math.h>, the pragma FP_CONTRACT and the prototypes.

    Args:
        block: program or routine.
        symbol: name of the last function.
        real: type of the numbers.

    Raises:
        InputError: `symbol` is not a valid C identifier.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import Loop, Routine, emit_parts, lower
        >>> depth, rate = ca.SX.sym("depth"), ca.SX.sym("rate")
        >>> sink = lower(ca.Function("sink", [depth, rate], [depth + 0.1 * rate]))
        >>> sinking = Loop(sink, 5, ("depth",), ("last",), fixed=("rate",))
        >>> dive = Routine("dive", (("depth", 1), ("rate", 1)), (sinking,), ("last",))
        >>> parts = emit_parts(dive, symbol="robot_law")
        >>> list(parts.files), parts.prototypes
        ([''], ('void robot_law(const double in0[1], const double in1[1], double out0[1]);',))
    """
    nodes = _nodes(block)
    files = _parted(nodes, block.digest())
    shared = {key for at, node in nodes.items() for key in node.calls if files.get(key, "") != files.get(at, "")}
    writer = Writer(identifier(symbol), real, True, files=files, shared={*shared, block.digest()})
    writer.write(block)
    texts = {
        name: "\n".join([text for text in (*own_helpers(part.programs, real), *part.chunks) if text])
        for name, part in writer.parts.items()
    }
    programs = [program for part in writer.parts.values() for program in part.programs]
    return Parts(MappingProxyType(dict(sorted(texts.items()))), (*inline_helpers(programs, real), *writer.prototypes))


@dataclass(frozen=True)
class _Node:
    """A C function that is to be written."""

    name: str
    size: int  # estimated length of the text
    calls: tuple[str, ...]  # keys of the called functions


def _nodes(block: Block) -> dict[str, _Node]:
    # keys as in `key_of`
    nodes: dict[str, _Node] = {}
    todo = [(block.digest(), block)]
    while todo:
        key, inner = todo.pop()
        if key in nodes:
            continue
        called = _called(inner)
        nodes[key] = _Node(inner.name, _size(inner), tuple(called))
        todo += called.items()
    return nodes


def _called(block: Block) -> dict[str, Block]:
    if not isinstance(block, Routine):
        return {}
    return {key_of(s): s.block for s in block.steps if not isinstance(s, Gather) and not inlined(s)}


def _size(block: Block) -> int:
    # estimated number of characters of the C text
    if isinstance(block, Routine):
        return 300 + 90 * len(block.steps)
    if isinstance(block, Procedure):
        return len(block.source)
    operations = sum(instruction.op not in LEAVES for instruction in block.instructions)
    return 200 + 15 * (operations + sum(len(refs) for refs in block.output_refs))


def _parted(nodes: Mapping[str, _Node], root: str) -> dict[str, str]:
    """Return the file of each function outside the file of `root`; the largest separable function is moved first."""
    # a function with the root's name does the main work of the root, and stays in the root's file
    files: dict[str, str] = {}
    rest = set(nodes)
    while sum(nodes[key].size for key in rest) > _MOST:
        able = [key for key in rest if nodes[key].calls and nodes[key].name != nodes[root].name]
        apart = {key: rest - _reached(nodes, root, without=key) for key in able}
        sizes = {key: sum(nodes[k].size for k in own) for key, own in apart.items()}
        fitting = [key for key, size in sizes.items() if _LEAST <= size <= _MOST]
        if not fitting:
            break
        chosen = max(fitting, key=lambda key: (sizes[key], key))
        files |= dict.fromkeys(apart[chosen], free_name(nodes[chosen].name, files))
        rest -= apart[chosen]
    return files


def _reached(nodes: Mapping[str, _Node], root: str, *, without: str) -> set[str]:
    reached, todo = set[str](), [root]
    while todo:
        key = todo.pop()
        if key not in reached and key != without:
            reached.add(key)
            todo += nodes[key].calls
    return reached
