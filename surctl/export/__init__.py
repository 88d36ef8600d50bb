"""Export of a controller as a C99 bundle, and checks by execution that C and Python compute the same numbers."""

from surctl.export.bundle import Bundle, ExportedFile, write_bundle
from surctl.export.check import STEPS, CheckReport, check_builds
from surctl.export.contract import Exportable
from surctl.export.emulated import TARGETS, SerialLine, Target, connect, emulated, emulated_target
from surctl.export.envelope import Envelope, Records
from surctl.export.fmu import write_fmu
from surctl.export.precision import REALS
from surctl.export.process import Controller, ExportedController, build_controller
from surctl.export.prove import ProofReport, prove_bundle
from surctl.export.sil import SilReport, compare_runs, software_in_the_loop
from surctl.export.supplement import Supplement

__all__ = [
    "REALS", "STEPS", "TARGETS", "Bundle", "CheckReport", "Controller", "Envelope", "Exportable", "ExportedController",
    "ExportedFile", "ProofReport", "Records", "SerialLine", "SilReport", "Supplement", "Target", "build_controller",
    "check_builds", "compare_runs", "connect", "emulated", "emulated_target", "prove_bundle", "software_in_the_loop",
    "write_bundle", "write_fmu",
]  # fmt: skip
