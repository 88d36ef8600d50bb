"""Margins and claims in one table of sentences, and what of the verdict is folded."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from surctl.assessment import Figure, Line
from surctl.marine.report import render_page
from surctl.marine.report.page import _WORDS, findings_section
from surctl.marine.verification import claims
from surctl.report.document import Section, Table, render_sections
from surctl.verification import Inapplicable, decide, load_claim
from tests.report.data import report
from tests.report.reader import Reader
from tests.report.test_page import bare


def test_where_sections_are_folded_the_worst_three_lines_are_open() -> None:
    lines = (
        *(Line(True, "good"), Line(False, "bad", "runs"), Line(None, "remark", counts=False)),
        *(Line(True, name) for name in ("fine", "sound", "well")),
    )
    told = render_sections(
        title="t", subject="s", version="0", command="", passed=False, banner="x", lines=lines,
        sections=(Section("runs", "Runs", (), folded=True),),
    )  # fmt: skip
    open_, folded, _ = re.split(r"<details>|</details>", told, maxsplit=2)
    seen = re.sub(r"<style>.*</style>|<[^>]*>", "", open_, flags=re.S).split()
    assert {"bad", "good", "fine"} <= set(seen) and not {"sound", "well", "remark"} & set(seen)
    assert "2 checks hold; 1 note does not count towards the result" in folded
    assert "remark" in folded and "bad" not in folded


def test_a_proved_region_of_attraction_is_open() -> None:
    lines = (*(Line(True, name, "runs") for name in ("fine", "sound", "well")), Line(True, "proved", "region"))
    sections = (Section("runs", "Runs", (), folded=True), Section("region", "Region", ()))
    page = render_sections(
        title="t", subject="s", version="0", command="", passed=True, banner="x", lines=lines, sections=sections
    )
    open_, folded, _ = re.split(r"<details>|</details>", page, maxsplit=2)
    assert "proved" in open_ and "well" in folded and "proved" not in folded


def test_claims_are_one_table_of_sentences_below_the_figures() -> None:
    unfit = Inapplicable("braking-rule-20", "m11 = 1 kg and m22 = 2 kg differ")
    regions = (Inapplicable("region-cruise-20, region-cruise-20-soft", "m11 = 3 kg and m22 = 4 kg differ"),)
    margin = Figure("disk_margin", 0.31, "1", "all loops", "high", 0.3, "mass -5%")
    judged = replace(report().assessment, figures={margin.name: margin})
    section = findings_section(replace(report(), inapplicable=(unfit,), regions=regions, assessment=judged))
    figures, table = [block for block in section.blocks if isinstance(block, Table)]
    assert [cell.text for cell in figures.cells[0]] == ["disk_margin", "0.31", "≥ 0.3", "1", "all loops", "mass -5%"]
    rows = {row[0].text: [cell.text for cell in row[1:]] for row in table.cells}
    assert list(rows) == [
        "v1-printed", "m-norm-printed", "v1-corrected", "braking-rule-20",
        regions[0].claim,
    ]  # fmt: skip
    for verdict, holds, where, beyond in rows.values():
        assert verdict and holds.endswith(".") and where.startswith("sur540-flooded") and beyond.endswith(".")
        assert "cruise speed 0.15 m/s, speed limit 0.22 m/s" in where
    refuted, opened = rows["v1-printed"], rows["v1-corrected"]
    share = 100 * report().verdicts[0].fraction
    assert refuted[0] == "refuted, as expected" and refuted[1].startswith("It is not true that the tracking error")
    assert f"{share:.3g} % of the samples" in refuted[1] and refuted[3] == "Corrected form: v1-corrected."
    assert opened[1].startswith("It is not known whether") and "dynamics, thrust limits, current" in opened[3]
    assert "x_e, y_e, z_e -" in opened[2] and "turn -0.5 to 0.5 rad/s" in opened[2]
    assert rows["braking-rule-20"][:2] == [
        "not applicable",
        f"Not applicable to this vehicle, because {unfit.because}.",
    ]
    assert rows[regions[0].claim][:2] == [
        "not provable",
        "Not provable for this vehicle, because m11 = 3 kg and m22 = 4 kg differ.",
    ]
    text = Reader(render_page(bare(inapplicable=(unfit,), regions=regions))).text
    assert f"because {regions[0].because}" in text
    assert f"because {unfit.because}" in text


def test_every_claim_of_the_paper_has_words_without_a_formula() -> None:
    for claim in claims():
        if claim.paper:
            clause, beyond = (_WORDS[claim.name][key] for key in ("clause", "beyond"))
            assert not re.search(r"[≤≥‖]", clause) and clause != claim.statement and beyond
    assert set(_WORDS) == {claim.name for claim in claims() if claim.paper}


def test_a_claim_of_a_file_has_its_own_words_whatever_its_name(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        'kind = "claim"\nname = "v1-printed"\nleft = "-x^2"\nright = "0"\n'
        '[variables]\nx = { lower = -1, upper = 1, unit = "m" }\n'
    )
    section = findings_section(replace(report(), verdicts=(decide(load_claim(file)),)))
    row = [cell.text for block in section.blocks if isinstance(block, Table) for cell in block.cells[-1]]
    assert any("-x^2 <= 0" in text for text in row) and not any("tracking" in text for text in row)
