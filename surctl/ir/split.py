"""Division of a long program into parts, because the compile time of a C function grows faster than its length."""

from __future__ import annotations

from surctl.ir.numbering import Numbering
from surctl.ir.ops import LEAVES
from surctl.ir.program import Instruction, Program, drop_dead
from surctl.ir.routine import Block, Call, Loop, Routine, Step, nested

__all__ = ["shortened", "split"]

_LONGEST = 1200
"""Largest number of operations in one C function; the compile time of gcc grows faster than this number."""


def shortened(block: Block) -> Block:
    """Return the program or routine with its long programs split, except programs that run in SIMD lanes."""
    built: dict[int, Block] = {}
    for key, inner in nested(block).items():
        if isinstance(inner, Program):
            built[key] = split(inner, _LONGEST)
            continue
        steps: list[Step] = []
        for step in inner.steps:
            if isinstance(step, Call):
                steps.append(Call(built[id(step.block)], step.args, step.results))
            elif isinstance(step, Loop) and step.lanes == 1:
                whole = {name: getattr(step, name) for name in Loop.__slots__}
                steps.append(Loop(**{**whole, "block": built[id(step.block)]}))
            else:
                steps.append(step)
        built[key] = Routine(inner.name, inner.inputs, tuple(steps), inner.results)
    return built[id(block)]


def split(program: Program, size: int) -> Block:
    """Return a routine that calls parts of a program, each of at most `size` operations; short programs are unchanged.

    A part returns, as one array, the values that later parts or the outputs need. Constants and the reading of inputs
    are repeated in each part.
    """
    count = -(-program.operations // size)
    if count < 2:
        return program
    owner = _owners(program, -(-program.operations // count))
    last = count - 1
    needed: list[list[int]] = [[] for _ in range(count)]  # values that each part passes on, in order
    place: dict[int, tuple[int, int]] = {}
    uses = [(at, arg) for at, i in enumerate(program.instructions) if i.op not in LEAVES for arg in i.args]
    uses += [(-1, ref) for refs in program.output_refs for ref in refs]
    for user, arg in uses:
        if arg in owner and owner[arg] != (last if user < 0 else owner[user]) and arg not in place:
            place[arg] = (owner[arg], len(needed[owner[arg]]))
            needed[owner[arg]].append(arg)
    free = _free_name("part", program)
    steps = []
    for part in range(count):
        mine = [at for at, of in owner.items() if of == part]
        refs = list(program.output_refs) if part == last else [tuple(needed[part])]
        outputs = program.outputs if part == last else ((f"{free}{part}", len(needed[part])),)
        arrays = (*program.inputs, *((f"{free}{k}", len(needed[k])) for k in range(part)))
        body = _part(program, mine, refs, place, (f"{program.name}_{part}", arrays, outputs))
        results = tuple(f"{free}{last}_{k}" for k in range(len(outputs))) if part == last else (outputs[0][0],)
        steps.append(Call(body, tuple(name for name, _ in body.inputs), results))
    return Routine(program.name, program.inputs, tuple(steps), steps[-1].results)


def _owners(program: Program, size: int) -> dict[int, int]:
    """Return the number of the part to which each operation belongs."""
    operations = [at for at, i in enumerate(program.instructions) if i.op not in LEAVES]
    return {at: k // size for k, at in enumerate(operations)}


def _free_name(prefix: str, program: Program) -> str:
    while any(name.startswith(prefix) for name, _ in program.inputs):
        prefix += "x"
    return prefix


def _part(
    program: Program,
    mine: list[int],
    refs: list[tuple[int, ...]],
    place: dict[int, tuple[int, int]],
    head: tuple[str, tuple[tuple[str, int], ...], tuple[tuple[str, int], ...]],
) -> Program:
    name, arrays, outputs = head
    code, at_of = Numbering(), dict[int, int]()

    def position(old: int) -> int:
        if old not in at_of:
            instruction = program.instructions[old]
            if instruction.op == "const":
                at_of[old] = code.constant(instruction.number)
            elif instruction.op == "input":
                at_of[old] = code.add("input", instruction.args)
            else:
                part, entry = place[old]
                at_of[old] = code.add("input", (len(program.inputs) + part, entry))
        return at_of[old]

    for old in mine:
        instruction = program.instructions[old]
        at_of[old] = code.add(instruction.op, tuple(position(a) for a in instruction.args))
    moved = [tuple(position(r) for r in group) for group in refs]
    instructions, output_refs = drop_dead(code.instructions, moved)
    used = sorted({i.args[0] for i in instructions if i.op == "input"})
    rank = {old: new for new, old in enumerate(used)}
    instructions = tuple(
        Instruction("input", (rank[i.args[0]], i.args[1])) if i.op == "input" else i for i in instructions
    )
    return Program(name, tuple(arrays[k] for k in used), outputs, instructions, output_refs)
