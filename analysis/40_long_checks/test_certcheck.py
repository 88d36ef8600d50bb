"""The checker: every certificate that the repository holds, and a settling under errors of the sensors."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from surctl.certcheck import check_document
from tests.certcheck import test_braking, test_heading, test_steering, test_turning
from tests.certcheck.altering import altered, sealed


@pytest.mark.parametrize("path", test_heading.FILES, ids=lambda path: path.stem)
def test_headings(path: Path) -> None:
    test_heading.test_the_kept_certificates_are_accepted_and_small(path)


@pytest.mark.parametrize("name", [*test_turning.NAMES, *test_turning.OTHERS])
def test_turns(name: str) -> None:
    test_turning.test_the_kept_certificates_are_accepted_and_small(name)


@pytest.mark.parametrize("module", [test_heading, test_steering, test_turning], ids=lambda module: module.__name__)
def test_what_asks_for_more_is_rejected(module: ModuleType) -> None:
    for kind in module.STRONGER:
        module.test_what_asks_for_more_is_rejected_however_it_is_sealed(kind)


@pytest.mark.parametrize("name", ["braking-rule-20", "braking-inertia-ranges", "braking-simple-20"])
def test_no_braking_certificate_states_more(name: str) -> None:
    for kind in test_braking.OF_THE_LAW if name == "braking-simple-20" else test_braking.STRONGER:
        test_braking.test_what_asks_for_more_is_rejected_however_it_is_sealed(kind, name)


def test_no_altered_heading_that_sampling_refutes_is_accepted() -> None:
    whole, rng = test_heading.document(), np.random.default_rng(5)
    accepted, wrong = 0, 0
    for _ in range(24):
        path, changed = altered(whole, ("claim", "proof"), rng)
        if check_document(sealed(changed)).accepted:
            accepted += 1
            assert not test_heading.false(changed), path
        else:
            wrong += 1
    assert accepted > 0 and wrong > 2
    assert "altered" in check_document({**whole, "claim": {**whole["claim"], "sha256_vehicle": "0" * 64}}).reason
