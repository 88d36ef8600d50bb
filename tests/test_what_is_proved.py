"""The page about what is proved says what the library says."""

import json
import math
import re
from pathlib import Path

import pytest

from surctl.lyapunov.slope_search import form_of
from surctl.marine.verification import claims
from surctl.marine.verification.braking import BRAKING_CLAIMS
from surctl.marine.verification.region import REGION_CLAIMS
from surctl.verification.formula import parse, variable

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "notebooks" / "guides" / "what-is-proved.md"


def rows() -> dict[str, list[str]]:
    """Cells after the name, by the name."""
    lines = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]
    return {row[0].strip(" `"): row[1:] for row in cells}


def test_every_claim_is_there_and_nothing_else() -> None:
    assert set(rows()) == {c.name for c in claims() if c.paper} | set(REGION_CLAIMS) | set(BRAKING_CLAIMS)


def test_verdicts_are_those_of_the_library() -> None:
    told = rows()
    for claim in claims():
        if claim.paper:
            assert told[claim.name][:2] == [claim.expected, claim.equation]


@pytest.mark.parametrize("name", REGION_CLAIMS)
def test_regions_are_no_larger_than_their_certificates(name: str) -> None:
    claim = json.loads((ROOT / "tests" / "certcheck" / f"{name}.json").read_text())["claim"]
    if "motion" not in claim:
        names = [row["name"] for row in claim["states"]]
        form = form_of(parse(claim["function"], {state: variable(state) for state in names}), names)
        claim["motion"] = {"offset_m": math.sqrt(claim["level"] / form[0, 0]), "rate_per_s": claim["rate"]}
    motion = claim["motion"]
    beside, rate, settles, statement = rows()[name]
    motion.setdefault("ultimate_bound_m", 0.0)  # the heading loop converges to 0
    ends = motion["ultimate_bound_m"] if isinstance(motion["ultimate_bound_m"], list) else [motion["ultimate_bound_m"]]
    assert 0 <= motion.get("beside_m", motion["offset_m"]) - float(beside.split()[0]) < 0.001
    assert float(rate.removesuffix("/s")) == motion["rate_per_s"]
    assert 0 <= float(settles.split()[0]) - max(ends) < 0.001
    assert statement == REGION_CLAIMS[name].statement


def test_what_it_names_is_there() -> None:
    for study in re.findall(r"`(analysis/\w+)`", PAGE.read_text(encoding="utf-8")):
        assert (ROOT / study / "README.md").is_file()
