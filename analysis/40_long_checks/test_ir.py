"""Instruction lists: every operation inside every other one."""

from __future__ import annotations

from pathlib import Path

from tests.ir import test_folded


def test_every_operation_inside_every_other_treats_special_numbers_alike(tmp_path: Path) -> None:
    test_folded.test_every_operation_inside_every_other_treats_special_numbers_alike(tmp_path, 1)
