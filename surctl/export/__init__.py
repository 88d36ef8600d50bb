"""Export of a controller as a C99 bundle, and checks by execution that C and Python compute the same numbers."""

from surctl.export.bundle import Bundle, ExportedFile, write_bundle
from surctl.export.check import STEPS, BuildReport, CheckReport, check_builds
from surctl.export.contract import STATUS, Exportable
from surctl.export.emulated import (
    TARGETS,
    EmulatedLine,
    LineDown,
    Reply,
    SerialLine,
    Target,
    connect,
    emulated,
    emulated_target,
)
from surctl.export.envelope import Envelope, Rate, Records
from surctl.export.precision import REALS
from surctl.export.process import Controller, ExportedController, ExportedStep, build_controller
from surctl.export.prove import Alarm, ProofReport
from surctl.export.sil import Difference, SilReport, compare_runs, software_in_the_loop
from surctl.export.supplement import Supplement

__all__ = [
    "REALS",
    "STATUS",
    "STEPS",
    "TARGETS",
    "Alarm",
    "BuildReport",
    "Bundle",
    "CheckReport",
    "Controller",
    "Difference",
    "EmulatedLine",
    "Envelope",
    "Exportable",
    "ExportedController",
    "ExportedFile",
    "ExportedStep",
    "LineDown",
    "ProofReport",
    "Rate",
    "Records",
    "Reply",
    "SerialLine",
    "SilReport",
    "Supplement",
    "Target",
    "build_controller",
    "check_builds",
    "compare_runs",
    "connect",
    "emulated",
    "emulated_target",
    "software_in_the_loop",
    "write_bundle",
]
