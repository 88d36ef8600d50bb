"""An instruction list under construction in which equal instructions occur once."""

from __future__ import annotations

from surctl.ir.ops import LEAVES, OPERATIONS
from surctl.ir.program import Instruction, Program, drop_dead

__all__ = ["Numbering"]


class Numbering:
    """Value numbering: an instruction that the list already contains is not added again. Finite results do not change.

    Attributes:
        instructions: the instructions added so far.
    """

    def __init__(self) -> None:
        self.instructions: list[Instruction] = []
        self._known: dict[tuple[str, tuple[int, ...] | str], int] = {}

    def constant(self, value: float) -> int:
        """Return the list position of a constant; -0.0 and 0.0 are different constants."""
        # the key is its bit pattern, since 0.0 == -0.0 as numbers
        key = ("const", value.hex())
        at = self._known.get(key)
        return self._append(key, Instruction("const", (), value)) if at is None else at

    def add(self, op: str, args: tuple[int, ...]) -> int:
        """Return the list position of an operation on earlier values, or of the instruction for an input entry."""
        if op not in LEAVES and OPERATIONS[op].commutative:
            args = tuple(sorted(args))
        key = (op, args)
        at = self._known.get(key)
        return self._append(key, Instruction(op, args)) if at is None else at

    def copy(self, instruction: Instruction, moved: list[int]) -> int:
        """Return the position of a copy of an instruction from another list; `moved` maps old to new positions."""
        if instruction.op == "const":
            return self.constant(instruction.number)
        if instruction.op == "input":
            return self.add("input", instruction.args)
        return self.add(instruction.op, tuple(moved[a] for a in instruction.args))

    def rewritten(self, program: Program, moved: list[int]) -> Program:
        """Return the program with this list's instructions that it needs; `moved` maps old to new positions."""
        refs = [tuple(moved[r] for r in group) for group in program.output_refs]
        instructions, output_refs = drop_dead(self.instructions, refs)
        return Program(program.name, program.inputs, program.outputs, instructions, output_refs)

    def _append(self, key: tuple[str, tuple[int, ...] | str], instruction: Instruction) -> int:
        at = self._known[key] = len(self.instructions)
        self.instructions.append(instruction)
        return at
