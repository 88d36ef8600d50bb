"""The checker: every certificate that the repository holds, and a settling under errors of the sensors."""

from __future__ import annotations

from types import ModuleType

import pytest

from tests.certcheck import test_braking, test_steering, test_turning


@pytest.mark.parametrize("name", [*test_turning.NAMES, *test_turning.OTHERS])
def test_turns(name: str) -> None:
    test_turning.test_the_kept_certificates_are_accepted_and_small(name)


@pytest.mark.parametrize("module", [test_steering, test_turning], ids=lambda module: module.__name__)
def test_what_asks_for_more_is_rejected(module: ModuleType) -> None:
    for kind in module.STRONGER:
        module.test_what_asks_for_more_is_rejected_however_it_is_sealed(kind)


@pytest.mark.parametrize("name", ["braking-rule-20", "braking-inertia-ranges", "braking-simple-20"])
def test_no_braking_certificate_states_more(name: str) -> None:
    for kind in test_braking.OF_THE_LAW if name == "braking-simple-20" else test_braking.STRONGER:
        test_braking.test_what_asks_for_more_is_rejected_however_it_is_sealed(kind, name)
