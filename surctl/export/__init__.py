"""Export of a controller as a C99 bundle, and checks by execution that C and Python compute the same numbers."""

from surctl.export.bundle import Bundle, ExportedFile, check_folder, write_bundle
from surctl.export.check import STEPS, CheckReport, check_builds
from surctl.export.contract import Exportable
from surctl.export.emulated import TARGETS, SerialLine, Target, chosen_targets, connect, emulated, emulated_target
from surctl.export.envelope import Envelope, Records, as_records
from surctl.export.fmu import write_fmu
from surctl.export.precision import REALS
from surctl.export.process import Controller, ExportedController, build_controller
from surctl.export.prove import ProofReport, gain_box, prove_bundle, with_proof
from surctl.export.sil import SilReport, compare_runs, software_in_the_loop
from surctl.export.supplement import Supplement

__all__ = [
    "REALS", "STEPS", "TARGETS", "Bundle", "CheckReport", "Controller", "Envelope", "Exportable", "ExportedController",
    "ExportedFile", "ProofReport", "Records", "SerialLine", "SilReport", "Supplement", "Target", "as_records",
    "build_controller", "check_builds", "check_folder", "chosen_targets", "compare_runs", "connect", "emulated",
    "emulated_target", "gain_box", "prove_bundle", "software_in_the_loop", "with_proof", "write_bundle", "write_fmu",
]  # fmt: skip
