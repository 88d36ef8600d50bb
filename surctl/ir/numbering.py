"""A growing instruction list that computes nothing twice."""

from __future__ import annotations

from surctl.ir.ops import LEAVES, OPERATIONS
from surctl.ir.program import Instruction, Program, drop_dead

__all__ = ["Numbering"]


class Numbering:
    """Value numbering: an instruction that is there already is not added again; no bit of a finite result changes.

    Attributes:
        instructions: the list so far.
    """

    def __init__(self) -> None:
        self.instructions: list[Instruction] = []
        self._known: dict[tuple[str, tuple[int, ...], str], int] = {}

    def constant(self, value: float) -> int:
        """Position of a constant; -0.0 and 0.0 are two constants."""
        return self._append(Instruction("const", (), value))

    def add(self, op: str, args: tuple[int, ...]) -> int:
        """Position of an operation on earlier positions, or of a load."""
        if op not in LEAVES and OPERATIONS[op].commutative:
            args = tuple(sorted(args))
        return self._append(Instruction(op, args))

    def copy(self, instruction: Instruction, moved: list[int]) -> int:
        """Position of an instruction of another list, whose operands are at `moved` here."""
        if instruction.op == "const":
            return self.constant(float(instruction.value or 0.0))
        if instruction.op == "input":
            return self.add("input", instruction.args)
        return self.add(instruction.op, tuple(moved[a] for a in instruction.args))

    def rewritten(self, program: Program, moved: list[int]) -> Program:
        """The program by this list, where its instructions are at `moved`, without what no output needs."""
        refs = [tuple(moved[r] for r in group) for group in program.output_refs]
        instructions, output_refs = drop_dead(self.instructions, refs)
        return Program(program.name, program.inputs, program.outputs, instructions, output_refs)

    def _append(self, instruction: Instruction) -> int:
        # the value is keyed by its bits: 0.0 == -0.0 as numbers
        bits = "" if instruction.value is None else instruction.value.hex()
        key = (instruction.op, instruction.args, bits)
        if key not in self._known:
            self._known[key] = len(self.instructions)
            self.instructions.append(instruction)
        return self._known[key]
