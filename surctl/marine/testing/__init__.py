"""Conformance checks for custom laws of a vehicle; a failed check states where it fails."""

from surctl.marine.testing.laws import LawReport, check_law

__all__ = [
    "LawReport",
    "check_law",
]
