"""Write a routine as C99: one static function a block, `for` loops over local arrays, no other memory."""

from __future__ import annotations

from collections.abc import Mapping

from surctl.ir.c99 import emit_c99, identifier
from surctl.ir.program import Program
from surctl.ir.routine import Block, Call, Gather, Loop, Routine, Step, nested

__all__ = ["emit_block"]


def emit_block(block: Block, *, symbol: str) -> str:
    """C99 of the block and of every block inside it, callees first.

    The last function is `static void <symbol>(const double *in0, …, double *out0, …)`; as in `emit_c99` outputs
    may alias inputs. Blocks of one text become one function. Largest stack: the local arrays along the deepest
    chain of calls.

    Raises:
        InputError: `symbol` is no identifier that C may use.
    """
    identifier(symbol)
    named: dict[str, str] = {}
    chunks: list[str] = []
    for inner in nested(block).values():
        digest = inner.digest()
        if digest in named:
            continue
        named[digest] = symbol if inner is block else _free(f"{symbol}_{inner.name}", named)
        chunks.append(
            emit_c99(inner, symbol=named[digest])
            if isinstance(inner, Program)
            else _routine(inner, named[digest], named)
        )
    return "\n".join(chunks)


def _free(wanted: str, named: Mapping[str, str]) -> str:
    name, at = wanted, 2
    while name in named.values():
        name, at = f"{wanted}_{at}", at + 1
    return identifier(name)


def _routine(routine: Routine, symbol: str, named: Mapping[str, str]) -> str:
    arguments = [f"const double *in{k}" for k in range(len(routine.inputs))]
    arguments += [f"double *out{k}" for k in range(len(routine.results))]
    sizes = routine.sizes()
    # local arrays are numbered, so that no name from outside reaches the C text unchecked
    local = {name: f"in{k}" for k, (name, _) in enumerate(routine.inputs)}
    local |= {name: f"a{k}" for k, name in enumerate(sizes) if name not in local}
    meaning = ", ".join(f"{local[name]}: {identifier(name)} {size}" for name, size in sizes.items())
    lines = [f"/* {meaning}; outputs may alias inputs */", f"static void {symbol}({', '.join(arguments)})", "{"]
    lines += [f"    double {local[name]}[{size}];" for name, size in list(sizes.items())[len(routine.inputs) :]]
    read = {name for step in routine.steps for name in _reads(step)} | set(routine.results)
    lines += [f"    (void){local[name]};" for name in local if name not in read]
    for step in routine.steps:
        lines += _step(step, sizes, local, named)
    for k, name in enumerate(routine.results):
        lines.append(_copy(f"out{k}", local[name], sizes[name]))
    return "\n".join([*lines, "}"]) + "\n"


def _reads(step: Step) -> tuple[str, ...]:
    if isinstance(step, Gather):
        return (step.source, step.index)
    return step.args if isinstance(step, Call) else (*step.carried, *step.sliced, *step.fixed)


def _copy(to: str, source: str, size: int) -> str:
    return f"    for (int k = 0; k < {size}; ++k) {{ {to}[k] = {source}[k]; }}"


def _step(step: Step, sizes: Mapping[str, int], local: Mapping[str, str], named: Mapping[str, str]) -> list[str]:
    if isinstance(step, Gather):
        return _gather(step, sizes[step.source] // step.width, local)
    function = named[step.block.digest()]
    if isinstance(step, Call):
        return [f"    {function}({', '.join(local[name] for name in (*step.args, *step.results))});"]
    return _loop(step, function, sizes, local)


def _gather(step: Gather, count: int, local: Mapping[str, str]) -> list[str]:
    index, source = f"{local[step.index]}[0]", local[step.source]
    # compared before it is cast: a NaN or a number beyond int has no value as an int
    inside = f"({index} >= 1.0) ? (({index} < {count - 1}.0) ? (int){index} : {count - 1}) : 0"
    return [
        "    {",
        f"        const double *piece = {source} + {step.width} * ({inside});",
        f"        for (int k = 0; k < {step.width}; ++k) {{ {local[step.result]}[k] = piece[k]; }}",
        "    }",
    ]


def _loop(loop: Loop, function: str, sizes: Mapping[str, int], local: Mapping[str, str]) -> list[str]:
    state = len(loop.carried)
    results = [local[name] for name in loop.results]
    lines = [
        _copy(result, local[name], sizes[name]) for name, result in zip(loop.carried, results[:state], strict=True)
    ]
    running = "" if loop.until is None else f" && ({results[loop.until]}[0] == 0.0)"
    lines.append(f"    for (int i = 0; (i < {loop.count}){running}; ++i) {{")
    if loop.index:
        lines.append("        const double turn = (double)i;")
    arguments = ["&turn"] * loop.index + results[:state]
    arguments += [_part(local[name], sizes[name] // loop.count) for name in loop.sliced]
    arguments += [local[name] for name in loop.fixed]
    arguments += results[:state]
    arguments += [_part(local[name], sizes[name] // loop.count) for name in loop.results[state:]]
    return [*lines, f"        {function}({', '.join(arguments)});", "    }"]


def _part(array: str, width: int) -> str:
    return f"{array} + {width} * i"
