"""Intermediate representation of symbolic functions (instruction lists with bounded loops), and its back ends."""

from surctl.ir.batch import Batch
from surctl.ir.c99 import C_TYPE, Real, c_literal, emit_c99
from surctl.ir.c99_folded import Feed
from surctl.ir.c99_routine import Parts
from surctl.ir.c99_wide import Wide
from surctl.ir.cache import CacheUnused
from surctl.ir.elementary import without_libm
from surctl.ir.native import Native, SlowerEngine, Workspace, compile_block
from surctl.ir.places import memory, reads
from surctl.ir.ports import Layout, Port
from surctl.ir.program import LIBM, OPERATIONS, Instruction, Operation, Program
from surctl.ir.replay import replay
from surctl.ir.routine import Block, Call, Gather, Loop, Routine, Step
from surctl.ir.symbolic import on_vectors, to_casadi
from surctl.ir.tracing import Recording, each, fold, lower, lower_named, only_if, picked, repeat, tabulated

__all__ = [
    "C_TYPE",
    "LIBM",
    "OPERATIONS",
    "Batch",
    "Block",
    "CacheUnused",
    "Call",
    "Feed",
    "Gather",
    "Instruction",
    "Layout",
    "Loop",
    "Native",
    "Operation",
    "Parts",
    "Port",
    "Program",
    "Real",
    "Recording",
    "Routine",
    "SlowerEngine",
    "Step",
    "Wide",
    "Workspace",
    "c_literal",
    "compile_block",
    "each",
    "emit_c99",
    "fold",
    "lower",
    "lower_named",
    "memory",
    "on_vectors",
    "only_if",
    "picked",
    "reads",
    "repeat",
    "replay",
    "tabulated",
    "to_casadi",
    "without_libm",
]
