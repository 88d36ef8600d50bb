"""Intermediate representation of symbolic functions (instruction lists with bounded loops), and its back ends."""

from surctl.ir.batch import Batch
from surctl.ir.c99 import Real, c_literal
from surctl.ir.c99_routine import Parts
from surctl.ir.elementary import without_libm
from surctl.ir.native import compile_block
from surctl.ir.places import memory, reads
from surctl.ir.ports import Layout, Port
from surctl.ir.program import Instruction, Program
from surctl.ir.replay import replay
from surctl.ir.routine import Block, Call, Gather, Loop, Routine, Step
from surctl.ir.symbolic import on_vectors, to_casadi
from surctl.ir.tracing import Recording, each, fold, lower, lower_named, only_if, picked, repeat, tabulated

__all__ = [
    "Batch", "Block", "Call", "Gather", "Instruction", "Layout", "Loop", "Parts", "Port", "Program", "Real",
    "Recording", "Routine", "Step", "c_literal", "compile_block", "each", "fold", "lower", "lower_named", "memory",
    "on_vectors", "only_if", "picked", "reads", "repeat", "replay", "tabulated", "to_casadi", "without_libm",
]  # fmt: skip
