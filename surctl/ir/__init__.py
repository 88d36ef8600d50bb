"""Intermediate representation of symbolic functions (instruction lists with bounded loops), and its back ends."""

from surctl.ir.batch import Batch, batch_source, compile_batch, compile_batch_source
from surctl.ir.c99 import Real, c_literal, identifier, rearranged
from surctl.ir.c99_folded import Feed
from surctl.ir.c99_routine import Parts, emit_block, emit_parts
from surctl.ir.cache import (
    cached_bytes,
    compile_program,
    compiler_version,
    find_compiler,
    shared_library,
    source_digest,
)
from surctl.ir.elementary import nearby_angles, without_libm
from surctl.ir.folding import fused, shared_divisors
from surctl.ir.frames import stack_bytes
from surctl.ir.native import compile_block, runnable, warn_slower
from surctl.ir.places import memory, reads
from surctl.ir.ports import Layout, Port
from surctl.ir.program import Instruction, Program
from surctl.ir.replay import replay
from surctl.ir.routine import Block, Call, Gather, Loop, Routine, Step
from surctl.ir.stored import read_block, write_block
from surctl.ir.symbolic import on_columns, on_vectors, to_casadi
from surctl.ir.tracing import Recording, each, fold, lower, lower_named, only_if, picked, repeat, tabulated

__all__ = [
    "Batch", "Block", "Call", "Feed", "Gather", "Instruction", "Layout", "Loop", "Parts", "Port", "Program", "Real",
    "Recording", "Routine", "Step", "batch_source", "c_literal", "cached_bytes", "compile_batch",
    "compile_batch_source", "compile_block", "compile_program", "compiler_version", "each", "emit_block", "emit_parts",
    "find_compiler", "fold", "fused", "identifier", "lower", "lower_named", "memory", "nearby_angles", "on_columns",
    "on_vectors", "only_if", "picked", "read_block", "reads", "rearranged", "repeat", "replay", "runnable",
    "shared_divisors", "shared_library", "source_digest", "stack_bytes", "tabulated", "to_casadi", "warn_slower",
    "without_libm", "write_block",
]  # fmt: skip
