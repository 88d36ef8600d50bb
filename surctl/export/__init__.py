"""The controller as a C99 bundle, and the proof by running it that C and Python agree."""

from surctl.export.bundle import Bundle, ExportedFile, build_bundle, write_bundle
from surctl.export.check import STEPS, BuildReport, CheckReport, check_builds
from surctl.export.contract import STATUS, Exportable
from surctl.export.fmu import write_fmu
from surctl.export.precision import REALS
from surctl.export.process import Controller, build_controller
from surctl.export.records import Records, as_records
from surctl.export.sil import Difference, SilReport, compare_runs, software_in_the_loop, software_in_the_loop_runs
from surctl.export.targets import TARGETS, Target, chosen_targets

__all__ = [
    "REALS",
    "STATUS",
    "STEPS",
    "TARGETS",
    "BuildReport",
    "Bundle",
    "CheckReport",
    "Controller",
    "Difference",
    "Exportable",
    "ExportedFile",
    "Records",
    "SilReport",
    "Target",
    "as_records",
    "build_bundle",
    "build_controller",
    "check_builds",
    "chosen_targets",
    "compare_runs",
    "software_in_the_loop",
    "software_in_the_loop_runs",
    "write_bundle",
    "write_fmu",
]
