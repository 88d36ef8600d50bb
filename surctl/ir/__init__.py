"""The instruction list of a symbolic function and its back ends."""

from surctl.ir.c99 import c_literal, emit_c99, identifier
from surctl.ir.compiler import compile_program, compiler_version, find_compiler
from surctl.ir.lowering import lower
from surctl.ir.ops import LIBM, OPERATIONS, Operation
from surctl.ir.ports import Layout, Port
from surctl.ir.program import Instruction, Program
from surctl.ir.replay import replay

__all__ = [
    "LIBM",
    "OPERATIONS",
    "Instruction",
    "Layout",
    "Operation",
    "Port",
    "Program",
    "c_literal",
    "compile_program",
    "compiler_version",
    "emit_c99",
    "find_compiler",
    "identifier",
    "lower",
    "replay",
]
