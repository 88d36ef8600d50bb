"""The checker: every certificate that the repository holds, and a settling under errors of the sensors."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.certcheck import test_heading, test_region, test_turning


@pytest.mark.parametrize("path", test_region.FILES, ids=lambda path: path.stem)
def test_cruises(path: Path) -> None:
    test_region.test_the_kept_certificates_are_accepted_and_small(path)


@pytest.mark.parametrize("path", test_heading.FILES, ids=lambda path: path.stem)
def test_headings(path: Path) -> None:
    test_heading.test_the_kept_certificates_are_accepted_and_small(path)


@pytest.mark.parametrize("name", [*test_turning.NAMES, *test_turning.OTHERS])
def test_turns(name: str) -> None:
    test_turning.test_the_kept_certificates_are_accepted_and_small(name)


def test_misled_it_settles_as_close_as_is_said() -> None:
    test_region.test_pushed_and_misled_it_settles_as_close_as_is_said("region-cruise-20-noise")
